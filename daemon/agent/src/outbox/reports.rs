//! Reports of the outbox's own problems, in the log and as incidents.

use std::fmt;
use std::path::Path;

use peernet_clock::{LogThrottle, MonoTime};
use peernet_logger::Slug;
use peernet_networks::Address;
use peernet_statistics::number::{count, counted, counted_with_plural};
use peernet_stream::{Accounting, IncidentKind};

use super::dropping::{DroppingReport, DroppingWatch};
use super::spool::{QuarantinedSpool, RecoveryCounts};
use crate::incidents::{IncidentSubject, Incidents};
use crate::reconnect_backoff::ReconnectBackoff;

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

/// Reports the problems of the outbox, each problem once.
#[derive(Debug)]
pub(super) struct Reports {
    incidents: Incidents,
    /// Text of the latest reported problem of the connection; `None` after the aggregator accepted the agent.
    reported_problem: Option<String>,
    /// Text of the latest reported damage in the spool.
    reported_damage: Option<String>,
    dropping: DroppingWatch,
    /// Limits the number of log lines about sending the secret.
    enrollments: LogThrottle,
}

impl Reports {
    pub(super) fn new(incidents: Incidents) -> Self {
        Self {
            incidents,
            reported_problem: None,
            reported_damage: None,
            dropping: DroppingWatch::default(),
            enrollments: LogThrottle::default(),
        }
    }

    /// Reports that the aggregator accepted the agent.
    pub(super) fn report_welcome(&mut self, aggregator: &Slug, welcome: &Welcome) {
        let Welcome { stored, lacks_batches, waiting, unreported_ends } = *welcome;
        // The next loss of the connection is a new problem, even with the same text.
        self.reported_problem = None;
        let stored_text = match stored {
            0 => String::new(),
            stored => format!("; the newest batch that it stored is number {stored}"),
        };
        let lost_text = if lacks_batches {
            "; the aggregator lacks batches that were acknowledged: another aggregator acknowledged them, or the database \
             is new or was restored from an old copy"
        } else {
            ""
        };
        let waiting_text = match waiting {
            0 => String::new(),
            1 => "; 1 event waits here".to_owned(),
            waiting => format!("; {} events wait here", count(waiting)),
        };
        let unreported_text = match unreported_ends {
            0 => String::new(),
            1 => "; 1 connection to a cloud ended in the meantime; its traffic since the last live update is not stored".to_owned(),
            ends => format!(
                "; {} connections to clouds ended in the meantime; their traffic since the last live update is not stored",
                count(ends)
            ),
        };
        // With the usual name the text would be "the aggregator aggregator".
        let name = if aggregator.as_str() == "aggregator" { String::new() } else { format!(" {aggregator}") };
        let text = format!(
            "connected to the aggregator{name}{stored_text}{waiting_text}{lost_text}{unreported_text}"
        );
        self.incidents.report(IncidentKind::Connected, IncidentSubject::default(), text);
    }

    /// Logs that the agent sends the secret of this host, because the aggregator does not have it. A refused agent
    /// sends the secret at every attempt, so only the first attempt is logged at once.
    pub(super) fn report_enrollment(&mut self, aggregator: &Slug, now: MonoTime) {
        match self.enrollments.count_event(aggregator.as_str(), None, now) {
            None => {}
            Some(1) => tracing::info!(
                %aggregator,
                "the aggregator has no secret of this host; the agent sends it (first contact, or another database)"
            ),
            Some(times) => tracing::info!(
                %aggregator,
                times,
                "the aggregator still has no secret of this host; the agent sent it again, and the aggregator did not accept the agent"
            ),
        }
    }

    /// Reports that the aggregator refused the agent.
    pub(super) fn report_refusal(&mut self, reason: &str) {
        let text = format!("the aggregator refuses this agent: {reason}; retrying");
        self.report_connection(IncidentKind::Refused, text);
    }

    /// Reports that the connection was lost or cannot be opened.
    pub(super) fn report_unreachable(&mut self, address: &Address, reason: &impl fmt::Display) {
        // Only the first reason is reported until the next welcome, because each attempt may fail for another reason.
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
    pub(super) fn report_silent_peer(&mut self, address: &Address) {
        let text = format!(
            "connected to {address}, but no aggregator answers there; check that it is the event port (5550) of an \
             aggregator; events wait, retrying"
        );
        self.report_connection(IncidentKind::Disconnected, text);
    }

    /// Reports that the spool continues in a new stream.
    // Incidents about the spool have the kind `Gap`, because there is no separate kind for the spool.
    pub(super) fn report_renewal(&self, stored: u64, newest: u64) {
        let text = format!(
            "this spool is a copy or was restored: its newest batch has the number {newest}, and the aggregator has batches \
             of the same stream up to number {stored}, or different batches with the same numbers; the spool's events \
             continue in a new stream"
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
        self.incidents.report(
            IncidentKind::Gap,
            IncidentSubject::default(),
            describe_quarantine(quarantined),
        );
    }

    /// Reports that the file of the spool existed and was empty.
    pub(super) fn report_empty_spool(&self, path: &Path) {
        let text = format!(
            "the spool {} was an empty file, and a new spool was created in the file; a power cut or a program truncated \
             the file, and events in it that the aggregator had not stored are lost; check the disk",
            path.display()
        );
        self.incidents.report(IncidentKind::Gap, IncidentSubject::default(), text);
    }

    /// Logs that events are dropped, and later that no more events are dropped. The aggregator learns of dropped events
    /// from the gaps in the stream.
    pub(super) fn report_dropping(&mut self, accounting: &Accounting, now: MonoTime) {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        match self.dropping.update(accounting.dropped, now) {
            None => {}
            Some(DroppingReport::Dropping(events)) => tracing::warn!(
                events,
                "dropping events; gaps give the reasons; the spool uses {:.1} of {:.1} MiB ([spool] limit_bytes), and {:.1} MiB \
                 wait in memory",
                mib(accounting.spool_bytes),
                mib(accounting.spool_limit_bytes),
                mib(accounting.memory_bytes)
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

/// Describes a damaged spool that was replaced: the path to which its file was moved, the batches that are recovered
/// and lost, and what to do.
fn describe_quarantine(quarantined: &QuarantinedSpool) -> String {
    let QuarantinedSpool { reason, new_path, bytes, recovered } = quarantined;
    let path = new_path.display();
    let batches_of = |number: u64| counted_with_plural(number, "batch", "batches");
    let moved = format!("{reason}; the file ({} bytes) was moved to {path}", count(*bytes));
    let advice = format!(
        "check the disk, for example with smartctl, and delete {path} when you do not need these events"
    );
    let RecoveryCounts { batches, events, lost_batches, lost_events } = match recovered {
        Ok(recovered) => recovered,
        Err(error) => {
            return format!(
                "{moved}, and an empty spool was created, because no batch could be recovered: {error}; events that the \
                 aggregator had not stored are only in that file and are not sent; {advice}"
            );
        }
    };
    let lost = match lost_batches {
        Some(0) => "no batch was lost".to_owned(),
        Some(lost) => format!(
            "{} from the damage on, with at least {}, are only in that file and are not sent",
            batches_of(*lost),
            counted(*lost_events, "event")
        ),
        None => "the batches from the damage on are only in that file and are not sent; their number cannot be read".to_owned(),
    };
    format!(
        "{moved}; a new spool has the {} before the damage, with {}, which are sent; {lost}; {advice}",
        batches_of(*batches),
        counted(*events, "event")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarantine_report_counts_recovered_and_lost_batches() {
        let mut quarantined = QuarantinedSpool {
            reason: "the spool s is damaged: malformed".to_owned(),
            new_path: "/var/s.damaged-5".into(),
            bytes: 40_960,
            recovered: Err("the disk is full".to_owned()),
        };
        let text = describe_quarantine(&quarantined);
        for part in [
            "(40,960 bytes) was moved to /var/s.damaged-5",
            "an empty spool was created, because no batch could be recovered: the disk is full",
            "delete /var/s.damaged-5",
        ] {
            assert!(text.contains(part), "{text}");
        }
        let recovered = RecoveryCounts { batches: 1, events: 1_200, lost_batches: Some(3), lost_events: 30 };
        quarantined.recovered = Ok(recovered);
        let text = describe_quarantine(&quarantined);
        for part in [
            "the 1 batch before the damage, with 1,200 events",
            "3 batches from the damage on, with at least 30 events",
        ] {
            assert!(text.contains(part), "{text}");
        }
        quarantined.recovered = Ok(RecoveryCounts { lost_batches: None, ..recovered });
        assert!(describe_quarantine(&quarantined).contains("their number cannot be read"));
    }
}
