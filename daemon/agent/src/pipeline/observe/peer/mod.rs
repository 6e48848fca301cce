//! The other agent that observes the same messages on its host.
//!
//! [`PeerStamps`] is the observer's end of a task of its own, so that waiting for the network never holds up the messages.
//! `connection` is the session with the peer, `pending` the pairs that wait for it, without I/O, and `task` drives both.

mod connection;
mod pending;
mod silence;
mod task;

use std::net::IpAddr;

use peernet_clock::Stamp;
use peernet_logger::{Slug, Tree};
use peernet_stream::Condition;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use self::connection::PeerConnector;
use self::task::PeerTask;
use super::record::{self, Input, Received, Uncounted};
use crate::config::ObserveConfig;
use crate::host::Host;
use crate::pipeline::progress::Position;
use crate::pipeline::runner::Runner;

/// Iterations of a pipeline that may wait for the peer; more are recorded without its stamps.
const MAX_PENDING: usize = 1024;

/// A pair of messages that belong together.
#[derive(Debug)]
pub(in crate::pipeline::observe) struct Pair {
    pub(in crate::pipeline::observe) input: Input,
    pub(in crate::pipeline::observe) output: Received,
    pub(in crate::pipeline::observe) uncounted: Uncounted,
}

/// The tree of a pair, with what the peer knows of it.
#[derive(Debug)]
pub(super) struct SettledPair {
    pub(super) position: Position,
    pub(super) tree: Tree,
    pub(super) ended: Stamp,
}

/// What the observer holds of the peer.
pub(super) struct PeerStamps {
    /// `None` when nothing is asked any more.
    ask: Option<mpsc::Sender<(i64, Pair)>>,
    settled: mpsc::Receiver<SettledPair>,
    /// Pairs that were handed over and did not come back.
    waiting: usize,
    told: PeerTold,
    task: JoinHandle<()>,
}

/// What the peer told of itself when the session was opened, for the run's page.
#[derive(Clone, Debug)]
pub(super) struct PeerTold {
    pub(super) name: Slug,
    pub(super) facts: Vec<(String, String)>,
    pub(super) conditions: Vec<Condition>,
    /// Addresses of the peer's host.
    pub(super) addresses: Vec<IpAddr>,
}

impl PeerTold {
    /// Whether a host of this address is the peer's.
    pub(super) fn is_at(&self, host: Option<&str>) -> bool {
        let address: Option<IpAddr> = host.and_then(|host| host.parse().ok());
        address.is_some_and(|address| self.addresses.contains(&address))
    }
}

impl PeerStamps {
    /// Opens a session with the peer of a pipeline, however long that takes. `None` without a peer, and when the agent stops.
    pub(super) async fn open(runner: &Runner, config: &ObserveConfig) -> Option<Self> {
        let connector = PeerConnector::new(runner, config)?;
        let connection = connector.connect_first(runner).await?;
        let told = connection.told().await;
        let (ask, asked) = mpsc::channel(MAX_PENDING);
        let (settle, settled) = mpsc::channel(MAX_PENDING);
        let task = tokio::spawn(PeerTask::new(connector, asked, settle).run(connection));
        Some(Self { ask: Some(ask), settled, waiting: 0, told, task })
    }

    pub(super) const fn told(&self) -> &PeerTold {
        &self.told
    }

    /// Asks the peer about a pair. Gives it back where too many wait, or nothing is asked any more.
    pub(super) fn ask(&mut self, key: i64, pair: Pair) -> Result<(), Box<Pair>> {
        let Some(ask) = self.ask.as_ref().filter(|_| self.waiting < MAX_PENDING) else {
            return Err(Box::new(pair));
        };
        ask.try_send((key, pair)).map_err(|refused| Box::new(refused.into_inner().1))?;
        self.waiting += 1;
        Ok(())
    }

    /// Waits for the next pair that the peer told of, or that was given up. Dropping the future loses none.
    pub(super) async fn next(&mut self) -> SettledPair {
        if self.waiting > 0
            && let Some(settled) = self.settled.recv().await
        {
            self.waiting -= 1;
            return settled;
        }
        if self.waiting > 0 {
            // The task has panicked, which the log says: nothing is waited for any more.
            (self.ask, self.waiting) = (None, 0);
        }
        std::future::pending().await
    }

    /// Whether nothing waits.
    pub(super) const fn is_settled(&self) -> bool {
        self.waiting == 0
    }

    /// Gives up all that waits. Returns it, as far as the peer told of it.
    pub(super) async fn give_up(&mut self) -> Vec<SettledPair> {
        self.ask = None;
        let mut settled = Vec::with_capacity(self.waiting);
        while let Some(pair) = self.settled.recv().await {
            settled.push(pair);
        }
        self.waiting = 0;
        settled
    }

    /// Takes leave of the peer.
    pub(super) async fn close(mut self) {
        self.ask = None;
        if self.task.await.is_err() {
            tracing::error!("the task that asks the peer for stamps panicked; the log says where");
        }
    }
}

/// Records a pair of which the peer told nothing.
pub(super) fn record_without_peer(host: &Host, pair: &Pair) -> SettledPair {
    let (tree, ended) = record::answered_without_peer((&host.clock, host.id), pair);
    SettledPair { position: pair.input.position, tree, ended }
}
