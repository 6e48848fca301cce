//! Reports of the outbox about itself, to the log and as incidents to the aggregator.

use std::fmt;

use peernet_clock::MonoTime;
use peernet_logger::Slug;
use peernet_networks::Address;
use peernet_stream::{Accounting, IncidentKind};

use super::dropping::{DroppingReport, DroppingWatch};
use super::spool::QuarantinedSpool;
use crate::incidents::{IncidentSubject, Incidents};
use crate::reconnect_backoff::ReconnectBackoff;

/// Formats a number with commas between thousands.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// State at the time when the aggregator accepts the agent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Welcome {
    /// Number of the newest batch that the aggregator has.
    pub(super) stored: u64,
    /// `true` if it lacks batches that were acknowledged.
    pub(super) lacks: bool,
    /// Number of events that wait.
    pub(super) waiting: u64,
    /// Number of connections to clouds that ended since the last live update.
    pub(super) unreported_ends: u64,
}

/// Reports each trouble once.
#[derive(Debug)]
pub(super) struct Reports {
    incidents: Incidents,
    /// Trouble with the connection that was reported last.
    reported_trouble: Option<String>,
    /// Damage in the spool that was reported last.
    damage: Option<String>,
    dropping: DroppingWatch,
}

impl Reports {
    pub(super) fn new(incidents: Incidents) -> Self {
        Self { incidents, reported_trouble: None, damage: None, dropping: DroppingWatch::default() }
    }

    /// Reports that the aggregator accepted the agent.
    pub(super) fn welcomed(&mut self, aggregator: &Slug, welcome: &Welcome) {
        let Welcome { stored, lacks, waiting, unreported_ends } = *welcome;
        self.reported_trouble = None;
        let has = match stored {
            0 => String::new(),
            stored => format!(", which has batches up to {stored}"),
        };
        let lost = if lacks {
            "; it lacks batches that were acknowledged once: another aggregator has them, or its database is a new one or \
             an old copy"
        } else {
            ""
        };
        let wait = match waiting {
            0 => String::new(),
            1 => ", 1 event waits".to_owned(),
            waiting => format!(", {} events wait", grouped(waiting)),
        };
        let unreported = match unreported_ends {
            0 => String::new(),
            1 => "; 1 connection to a cloud ended meanwhile, what it sent and received since the last live figures is not stored".to_owned(),
            ends => format!(
                "; {} connections to clouds ended meanwhile, what they sent and received since the last live figures is not stored",
                grouped(ends)
            ),
        };
        let text = format!("connected to the aggregator {aggregator}{has}{wait}{lost}{unreported}");
        self.incidents.report(IncidentKind::Connected, IncidentSubject::default(), text);
    }

    /// Reports that the aggregator has no secret of this host and is sent it.
    pub(super) fn enrolling(&self, aggregator: &Slug) {
        tracing::info!(
            %aggregator,
            "the aggregator knows no secret of this host and is told it: its first contact, or its database is another"
        );
    }

    /// Reports that the aggregator refused the agent.
    pub(super) fn refused(&mut self, reason: &str) {
        let text = format!("the aggregator refuses this agent and is asked again: {reason}");
        self.connection(IncidentKind::Refused, text);
    }

    /// Reports the loss of the connection, or that it cannot be opened.
    pub(super) fn away(&mut self, address: &Address, reason: &impl fmt::Display) {
        if self.reported_trouble.is_none() {
            let text = format!(
                "no connection to the aggregator at {address}: {reason}; measuring goes on, events wait, and it is \
                 tried again every {} to {} s",
                ReconnectBackoff::MIN_PAUSE.as_secs_f64(),
                ReconnectBackoff::MAX_PAUSE.as_secs()
            );
            self.connection(IncidentKind::Disconnected, text);
        }
    }

    /// Reports that the peer accepts connections but does not speak the protocol.
    pub(super) fn silent(&mut self, address: &Address) {
        let text = format!(
            "connected to {address}, but no aggregator answers there; is it the event port (5550) of an \
             aggregator? It is tried again, events wait"
        );
        self.connection(IncidentKind::Disconnected, text);
    }

    /// Reports that the spool continues in a new stream.
    pub(super) fn renewed(&self, stored: u64, newest: u64) {
        let text = format!(
            "the aggregator has batches up to {stored} of a stream that ends at {newest} here, or others under the \
             same numbers: the spool is a copy or a restored one; what it holds goes on in a new stream"
        );
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports that the spool cannot be written or read.
    pub(super) fn spool_failed(&self, reason: &str) {
        let text = format!("{reason}; measuring goes on, and it is tried again");
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports that the spool can be used again.
    pub(super) fn spool_recovered(&self) {
        let text = "the spool can be used again".to_owned();
        self.incidents.report_info(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports damage in the spool.
    pub(super) fn damage(&mut self, text: String) {
        if self.damage.as_ref() != Some(&text) {
            self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text.clone());
            self.damage = Some(text);
        }
    }

    /// Reports that a broken spool was replaced by a new one.
    pub(super) fn quarantined(&self, aside: &QuarantinedSpool) {
        let text = format!(
            "{}; it is kept as {}, and an empty one takes its place: events that the aggregator had not got are \
             missing there",
            aside.reason,
            aside.kept.display()
        );
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Logs whether events are being dropped. The gaps in the stream tell the aggregator; the log is for people on
    /// this host.
    pub(super) fn account(&mut self, account: &Accounting, now: MonoTime) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        match self.dropping.update(account.dropped, now) {
            None => {}
            Some(DroppingReport::Dropping(events)) => tracing::warn!(
                events,
                "events are dropped, the gaps say why: the spool holds {:.1} of {:.1} MiB ([spool] limit_bytes), the \
                 memory before it {:.1} MiB",
                mib(account.spool_bytes),
                mib(account.spool_limit_bytes),
                mib(account.memory_bytes)
            ),
            Some(DroppingReport::Over(events)) => {
                tracing::info!(events, "no event was dropped for some seconds; those before stand in gaps");
            }
        }
    }

    fn connection(&mut self, kind: IncidentKind, text: String) {
        if self.reported_trouble.as_ref() != Some(&text) {
            self.incidents.report(kind, IncidentSubject::default(), text.clone());
            self.reported_trouble = Some(text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::grouped;

    #[test]
    fn thousands_are_separated() {
        for (number, text) in [(7, "7"), (999, "999"), (1_000, "1,000"), (12_345_678, "12,345,678")] {
            assert_eq!(grouped(number), text);
        }
    }
}
