//! Reports of the outbox's own problems, in the log and as incidents.

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
fn with_thousands_separators(number: u64) -> String {
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
    /// `true` if the aggregator lacks batches that were acknowledged.
    pub(super) lacks_batches: bool,
    /// Number of events that the aggregator has not stored.
    pub(super) waiting: u64,
    /// Number of connections to clouds that ended since the last live update.
    pub(super) unreported_ends: u64,
}

/// Reports each problem once.
#[derive(Debug)]
pub(super) struct Reports {
    incidents: Incidents,
    /// Text of the last reported problem of the connection.
    reported_problem: Option<String>,
    /// Text of the last reported damage in the spool.
    reported_damage: Option<String>,
    dropping: DroppingWatch,
}

impl Reports {
    pub(super) fn new(incidents: Incidents) -> Self {
        Self { incidents, reported_problem: None, reported_damage: None, dropping: DroppingWatch::default() }
    }

    /// Reports that the aggregator accepted the agent.
    pub(super) fn report_welcome(&mut self, aggregator: &Slug, welcome: &Welcome) {
        let Welcome { stored, lacks_batches, waiting, unreported_ends } = *welcome;
        // The next loss of the connection is a new problem, even with the same text.
        self.reported_problem = None;
        let stored_text = match stored {
            0 => String::new(),
            stored => format!("; its newest batch is number {stored}"),
        };
        let lost_text = if lacks_batches {
            "; it lacks batches that it once acknowledged: another aggregator has them, or its database is new or was restored \
             from an old copy"
        } else {
            ""
        };
        let waiting_text = match waiting {
            0 => String::new(),
            1 => "; 1 event waits here".to_owned(),
            waiting => format!("; {} events wait here", with_thousands_separators(waiting)),
        };
        let unreported_text = match unreported_ends {
            0 => String::new(),
            1 => "; 1 connection to a cloud ended in the meantime; its traffic since the last live update is not stored".to_owned(),
            ends => format!(
                "; {} connections to clouds ended in the meantime; their traffic since the last live update is not stored",
                with_thousands_separators(ends)
            ),
        };
        // With the usual name the text would be "the aggregator aggregator".
        let name = if aggregator.as_str() == "aggregator" { String::new() } else { format!(" {aggregator}") };
        let text = format!(
            "connected to the aggregator{name}{stored_text}{waiting_text}{lost_text}{unreported_text}"
        );
        self.incidents.report(IncidentKind::Connected, IncidentSubject::default(), text);
    }

    /// Logs that the aggregator has no secret of this host, so that the agent sends it.
    pub(super) fn report_enrollment(&self, aggregator: &Slug) {
        tracing::info!(
            %aggregator,
            "the aggregator has no secret of this host; the agent sends it (first contact, or another database)"
        );
    }

    /// Reports that the aggregator refused the agent.
    pub(super) fn report_refusal(&mut self, reason: &str) {
        let text = format!("the aggregator refuses this agent: {reason}; retrying");
        self.report_connection(IncidentKind::Refused, text);
    }

    /// Reports that the connection was lost or cannot be opened.
    pub(super) fn report_unreachable(&mut self, address: &Address, reason: &impl fmt::Display) {
        // Reported once until the next welcome: the reason may differ from attempt to attempt.
        if self.reported_problem.is_none() {
            let text = format!(
                "no connection to the aggregator at {address}: {reason}; measuring continues, events wait, \
                 retrying every {} to {} s",
                ReconnectBackoff::MIN_PAUSE.as_secs_f64(),
                ReconnectBackoff::MAX_PAUSE.as_secs()
            );
            self.report_connection(IncidentKind::Disconnected, text);
        }
    }

    /// Reports that the peer accepts connections but does not speak the protocol.
    pub(super) fn report_silent(&mut self, address: &Address) {
        let text = format!(
            "connected to {address}, but no aggregator answers there; check that it is the event port (5550) of an \
             aggregator; events wait, retrying"
        );
        self.report_connection(IncidentKind::Disconnected, text);
    }

    /// Reports that the spool continues in a new stream.
    pub(super) fn report_renewal(&self, stored: u64, newest: u64) {
        let text = format!(
            "the aggregator has batches up to {stored} of a stream that ends at {newest} in the spool, or other batches with \
             the same numbers: the spool is a copy or was restored; its events continue in a new stream"
        );
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports that the spool cannot be written or read.
    pub(super) fn report_spool_failure(&self, reason: &str) {
        let text = format!("{reason}; measuring continues, retrying");
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports that the spool can be used again.
    pub(super) fn report_spool_recovery(&self) {
        let text = "the spool can be used again".to_owned();
        self.incidents.report_info(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Reports damage in the spool.
    pub(super) fn report_damage(&mut self, text: String) {
        if self.reported_damage.as_ref() != Some(&text) {
            self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text.clone());
            self.reported_damage = Some(text);
        }
    }

    /// Reports that a damaged spool was replaced by a new one.
    pub(super) fn report_quarantine(&self, quarantined: &QuarantinedSpool) {
        let text = format!(
            "{}; it was moved to {}, and a new spool was created: events that the aggregator had not stored are missing there",
            quarantined.reason,
            quarantined.new_path.display()
        );
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Logs when events are dropped, and when this ends. The aggregator learns of dropped events from the gaps in the stream.
    pub(super) fn report_dropping(&mut self, account: &Accounting, now: MonoTime) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        match self.dropping.update(account.dropped, now) {
            None => {}
            Some(DroppingReport::Dropping(events)) => tracing::warn!(
                events,
                "dropping events; gaps give the reasons; the spool has {:.1} of {:.1} MiB ([spool] limit_bytes), and {:.1} MiB \
                 wait in memory",
                mib(account.spool_bytes),
                mib(account.spool_limit_bytes),
                mib(account.memory_bytes)
            ),
            Some(DroppingReport::Ended(events)) => {
                tracing::info!(events, "events are no longer dropped; gaps report the dropped events");
            }
        }
    }

    fn report_connection(&mut self, kind: IncidentKind, text: String) {
        if self.reported_problem.as_ref() != Some(&text) {
            self.incidents.report(kind, IncidentSubject::default(), text.clone());
            self.reported_problem = Some(text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::with_thousands_separators;

    #[test]
    fn thousands_are_separated() {
        for (number, text) in [(7, "7"), (999, "999"), (1_000, "1,000"), (12_345_678, "12,345,678")] {
            assert_eq!(with_thousands_separators(number), text);
        }
    }
}
