//! What the aggregator says, and what the machine makes of it.

use peernet_stream::{Event, Notice, ToAgent, codec};

use super::Sender;

impl Sender {
    /// Returns whether it was an aggregator that spoke.
    pub(super) fn hear(&mut self, frame: &[u8]) -> bool {
        let message: ToAgent = match codec::decode(frame) {
            Ok(message) => message,
            Err(error) => {
                tracing::warn!(%error, "what the aggregator sent makes no sense and is dropped");
                return false;
            }
        };
        if let Some(notice) = self.machine.received(&message, self.clock.stamp()) {
            self.noticed(notice);
        }
        true
    }

    pub(super) fn noticed(&mut self, notice: Notice) {
        match notice {
            Notice::Welcomed { aggregator, stored, lacks } => {
                self.reports.welcomed(&aggregator, stored, lacks, self.count().waiting);
                // It may have been started anew and know no second of ours.
                self.live.board.start_over();
                if lacks {
                    self.tell_of_runs();
                }
            }
            Notice::Enrolling { aggregator } => self.reports.enrolling(&aggregator),
            Notice::Refused(reason) => self.reports.refused(&reason),
            Notice::StreamRenewed { stored, newest } => {
                self.reports.renewed(stored, newest);
                self.tell_of_runs();
            }
            Notice::SpoolFailed(reason) => self.reports.spool_failed(&reason),
            Notice::SpoolRecovered => self.reports.spool_recovered(),
        }
    }

    /// The aggregator does not have what it once stored: without the start of its run an iteration means little.
    pub(super) fn tell_of_runs(&mut self) {
        let now = self.clock.stamp();
        for event in self.runs.beginnings() {
            let pipeline =
                if let Event::RunStarted(started) = &event { Some(&started.pipeline) } else { None };
            self.exit.counter.count(pipeline, event.run(), now.wall);
            self.machine.offer(&event, now);
        }
    }
}
