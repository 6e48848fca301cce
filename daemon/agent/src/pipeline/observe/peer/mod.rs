//! The agent on another host that observes the same messages there.
//!
//! [`PeerStamps`] is the handle by which the observer uses a task. The task owns the connection to the peer, so that
//! waiting for the network does not delay messages; the number of waiting pairs is bounded. `connection` is the
//! connection to the peer, `pending` has the pairs that wait for an answer (without I/O), and `task` drives both.
//!
//! Both stamps of an observed message are receptions, one by each agent; its departure has no stamp. Therefore a
//! message does not bound the offset of the clocks: the clock relation judges its delays but does not learn from them,
//! and a delay may be negative.

mod connection;
mod pending;
mod reception;
mod task;

use std::net::IpAddr;

use peernet_clock::Stamp;
use peernet_logger::{Slug, Tree};
use peernet_stream::Condition;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use self::connection::PeerConnector;
use self::task::PeerTask;
use super::record::{self, Input, ReceivedMessage, UnpairedCounts};
use crate::config::ObserveConfig;
use crate::host::Host;
use crate::pipeline::progress::Position;
use crate::pipeline::runner::Runner;

/// Maximum number of pairs that wait for the peer. Further pairs are recorded without the peer's stamps.
const MAX_PENDING: usize = 1024;

/// An input message and the output message that belongs to it.
#[derive(Debug)]
pub(in crate::pipeline::observe) struct Pair {
    pub(in crate::pipeline::observe) input: Input,
    pub(in crate::pipeline::observe) output: ReceivedMessage,
    pub(in crate::pipeline::observe) unpaired_counts: UnpairedCounts,
}

/// The tree of a pair, with those stamps of the pair that the peer has sent.
#[derive(Debug)]
pub(super) struct SettledPair {
    pub(super) position: Position,
    pub(super) tree: Tree,
    /// Time at which the iteration ended.
    pub(super) ended: Stamp,
}

/// Handle of the task that queries the peer.
pub(super) struct PeerStamps {
    /// Channel of pairs to query, each with its key; `None` once no further pairs are queried.
    queries: Option<mpsc::Sender<(i64, Pair)>>,
    settled_pairs: mpsc::Receiver<SettledPair>,
    /// Number of pairs that were sent to the task and are not settled.
    waiting_pairs: usize,
    peer_description: PeerDescription,
    task: JoinHandle<()>,
}

/// Description of the peer from the opening of the connection, for the run's page.
#[derive(Clone, Debug)]
pub(super) struct PeerDescription {
    pub(super) name: Slug,
    pub(super) facts: Vec<(String, String)>,
    pub(super) conditions: Vec<Condition>,
    /// Addresses of the peer's host.
    pub(super) addresses: Vec<IpAddr>,
}

impl PeerDescription {
    /// Returns whether `host` is an IP address of the peer's host.
    pub(super) fn is_at(&self, host: Option<&str>) -> bool {
        let address: Option<IpAddr> = host.and_then(|host| host.parse().ok());
        address.is_some_and(|address| self.addresses.contains(&address))
    }
}

impl PeerStamps {
    /// Opens a connection to the peer of a pipeline, and retries until that succeeds. Returns `None` if the
    /// pipeline has no peer, or if the agent stops.
    pub(super) async fn open(runner: &Runner, config: &ObserveConfig) -> Option<Self> {
        let connector = PeerConnector::new(runner, config)?;
        let connection = connector.connect_first(runner).await?;
        let peer_description = connection.peer_description().await;
        let (queries, query_receiver) = mpsc::channel(MAX_PENDING);
        let (settled_sender, settled_pairs) = mpsc::channel(MAX_PENDING);
        let task = tokio::spawn(PeerTask::new(connector, query_receiver, settled_sender).run(connection));
        Some(Self { queries: Some(queries), settled_pairs, waiting_pairs: 0, peer_description, task })
    }

    pub(super) const fn peer_description(&self) -> &PeerDescription {
        &self.peer_description
    }

    /// Queries the peer for the stamps of a pair. Returns the pair as an error if too many pairs wait, or if the task
    /// has ended.
    pub(super) fn query(&mut self, key: i64, pair: Pair) -> Result<(), Box<Pair>> {
        // The task takes waiting pairs out of the channel, so the capacity of the channel does not limit the number of
        // waiting pairs.
        let Some(queries) = self.queries.as_ref().filter(|_| self.waiting_pairs < MAX_PENDING) else {
            return Err(Box::new(pair));
        };
        queries.try_send((key, pair)).map_err(|unsent| Box::new(unsent.into_inner().1))?;
        self.waiting_pairs += 1;
        Ok(())
    }

    /// Waits for the next pair that the peer has answered or that has expired. Cancel-safe.
    pub(super) async fn next(&mut self) -> SettledPair {
        if self.waiting_pairs > 0
            && let Some(settled_pair) = self.settled_pairs.recv().await
        {
            self.waiting_pairs -= 1;
            return settled_pair;
        }
        if self.waiting_pairs > 0 {
            // The task has panicked, which is logged: no further answers will arrive.
            (self.queries, self.waiting_pairs) = (None, 0);
        }
        std::future::pending().await
    }

    /// Returns whether no pair waits for the peer.
    pub(super) const fn has_no_waiting_pairs(&self) -> bool {
        self.waiting_pairs == 0
    }

    /// Ends the wait of all pairs. Returns the pairs with the stamps that the peer has sent so far.
    pub(super) async fn abandon(&mut self) -> Vec<SettledPair> {
        self.queries = None;
        let mut settled_pairs = Vec::with_capacity(self.waiting_pairs);
        while let Some(pair) = self.settled_pairs.recv().await {
            settled_pairs.push(pair);
        }
        self.waiting_pairs = 0;
        settled_pairs
    }

    /// Closes the connection to the peer.
    pub(super) async fn close(mut self) {
        self.queries = None;
        if self.task.await.is_err() {
            tracing::error!(
                "the task that queries the peer for stamps panicked; see the log for the location in the code"
            );
        }
    }
}

/// Records a pair without stamps of the peer.
pub(super) fn record_without_peer(host: &Host, pair: &Pair) -> SettledPair {
    let (tree, ended) = record::tree_without_peer_stamps((&host.clock, host.id), pair);
    SettledPair { position: pair.input.position, tree, ended }
}
