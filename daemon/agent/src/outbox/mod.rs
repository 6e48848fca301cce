//! The outbox: sends durable events and live updates to the aggregator.
//!
//! Tasks add their events to the [`EventQueue`](crate::event_queue::EventQueue) and continue. The outbox task takes the
//! events from the queue and owns the connection. The task drives the sending end of the event stream
//! (`peernet_stream::Sending`), a state machine that batches, numbers and resends. A second task owns the [spool], the
//! file in which batches are safe until the aggregator has stored them. Therefore neither the outbox nor a live update
//! waits for a disk.
//!
//! A batch is sent after it was written to the spool. While the spool's disk fails, batches are sent from memory,
//! because otherwise the batches would be stored nowhere.
//!
//! The queue, the batches in memory, the spool and the batches in flight are bounded. If all are full, the newest event
//! is dropped and counted by run, and a gap is inserted. At all times `produced = stored + waiting + dropped`.

mod connection;
mod connection_state;
mod dropping;
mod live_sources;
mod reports;
mod sender;
mod shutdown;
mod spool;

pub use connection::reach_aggregator;
pub(crate) use live_sources::LiveSources;
pub(crate) use spool::{FileKind, OpenSpool};
pub use spool::{
    InspectError, Inspection, SpoolDamage, SpoolDefect, SpoolError, SpoolReadError, inspect, pending_events,
};

use std::time::Duration;

use peernet_clock::{SharedClock, Span};
use peernet_logger::HostId;
use peernet_networks::Address;
use peernet_stream::{Accounting, HostDescription, HostSecret, Sending, SendingConfig, Usage};
use tokio::sync::{oneshot, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;
use uuid::Uuid;

use self::reports::Reports;
use self::sender::Sender;
use self::spool::{SpoolTask, SpoolTaskError};
use crate::config::{AgentConfig, SpoolConfig};
use crate::event_queue::QueueReceiver;
use crate::incidents::Incidents;
use crate::reconnect_backoff::ReconnectBackoff;
use crate::runs::Runs;
use crate::tasks::{Failure, FailureCause};

/// Maximum number of batches of usual length in flight.
// The number keeps the aggregator busy for a round trip and a write to its disk. It is so small that a live update
// behind these batches is still current.
const WINDOW: u32 = 32;
/// Capacity in memory that is reserved for events other than iterations, as a number of events.
const RESERVED_EVENTS: u64 = 1024;

/// Opens the spool of this host; returns `None` without an aggregator.
///
/// # Errors
/// When the spool cannot be opened.
pub(crate) async fn open_spool(
    config: &AgentConfig,
    host: HostId,
    clock: &SharedClock,
) -> Result<Option<OpenSpool>, SpoolError> {
    if config.agent.aggregator.is_none() {
        return Ok(None);
    }
    let path = config.spool.path(&config.agent.state_dir);
    let is_default_path = path == SpoolConfig::default().path(&config.agent.state_dir);
    OpenSpool::open(&path, host, is_default_path, clock).await.map(Some)
}

/// The parts of the agent that the outbox uses.
#[derive(Debug)]
pub(crate) struct OutboxContext {
    pub(crate) clock: SharedClock,
    /// Receives the incidents of the outbox.
    pub(crate) incidents: Incidents,
    pub(crate) runs: Runs,
    pub(crate) live: LiveSources,
}

/// Handle of the outbox task. Dropping the handle aborts the task, as a crash would.
#[derive(Debug)]
pub(crate) struct Outbox {
    task: AbortOnDropHandle<Result<(), SpoolTaskError>>,
    /// Channel for the deadline by which the task must end.
    stop: oneshot::Sender<Instant>,
    ended: CancellationToken,
    accounting: watch::Receiver<Accounting>,
}

impl Outbox {
    /// Starts the task that sends to `address`.
    pub(crate) fn start(
        config: &AgentConfig,
        address: Address,
        receiver: QueueReceiver,
        spool: OpenSpool,
        (description, secret): (HostDescription, HostSecret),
        context: OutboxContext,
    ) -> Self {
        // The event queue already has the counter.
        let OpenSpool { file, state, quarantined, was_empty, counter: _ } = spool;
        let OutboxContext { clock, incidents, runs, live } = context;
        let reports = Reports::new(incidents);
        if let Some(quarantined) = &quarantined {
            reports.report_quarantine(quarantined);
        }
        if was_empty {
            reports.report_empty_spool(file.path());
        }
        // The spool records which process sent which batch. The number is random, because process ids of the operating
        // system are used again.
        let process_number = Uuid::new_v4().as_u64_pair().0;
        let reconnect_backoff = ReconnectBackoff::new(description.id);
        let state_machine = Sending::new(sending_config(config), description, secret, process_number, state);
        let (accounting_sender, accounting) = watch::channel(state_machine.accounting());
        let ((stop, stop_receiver), ended) = (oneshot::channel(), CancellationToken::new());
        let spool = SpoolTask::start(file, config.spool.sync_interval());
        let sender =
            Sender::new(state_machine, spool, receiver, accounting_sender, reports, clock, (runs, live));
        // The future is boxed, because it contains the large state machine.
        let work = Box::pin(sender.run(address, reconnect_backoff, stop_receiver));
        let cancel_on_end = ended.clone().drop_guard();
        let task = tokio::spawn(async move {
            let _cancel_on_end = cancel_on_end;
            work.await
        });
        Self { task: AbortOnDropHandle::new(task), stop, ended, accounting }
    }

    /// Returns a token that is cancelled when the task has ended for any reason.
    pub(crate) fn ended(&self) -> CancellationToken {
        self.ended.clone()
    }

    /// Returns the current counts of events.
    pub(crate) fn accounting(&self) -> Accounting {
        self.accounting.borrow().clone()
    }

    /// Waits until the aggregator has stored all events, until it has stored no event for `progress_timeout`, or until
    /// the task has ended.
    pub(crate) async fn wait_until_delivered(&self, progress_timeout: Duration) {
        let mut accounting = self.accounting.clone();
        loop {
            let Accounting { stored, waiting, .. } = *accounting.borrow_and_update();
            if waiting == 0 {
                return;
            }
            let progress = accounting.wait_for(|current| current.waiting == 0 || current.stored > stored);
            // Other changes of the counts, such as new waiting events, are no progress.
            if !matches!(tokio::time::timeout(progress_timeout, progress).await, Ok(Ok(_))) {
                return;
            }
        }
    }

    /// Stops the task. The task writes all events to the spool, sends events until `deadline` at most, and sends a
    /// goodbye.
    pub(crate) async fn close(self, deadline: Instant) -> Result<(), Failure> {
        // If the task has already ended, the send fails, and the task's result below is the reason.
        let _ = self.stop.send(deadline);
        let failure = |cause| Failure { part: "outbox".to_owned(), cause };
        let task_result = self.task.await.map_err(|join_error| failure(join_error.into()))?;
        task_result.map_err(|error| failure(FailureCause::Failed(Box::new(error))))
    }
}

fn sending_config(config: &AgentConfig) -> SendingConfig {
    let AgentConfig { agent, spool, .. } = config;
    let memory = Usage { events: agent.queue_events.get() as u64, bytes: agent.queue_bytes.get() as u64 };
    SendingConfig {
        batch_nodes: agent.batch_nodes.get(),
        batch_bytes: agent.batch_bytes.get(),
        batch_age: Span::from_millis(agent.batch_delay_ms.into()),
        window: WINDOW,
        spool_bytes: spool.limit_bytes.get(),
        memory,
        // If the configured memory is small, most of it must remain for iterations.
        reserve_events: RESERVED_EVENTS.min(memory.events / 8),
        compression: spool.compression.into(),
        // The first and the longest pause before batches are sent again to an aggregator whose queue is full; both are
        // longer than the round trip of any link.
        first_pause: Span::from_seconds(1),
        longest_pause: Span::from_seconds(10),
        refused_pause: Span::from_seconds(1),
        ack_timeout: Span::from_seconds(10),
        spool_pause: Span::from_seconds(1),
    }
}
