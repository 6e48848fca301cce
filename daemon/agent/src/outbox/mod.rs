//! The way to the aggregator: events that must all arrive, and live figures that must be fresh.
//!
//! Pipelines hand their events to the [`Feed`] and go on. One task takes them from there, drives the sending end
//! of the event stream (`peernet_logger::stream::Sending`, which batches, numbers, spools and repeats), and owns
//! the connection. The spool behind it is in memory; the one on disk takes its place in [`Outbox::start`].

mod connection;
mod farewell;
mod feed;
mod sender;
mod tap;

pub(crate) use feed::{Exit, Feed};
pub(crate) use tap::Tap;

use peernet_clock::{SharedClock, Span};
use peernet_logger::stream::{
    Accounting, HostDescription, HostMetrics, MemorySpool, Sending, SendingConfig, Usage,
};
use peernet_networks::Address;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use self::sender::Sender;
use crate::config::HostConfig;
use crate::host::Host;
use crate::live::Board;
use crate::pauses::Pauses;
use crate::tasks::Failure;

/// Batches under way at once: enough to keep the aggregator busy over one round trip and one write to its disk,
/// few enough that a live update behind them is still live.
const WINDOW: u64 = 4;

/// Where events go in, and the end at which [`Outbox::start`] takes them out; nowhere without an aggregator.
pub(crate) fn entrance(config: &HostConfig, clock: &SharedClock) -> (Feed, Option<Exit>) {
    if config.aggregator.is_none() {
        return (Feed::nowhere(), None);
    }
    let (feed, exit) = feed::channel(SharedClock::clone(clock));
    (feed, Some(exit))
}

/// The outbox task.
#[derive(Debug)]
pub(crate) struct Outbox {
    task: JoinHandle<()>,
    /// Takes the moment by which it must have ended.
    stop: oneshot::Sender<Instant>,
    ended: CancellationToken,
    accounting: watch::Receiver<Accounting>,
}

impl Outbox {
    /// Starts sending to `address`.
    pub(crate) fn start(
        config: &HostConfig,
        address: Address,
        exit: Exit,
        description: HostDescription,
        live: (Board, watch::Receiver<HostMetrics>),
        host: &Host,
    ) -> Self {
        let spool = MemorySpool::new(Usage {
            events: config.queue_events.get() as u64,
            bytes: config.queue_bytes.get() as u64,
        });
        let process = Uuid::new_v4().as_u64_pair().0;
        let machine = Sending::new(sending(config), description, process, spool);
        let (publish, accounting) = watch::channel(Accounting::default());
        let ((stop, told), ended) = (oneshot::channel(), CancellationToken::new());
        let sender = Sender::new(machine, exit, live, publish, host);
        let work = sender.run(address, Pauses::new(host.id), told);
        let guard = ended.clone().drop_guard();
        let task = tokio::spawn(async move {
            let _ended = guard;
            work.await;
        });
        Self { task, stop, ended, accounting }
    }

    /// Cancelled when the task has ended, however that came.
    pub(crate) fn ended(&self) -> CancellationToken {
        self.ended.clone()
    }

    /// What became of the events.
    pub(crate) fn accounting(&self) -> Accounting {
        *self.accounting.borrow()
    }

    /// Hands over what there is until `deadline`, and takes leave.
    pub(crate) async fn close(self, deadline: Instant) -> Result<(), Failure> {
        // A task that has ended already says why below.
        let _ = self.stop.send(deadline);
        self.task.await.map_err(|error| Failure { part: "outbox".to_owned(), reason: error.to_string() })
    }
}

fn sending(config: &HostConfig) -> SendingConfig {
    let standard = SendingConfig::default();
    SendingConfig {
        batch_nodes: config.batch_nodes.get(),
        batch_bytes: config.batch_bytes.get(),
        batch_age: Span::from_millis(config.batch_delay_ms.into()),
        window: WINDOW,
        reserve_events: standard.reserve_events.min(config.queue_events.get() as u64 / 8),
        ..standard
    }
}
