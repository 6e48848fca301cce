//! Performs the actions of the state machine, and handles results of the spool and messages of the aggregator.

use peernet_stream::{Accounting, Action, Notice, ToAgent, codec};

use super::Sender;
use crate::outbox::connection_state::ConnectionState;
use crate::outbox::reports::Welcome;
use crate::outbox::shutdown::OutboxState;
use crate::outbox::spool::{SpoolRequest, SpoolResult, SpoolTaskError};

impl Sender {
    /// Sends a due live update, performs the actions of the state machine, and sends the waiting frames.
    pub(super) fn perform_actions(
        &mut self,
        connection_state: &ConnectionState,
    ) -> Result<(), SpoolTaskError> {
        if self.live_lane.is_due()
            && let ConnectionState::Open(connection) = connection_state
        {
            let accounting = self.current_accounting();
            self.live_lane.send_update(&mut self.state_machine, connection, self.clock.wall(), accounting);
        }
        while let Some(action) = self.state_machine.next(self.clock.mono()) {
            let request = match action {
                Action::Send(frame) => {
                    // The batch is recorded before it is sent. If the process is killed between these two steps, the
                    // next process queries the aggregator for a batch that the aggregator does not have. That does no
                    // harm.
                    if let Some(sent) = self.state_machine.sent_unspooled() {
                        self.intake.record_sent_unspooled(sent);
                    }
                    self.unsent_frames.push_back(frame);
                    continue;
                }
                Action::Append { batches, totals } => SpoolRequest::Append { batches, totals },
                Action::Load { from, bytes } => SpoolRequest::Load { from, bytes },
                Action::Delete { through, chain } => SpoolRequest::Delete { through, chain },
                Action::Renew { stream, previous_stream, first, events_before_first } => {
                    SpoolRequest::Renew { stream, previous_stream, first, events_before_first }
                }
            };
            self.spool.request(request)?;
        }
        let ConnectionState::Open(connection) = connection_state else { return Ok(()) };
        while let Some(frame) = self.unsent_frames.pop_front() {
            if let Err(unsent) = connection.send(frame) {
                self.unsent_frames.push_front(unsent);
                break;
            }
        }
        Ok(())
    }

    /// Handles a result of the spool's task.
    pub(super) fn handle_spool_result(&mut self, result: SpoolResult) {
        let now = self.clock.stamp();
        let notice = match result {
            SpoolResult::Appended(Ok(())) => {
                let notice = self.state_machine.on_appended(now);
                self.intake.release_runs(&mut self.state_machine);
                notice
            }
            SpoolResult::Appended(Err(reason)) => {
                self.state_machine.on_append_failed(reason.to_string(), now)
            }
            SpoolResult::Loaded(Ok(loaded)) => {
                if let Some(damage) = loaded.damage {
                    self.reports.report_damage(damage);
                }
                self.state_machine.on_loaded(loaded.batches, now)
            }
            SpoolResult::Loaded(Err(reason)) => self.state_machine.on_load_failed(reason.to_string(), now),
            SpoolResult::Deleted(Ok(())) => {
                self.state_machine.on_deleted();
                None
            }
            SpoolResult::Deleted(Err(reason)) => self.state_machine.on_delete_failed(reason.to_string(), now),
            SpoolResult::Renewed(Ok(())) => {
                self.state_machine.on_renewed(now);
                None
            }
            SpoolResult::Renewed(Err(reason)) => self.state_machine.on_renew_failed(reason.to_string(), now),
        };
        if let Some(notice) = notice {
            self.handle_notice(notice);
        }
    }

    /// Handles a received frame. Returns whether it is a message of an aggregator.
    pub(super) fn handle_frame(&mut self, frame: &[u8]) -> bool {
        let message: ToAgent = match codec::decode(frame) {
            Ok(message) => message,
            Err(error) => {
                tracing::warn!(%error, "dropped an invalid message of the aggregator");
                return false;
            }
        };
        if let Some(notice) = self.state_machine.on_message(&message, self.clock.stamp()) {
            self.handle_notice(notice);
        }
        true
    }

    /// Reports a notice of the state machine, and does what the notice requires.
    fn handle_notice(&mut self, notice: Notice) {
        match notice {
            Notice::Welcomed { aggregator, stored, aggregator_lost_batches } => {
                let welcome = Welcome {
                    stored,
                    lacks_batches: aggregator_lost_batches,
                    waiting: self.current_accounting().waiting,
                    unreported_ends: self.live_lane.unreported_ends(),
                };
                self.reports.report_welcome(&aggregator, &welcome);
                // A restarted aggregator has no summaries of the last seconds, so all summaries are sent again.
                self.live_lane.mark_all_unsent();
                if aggregator_lost_batches {
                    self.intake.repeat_run_starts(&mut self.state_machine, self.clock.stamp());
                }
            }
            Notice::Enrolling { aggregator } => {
                self.reports.report_enrollment(&aggregator, self.clock.mono());
            }
            Notice::Refused(reason) => self.reports.report_refusal(&reason),
            Notice::StreamRenewed { stored, newest } => {
                self.reports.report_renewal(stored, newest);
                self.intake.repeat_run_starts(&mut self.state_machine, self.clock.stamp());
            }
            Notice::SpoolFailed(reason) => self.reports.report_spool_failure(&reason),
            Notice::SpoolRecovered => self.reports.report_spool_recovery(),
        }
    }

    /// Returns the state on which the end of the shutdown depends.
    pub(super) fn outbox_state(&self) -> OutboxState {
        let accounting = self.state_machine.accounting();
        OutboxState {
            is_spooled: self.state_machine.is_spooled(),
            is_unreachable: self.is_unreachable,
            stored: accounting.stored,
            waiting: accounting.waiting,
        }
    }

    /// Returns the counts of the state machine, plus the events that are still in the queue.
    pub(super) fn current_accounting(&self) -> Accounting {
        let mut accounting = self.state_machine.accounting();
        self.intake.add_queue_counts(&mut accounting);
        accounting
    }

    /// Publishes the counts of events if they changed, and logs when events are dropped.
    pub(super) fn publish(&mut self) {
        let accounting = self.current_accounting();
        self.reports.report_dropping(&accounting, self.clock.mono());
        self.accounting_sender.send_if_modified(|published| {
            let is_changed = *published != accounting;
            *published = accounting;
            is_changed
        });
    }
}
