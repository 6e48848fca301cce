//! All links of the agent.

use std::collections::BTreeMap;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use futures::FutureExt;
use peernet_clock::{RelatedClocks, Span};
use peernet_logger::{HostId, Slug};
use peernet_networks::{Address, CompletedRequest, SessionAccepted};
use peernet_stream::{Hardware, LinkLive, NetworkName};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::cloud_link::CloudLink;
use super::probing;
use super::shared::{LinkContext, ProbeSettings, Session, SharedLinkState, lock};
use crate::config::ClockConfig;
use crate::same_clock::ClockSocket;

/// The links by cloud. Clones share the links.
#[derive(Clone, Debug)]
pub(crate) struct Links(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    shared: Arc<SharedLinkState>,
    by_cloud: Mutex<BTreeMap<HostId, Arc<CloudLink>>>,
    /// Latest cloud of each pipeline.
    serving_cloud: Mutex<BTreeMap<Slug, Cloud>>,
    /// Tracker of the tasks. Each link has one task, which ends with the link's last session.
    tasks: TaskTracker,
    /// Latest panic of one of these tasks; `None` if no task has panicked.
    task_panic: watch::Sender<Option<LinkPanic>>,
    next_session: AtomicU64,
    /// Number of sessions that have ended.
    ended_sessions: AtomicU64,
}

/// Description of a cloud, from its acceptance of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Random identifier of the host; stays the same when the host is renamed.
    pub id: HostId,
    /// Version of the host's program.
    pub version: String,
    /// Hardware of the host.
    pub hardware: Hardware,
}

/// Error for a panic in the task of a link.
#[derive(Clone, Debug, thiserror::Error)]
#[error("the task of the link to {peer} panicked; see the log for the location in the code")]
pub(crate) struct LinkPanic {
    peer: Slug,
}

/// Membership of a session in a link. The link ends when the membership of its last session is dropped.
#[derive(Debug)]
pub(crate) struct LinkedSession {
    link: Arc<CloudLink>,
    links: Links,
    session: u64,
    network: NetworkName,
}

impl Links {
    /// Creates an empty registry.
    pub(crate) fn new(host: LinkContext, clock: &ClockConfig, probes: ProbeSettings) -> Self {
        let shared = Arc::new(SharedLinkState { host, relation: clock.relation_settings(), probes });
        Self(Arc::new(Inner {
            shared,
            by_cloud: Mutex::default(),
            serving_cloud: Mutex::default(),
            tasks: TaskTracker::new(),
            task_panic: watch::Sender::new(None),
            next_session: AtomicU64::new(0),
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
    ) -> LinkedSession {
        let accepted = session.accepted();
        let cloud = Cloud {
            id: accepted.host,
            version: accepted.version.clone(),
            hardware: accepted.hardware.clone(),
        };
        lock(&self.0.serving_cloud).insert(pipeline.clone(), cloud);
        let clocks = session.clocks();
        let own_identity = self.0.shared.host.clock.identity();
        // Only two free-running clocks can be proven to be one clock, and only if both hosts use the same name for
        // their clock.
        let may_share_clock =
            clocks == RelatedClocks::Raw && own_identity.may_share_clock_with(&accepted.clock);
        let clock_socket = clock_socket.filter(|_| may_share_clock);
        let new_session = Session {
            id: self.0.next_session.fetch_add(1, Ordering::Relaxed),
            pipeline: pipeline.clone(),
            network: NetworkName::from(address.network()),
            host: cloud_host(session, address),
            probe_port: accepted.probes,
            instance: accepted.instance,
            probe_key: accepted.probe_key,
            clock: session.peer_clock(),
            clock_peers: clock_socket.map(|socket| socket.into_peers(session.id())).unwrap_or_default(),
            statistics: session.statistics_reader(),
        };
        let (id, network) = (new_session.id, new_session.network.clone());
        let mut links_by_cloud = self.lock_links();
        // The links stay locked until the session has joined: `LinkedSession::drop` must not remove the link before.
        let existing_link =
            links_by_cloud.get(&accepted.host).filter(|link| is_same_cloud(link, accepted, clocks));
        let link = match existing_link {
            Some(link) => {
                link.join(new_session);
                Arc::clone(link)
            }
            None => {
                let link = Arc::new(CloudLink::new(&self.0.shared, accepted, clocks));
                link.join(new_session);
                links_by_cloud.insert(accepted.host, Arc::clone(&link));
                self.0.tasks.spawn(self.clone().supervise(Arc::clone(&link)));
                link
            }
        };
        drop(links_by_cloud);
        LinkedSession { link, links: self.clone(), session: id, network }
    }

    /// Returns the latest cloud of a pipeline, whose session may have ended.
    pub(crate) fn serving_cloud(&self, pipeline: &Slug) -> Option<Cloud> {
        lock(&self.0.serving_cloud).get(pipeline).cloned()
    }

    /// Returns the live state of all links.
    pub(crate) fn live(&self) -> Vec<LinkLive> {
        // The list is cloned, so that sessions can open and close while the links are read.
        let links: Vec<_> = self.lock_links().values().cloned().collect();
        links.iter().flat_map(|link| link.live()).collect()
    }

    /// Returns the number of sessions that have ended since the agent started; each had one connection.
    pub(crate) fn ended_sessions(&self) -> u64 {
        self.0.ended_sessions.load(Ordering::Relaxed)
    }

    /// Supervises the links' tasks until `stop` is cancelled and all sessions have ended.
    ///
    /// # Errors
    /// When one of the tasks panicked.
    pub(crate) async fn run(self, stop: CancellationToken) -> Result<(), LinkPanic> {
        let mut task_panic = self.0.task_panic.subscribe();
        let all_sessions_ended = async {
            stop.cancelled().await;
            self.0.tasks.close();
            self.0.tasks.wait().await;
        };
        tokio::select! {
            biased;
            // A link without its task would silently lose its clock relation, so a panic of the task ends the agent.
            panic = task_panic.wait_for(Option::is_some) => match panic {
                Ok(panic) => panic.clone().map_or(Ok(()), Err),
                Err(_) => Ok(()),
            },
            () = all_sessions_ended => Ok(()),
        }
    }

    /// Runs the task of a link.
    async fn supervise(self, link: Arc<CloudLink>) {
        let peer = link.name().clone();
        if AssertUnwindSafe(probing::run_link_task(link)).catch_unwind().await.is_err() {
            self.0.task_panic.send_replace(Some(LinkPanic { peer }));
        }
    }

    fn lock_links(&self) -> MutexGuard<'_, BTreeMap<HostId, Arc<CloudLink>>> {
        lock(&self.0.by_cloud)
    }
}

impl LinkedSession {
    /// Judges the delays of an answered request of the session, and sets them in its tree. Returns the sum of both
    /// delays by the hosts' monotonic clocks.
    pub(crate) fn correct(&self, completed: &mut CompletedRequest) -> Option<Span> {
        self.link.correct(&self.network, completed)
    }
}

impl std::ops::Deref for LinkedSession {
    type Target = CloudLink;

    fn deref(&self) -> &CloudLink {
        &self.link
    }
}

impl Drop for LinkedSession {
    fn drop(&mut self) {
        // The links are locked during both steps: a session that opens in between must not join a link that is being
        // removed.
        let mut links_by_cloud = self.links.lock_links();
        let all_sessions_ended = self.link.leave(self.session, &self.network);
        if all_sessions_ended
            && links_by_cloud.get(&self.link.cloud.id).is_some_and(|link| Arc::ptr_eq(link, &self.link))
        {
            links_by_cloud.remove(&self.link.cloud.id);
        }
        self.links.0.ended_sessions.fetch_add(1, Ordering::Relaxed);
    }
}

/// Returns the host that answers probes: the host of the address, or for the address of a name service the host at the
/// other end of the connection.
fn cloud_host(session: &peernet_networks::Session, address: &Address) -> String {
    // In an address with the name of a listener, the host is the host of the name service.
    let remote_addresses = address.listener_name().and_then(|_| session.statistics_reader().addresses());
    remote_addresses.map_or_else(|| address.host(), |addresses| addresses.remote.ip().to_string())
}

/// Returns whether the accepted session is with the same process and clock as the link, so the link's relation is
/// still valid. A restarted process counts the epochs of its clock from 0 again.
fn is_same_cloud(link: &CloudLink, accepted: &SessionAccepted, clocks: RelatedClocks) -> bool {
    let instance = link.sessions.borrow().first().map(|session| session.instance);
    link.cloud.clock == accepted.clock && link.cloud.clocks == clocks && instance == Some(accepted.instance)
}
