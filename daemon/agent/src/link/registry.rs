//! All links of the agent.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use futures::FutureExt;
use peernet_clock::{RelatedClocks, Span};
use peernet_logger::{HostId, Slug};
use peernet_networks::{Address, Exchange, SessionAccepted};
use peernet_stream::{Hardware, LinkLive, NetworkName};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::pair::Link;
use super::probing;
use super::shared::{LinkContext, ProbeSettings, Session, Shared, lock};
use crate::config::ClockConfig;
use crate::same_clock::ClockSocket;

/// The links by cloud; clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Links(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    shared: Arc<Shared>,
    open: Mutex<BTreeMap<HostId, Arc<Link>>>,
    /// Latest cloud of each pipeline.
    serving_cloud: Mutex<BTreeMap<Slug, Cloud>>,
    /// Tracker of the tasks: one per link, which ends with the link's last session.
    tasks: TaskTracker,
    /// First panic of one of these tasks.
    died: watch::Sender<Option<LinkPanic>>,
    sessions: AtomicU64,
    /// Number of sessions that are over.
    ended_sessions: AtomicU64,
}

/// Description of a cloud, as it introduced itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Random identifier of the host; stays the same when the host is renamed.
    pub id: HostId,
    /// Version of its program.
    pub version: String,
    /// Hardware of the host.
    pub hardware: Hardware,
}

/// Error for a panic in the task of a link.
#[derive(Clone, Debug, thiserror::Error)]
#[error("the task of the link to {peer} panicked; the log says where")]
pub(crate) struct LinkPanic {
    peer: Slug,
}

/// A session's share in a link. The link is over when the last one is dropped.
#[derive(Debug)]
pub(crate) struct Attached {
    link: Arc<Link>,
    links: Links,
    session: u64,
    network: NetworkName,
}

impl Links {
    /// Creates an empty registry.
    pub(crate) fn new(host: LinkContext, clock: &ClockConfig, probes: ProbeSettings) -> Self {
        let shared = Arc::new(Shared { host, relation: clock.relation_settings(), probes });
        Self(Arc::new(Inner {
            shared,
            open: Mutex::default(),
            serving_cloud: Mutex::default(),
            tasks: TaskTracker::new(),
            died: watch::Sender::new(None),
            sessions: AtomicU64::new(0),
            ended_sessions: AtomicU64::new(0),
        }))
    }

    /// Adds a session of `pipeline` with the cloud at `address` to the link of that cloud, which is created if
    /// necessary. `clock_socket` is the socket that the session's hello named.
    pub(crate) fn attach(
        &self,
        session: &peernet_networks::Session,
        address: &Address,
        pipeline: &Slug,
        clock_socket: Option<ClockSocket>,
    ) -> Attached {
        let accepted = session.accepted();
        let cloud = Cloud {
            id: accepted.host,
            version: accepted.version.clone(),
            hardware: accepted.hardware.clone(),
        };
        lock(&self.0.serving_cloud).insert(pipeline.clone(), cloud);
        let clocks = session.clocks();
        let own = self.0.shared.host.clock.identity();
        // A proof is of use only between free-running clocks, and only if both hosts use the same name for their
        // clock.
        let may_be_one = clocks == RelatedClocks::Raw && own.may_be_one_with(&accepted.clock);
        let clock_socket = clock_socket.filter(|_| may_be_one);
        let joining = Session {
            id: self.0.sessions.fetch_add(1, Ordering::Relaxed),
            pipeline: pipeline.clone(),
            network: NetworkName::from(address.network()),
            host: cloud_host(session, address),
            probes: accepted.probes,
            instance: accepted.instance,
            probe_key: accepted.probe_key,
            clock: session.peer_clock(),
            clock_peers: clock_socket.map(|socket| socket.connected(session.id())).unwrap_or_default(),
            statistics: session.statistics_reader(),
        };
        let (id, network) = (joining.id, joining.network.clone());
        let mut open = self.open();
        let known = open.get(&accepted.host).filter(|link| is_same_cloud(link, accepted, clocks));
        let link = match known {
            Some(link) => {
                link.join(joining);
                Arc::clone(link)
            }
            None => {
                let link = Arc::new(Link::new(&self.0.shared, accepted, clocks));
                link.join(joining);
                open.insert(accepted.host, Arc::clone(&link));
                self.0.tasks.spawn(self.clone().maintain(Arc::clone(&link)));
                link
            }
        };
        drop(open);
        Attached { link, links: self.clone(), session: id, network }
    }

    /// Returns the latest cloud of a pipeline, which may be gone.
    pub(crate) fn serving_cloud(&self, pipeline: &Slug) -> Option<Cloud> {
        lock(&self.0.serving_cloud).get(pipeline).cloned()
    }

    /// Returns the live state of all links.
    pub(crate) fn live(&self) -> Vec<LinkLive> {
        // Cloned, so that sessions can open and close while the links are read.
        let links: Vec<_> = self.open().values().cloned().collect();
        links.iter().flat_map(|link| link.live()).collect()
    }

    /// Returns the number of sessions that are over since the agent started; each had one connection.
    pub(crate) fn ended_sessions(&self) -> u64 {
        self.0.ended_sessions.load(Ordering::Relaxed)
    }

    /// Supervises the links' tasks until `stop` is cancelled and all sessions are over.
    ///
    /// # Errors
    /// When one of the tasks panicked.
    pub(crate) async fn run(self, stop: CancellationToken) -> Result<(), LinkPanic> {
        let mut died = self.0.died.subscribe();
        let over = async {
            stop.cancelled().await;
            self.0.tasks.close();
            self.0.tasks.wait().await;
        };
        tokio::select! {
            biased;
            // A link without its task would silently stop to learn, so that its panic ends the agent.
            panic = died.wait_for(Option::is_some) => match panic {
                Ok(panic) => panic.clone().map_or(Ok(()), Err),
                Err(_) => Ok(()),
            },
            () = over => Ok(()),
        }
    }

    /// Runs the task of a link.
    async fn maintain(self, link: Arc<Link>) {
        let peer = link.name().clone();
        if AssertUnwindSafe(probing::maintain(link)).catch_unwind().await.is_err() {
            self.0.died.send_replace(Some(LinkPanic { peer }));
        }
    }

    fn open(&self) -> MutexGuard<'_, BTreeMap<HostId, Arc<Link>>> {
        lock(&self.0.open)
    }
}

impl Attached {
    /// Judges the delays of an answered exchange of the session, and sets them in its tree. Returns the sum of both
    /// directions by the hosts' monotonic clocks.
    pub(crate) fn correct(&self, exchange: &mut Exchange) -> Option<Span> {
        self.link.correct(&self.network, exchange)
    }
}

impl std::ops::Deref for Attached {
    type Target = Link;

    fn deref(&self) -> &Link {
        &self.link
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        // Locked during both steps, because a session that opens meanwhile must not join a link that is being
        // removed.
        let mut open = self.links.open();
        let over = self.link.leave(self.session, &self.network);
        if over && open.get(&self.link.cloud.id).is_some_and(|link| Arc::ptr_eq(link, &self.link)) {
            open.remove(&self.link.cloud.id);
        }
        self.links.0.ended_sessions.fetch_add(1, Ordering::Relaxed);
    }
}

/// Returns the host that answers probes. If the address is that of a name service, it is the host at the other end of
/// the connection.
fn cloud_host(session: &peernet_networks::Session, address: &Address) -> String {
    let connected = address.listener_name().and_then(|_| session.statistics_reader().addresses());
    connected.map_or_else(|| address.host(), |addresses| addresses.remote.ip().to_string())
}

/// Returns whether the link's knowledge of the cloud is still valid. A program that was restarted counts its clock's
/// epochs from 0 again, and its clock may have been set in between.
fn is_same_cloud(link: &Link, accepted: &SessionAccepted, clocks: RelatedClocks) -> bool {
    let known = link.sessions.borrow().first().map(|session| session.instance);
    link.cloud.clock == accepted.clock && link.cloud.clocks == clocks && known == Some(accepted.instance)
}
