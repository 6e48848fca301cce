//! What cannot be made safe before the end is counted.

use tokio::time::Instant;

use super::Sender;
use crate::outbox::spool::{Done, Order, SpoolTaskError};

impl Sender {
    /// What is in memory only is lost with it; how much that is goes into the spool, for the next start to tell.
    pub(super) async fn give_up(&mut self, by: Instant) {
        if self.machine.is_spooled() {
            return;
        }
        self.take();
        if self.machine.is_appending() {
            // It may still get there.
            let appended = self.appended(by).await;
            self.spooled(Done::Appended(appended));
        }
        if self.machine.is_spooled() {
            return;
        }
        let counted = self.exit.counter.all().is_some();
        let unsafe_events = self.machine.unspooled_events();
        if counted && self.machine.has_sent_unspooled() {
            // What of it is stored is asked of the aggregator: to write that all is lost would be wrong.
            tracing::warn!(
                events = unsafe_events,
                "stopped before these events were in the spool or known to be stored; after the next start a gap will say \
                 which are lost"
            );
            return;
        }
        let dropped = self.machine.accounting().dropped;
        let totals = self.machine.give_up();
        let events = totals.dropped - dropped;
        let order = Order::Append { batches: Vec::new(), totals };
        let kept = match self.spool.order(order) {
            Ok(()) => self.appended(by).await,
            refused => refused,
        };
        match kept {
            Ok(()) => tracing::warn!(
                events,
                "stopped before these events were in the spool or stored: they are lost, and a gap will say so after \
                 the next start"
            ),
            Err(reason) if counted => tracing::warn!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost, and a gap will say so after \
                 the next start"
            ),
            Err(reason) => tracing::error!(
                events,
                %reason,
                "stopped before these events were in the spool or stored: they are lost, and no gap will say so"
            ),
        }
    }

    /// What becomes of the write to the spool that is under way.
    async fn appended(&mut self, by: Instant) -> Result<(), SpoolTaskError> {
        loop {
            match tokio::time::timeout_at(by, self.spool.done()).await {
                Ok(Some(Done::Appended(appended))) => return appended,
                Ok(Some(_)) => {}
                Ok(None) => return Err(SpoolTaskError::Ended),
                Err(_) => return Err(SpoolTaskError::Slow),
            }
        }
    }
}
