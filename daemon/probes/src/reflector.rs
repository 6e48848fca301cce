//! The reflector: receives requests and sends answers, with its socket.

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use peernet_clock::{Interval, RawTime, SharedClock, WallTime};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::refusal_log::RefusalLog;
use crate::socket::{ProbeSocket, ReceivedPacket, Token};
use crate::stamp::kernel::KernelStamp;
use crate::stamp::reflector::{Arrival, ReflectorState, SessionId};
use crate::stamp::uncertainty::ORDER_TOLERANCE;
use crate::{Key, ReflectorCounters, Refusal, TimestampSource};

/// Largest packet of UDP. Bytes.
// An answer is written into the buffer of its request and has the same length, so a request must not be truncated.
const MAX_PACKET_BYTES: usize = 65_535;

/// Number of successive errors after which the socket counts as lost.
const MAX_FAILURES: u32 = 100;

/// Maximum number of sent replies whose departure stamps are awaited. A further reply replaces the oldest.
const MAX_AWAITED_DEPARTURES: usize = 1024;

/// Maximum number of remembered comparisons of the wall clock with the free-running clock.
// The kernel stamps a request when it arrives. While the request waits in the socket, each answer to an earlier request
// compares the clocks. The newest comparison from before the stamp may therefore be several comparisons ago.
const MAX_COMPARISONS: usize = 8;

/// Configuration of a reflector.
#[derive(Clone, Debug)]
pub struct ReflectorConfig {
    /// Address to listen on.
    pub listen: SocketAddr,
    /// Key that requests must be authenticated by. `None` answers unauthenticated requests.
    pub key: Option<Key>,
    /// Key that peers get with their session, used if there is no [`key`](Self::key). Requests with this key get
    /// authenticated answers; unauthenticated requests get unauthenticated answers.
    pub session_key: Option<Key>,
    /// Random number of this process. Answers carry it, so that a prober knows whose clock stamped them.
    pub instance: u64,
    /// Maximum number of answers per second to one source: an IPv4 address, or an IPv6 network of 64 bits. All sources
    /// without a session ([`Reflector::peers`]) together get at most ten times as many.
    pub max_per_source_hz: u32,
    /// Source of the packet stamps.
    pub stamps: TimestampSource,
    /// `true` if sessions are distinguished (RFC 8762, section 4). Replies then have numbers of their own, so that
    /// losses can be attributed to a direction, and report the true departure of the previous reply.
    pub stateful: bool,
}

/// Reason why a reflector could not be bound.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// Another program uses the port.
    #[error(
        "cannot listen for probes on {0}: the port is in use; stop the other program or configure another port"
    )]
    InUse(SocketAddr),
    /// Ports below 1024 need a capability.
    #[error("cannot listen for probes on {0}: not permitted; grant CAP_NET_BIND_SERVICE or use port 8620")]
    NotPermitted(SocketAddr),
    /// The address does not belong to this machine.
    #[error(
        "cannot listen for probes on {0}: this machine has no such address; use one of its addresses, or 0.0.0.0 or [::]"
    )]
    NoSuchAddress(SocketAddr),
    /// Another error.
    #[error("cannot listen for probes on {listen}: {error}")]
    Other {
        /// Address to listen on.
        listen: SocketAddr,
        /// Error of the system.
        error: io::Error,
    },
}

/// Error: a reflector cannot receive from its socket any more.
#[derive(Debug, thiserror::Error)]
#[error("cannot receive probes on {listen} any more: {error}")]
pub struct ReceiveError {
    /// Address that the reflector listened on.
    pub listen: SocketAddr,
    /// Error of the system.
    pub error: io::Error,
}

/// Answers probes (session-reflector of RFC 8762).
///
/// A reflector cannot amplify an attack on third parties: an answer has the length of its request, each source has a
/// rate limit, and all sources without a session share another rate limit. With a key, only requests with that key are
/// answered. A packet that looks like a reply is never answered, so that two reflectors, or a reflector and an echo
/// service, cannot form a loop. The memory for sources and sessions is bounded.
#[derive(Debug)]
pub struct Reflector {
    socket: ProbeSocket,
    state: ReflectorState,
    clock: SharedClock,
    counters: ReflectorCounters,
    /// Addresses of the peers that have a session with this host.
    peers: watch::Sender<Vec<IpAddr>>,
    /// Replies whose departure stamps may still come, oldest first.
    awaited_departures: VecDeque<DepartingReply>,
    /// Latest comparisons of the wall clock with the free-running clock, oldest first.
    comparisons: VecDeque<ClockComparison>,
    refusal_log: RefusalLog,
}

/// A reply whose departure stamp may still come.
#[derive(Debug)]
struct DepartingReply {
    token: Token,
    session: SessionId,
    sequence: u32,
    /// Difference wall clock minus free-running clock, read before the reply was sent.
    ahead: Interval,
}

/// A comparison of the wall clock with the free-running clock.
#[derive(Clone, Copy, Debug)]
struct ClockComparison {
    /// Time just after the comparison.
    at: RawTime,
    /// Difference wall clock minus free-running clock.
    ahead: Interval,
}

impl Reflector {
    /// Binds the socket. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// If the address cannot be bound. The error says what to do.
    pub fn bind(config: ReflectorConfig, clock: SharedClock) -> Result<Self, BindError> {
        let listen = config.listen;
        // Departures are stamped only for STAMP sessions, which store the departure of their last reply.
        let with_departure_stamps = config.stateful;
        let socket = ProbeSocket::bind(listen, config.stamps, with_departure_stamps, clock.clone());
        let socket = socket.map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => BindError::InUse(listen),
            io::ErrorKind::PermissionDenied => BindError::NotPermitted(listen),
            io::ErrorKind::AddrNotAvailable => BindError::NoSuchAddress(listen),
            _ => BindError::Other { listen, error },
        })?;
        Ok(Self {
            socket,
            refusal_log: RefusalLog::new(config.key.is_some()),
            state: ReflectorState::new(
                config.key,
                config.instance,
                config.max_per_source_hz,
                config.stateful,
            )
            .with_session_key(config.session_key),
            clock,
            counters: ReflectorCounters::default(),
            peers: watch::Sender::default(),
            awaited_departures: VecDeque::new(),
            comparisons: VecDeque::new(),
        })
    }

    /// Returns the address of the socket, with the actual port.
    pub fn address(&self) -> SocketAddr {
        self.socket.address()
    }

    /// Returns a handle to the counters, which remains valid while the reflector runs.
    pub fn counters(&self) -> ReflectorCounters {
        self.counters.clone()
    }

    /// Returns a sender for the addresses of all peers that have a session with this host. The caller sends them
    /// whenever they change. Packets with forged source addresses do not use up the rate of these peers.
    pub fn peers(&self) -> watch::Sender<Vec<IpAddr>> {
        self.peers.clone()
    }

    /// Returns the source of the packet stamps, as [`Prober::stamp_source_name`](crate::Prober::stamp_source_name)
    /// does.
    pub fn stamp_source_name(&self) -> &'static str {
        self.socket.stamp_source_name()
    }

    /// Answers requests until stopped.
    ///
    /// # Errors
    /// If the socket is lost.
    pub async fn run(mut self, stop: CancellationToken) -> Result<(), ReceiveError> {
        self.socket.check_kernel_stamps().await;
        self.compare_clocks();
        let mut buffer = vec![0; MAX_PACKET_BYTES];
        let mut failures = 0;
        let mut peers = self.peers.subscribe();
        // A new receiver counts the present value as seen. Peers may have been set before this call.
        peers.mark_changed();
        loop {
            let error = tokio::select! {
                biased;
                () = stop.cancelled() => return Ok(()),
                // Polled first, so that a peer is known before the first probe of its new session.
                Ok(()) = peers.changed() => {
                    self.state.set_peers(&peers.borrow_and_update());
                    None
                }
                // Polled before the next request, whose answer reports the stamp.
                departure = self.socket.departure() => match departure {
                    Ok((token, departed_at)) => {
                        self.record_departure(token, departed_at);
                        None
                    }
                    Err(error) => Some(error),
                },
                received = self.socket.receive(&mut buffer) => match received {
                    Ok(received) => {
                        match self.answer(&mut buffer[..received.bytes], &received).await {
                            Ok(()) => self.counters.count_answered(),
                            Err(reason) => {
                                self.counters.count_refused(reason);
                                self.log_refusal(reason, received.source);
                            }
                        }
                        None
                    }
                    Err(error) => Some(error),
                },
            };
            // Receiving also returns errors of single packets, so only many successive errors mean that the socket is
            // lost.
            match error {
                None => failures = 0,
                Some(error) if failures < MAX_FAILURES => {
                    tracing::debug!(%error, "failed to receive a probe or a departure stamp");
                    failures += 1;
                }
                Some(error) => {
                    return Err(ReceiveError { listen: self.address(), error });
                }
            }
        }
    }

    fn log_refusal(&mut self, reason: Refusal, source: SocketAddr) {
        if let Some((count, advice)) = self.refusal_log.record(reason, self.clock.mono()) {
            let (reason, listen) = (reason.description(), self.address());
            tracing::warn!(
                %source, %listen, count,
                "refused a probe: {reason}; {advice} (logged at most once a minute; count has the number since the last line)"
            );
        }
    }

    /// Answers a packet if it is a request that may be answered.
    async fn answer(&mut self, packet: &mut [u8], received: &ReceivedPacket) -> Result<(), Refusal> {
        let read = self.clock.stamp();
        let kernel_stamp = received.kernel_stamp.filter(|stamp| *stamp <= read.wall + ORDER_TOLERANCE);
        if kernel_stamp.is_none() && received.kernel_stamp.is_some() {
            // The stamp is of another clock, or the clock was set back in between.
            self.socket.check_kernel_stamps().await;
        }
        let earlier_difference = kernel_stamp.and_then(|stamp| self.difference_before(stamp));
        let ahead = self.compare_clocks();
        let latest_arrival = |stamp| {
            earlier_difference.map(|earlier| KernelStamp::from_comparisons(stamp, earlier, ahead).latest)
        };
        let arrival = Arrival {
            source: received.source,
            received: kernel_stamp.unwrap_or(read.wall),
            // This time must not be before the arrival. The program reads the clock after the arrival; the kernel's
            // stamp may give a time that is closer to the arrival.
            received_raw: kernel_stamp
                .and_then(latest_arrival)
                .map_or(read.raw, |latest| latest.min(read.raw)),
            now: read.mono,
        };
        let answer = self.state.prepare(packet, &arrival)?;
        // The answer is sent from the address to which the request was sent, if the system reported that address.
        let from = (!received.local.ip().is_unspecified()).then_some(received.local);
        let stamp = self.state.complete(&answer, packet, &*self.clock);
        let sent = self.socket.send(packet, from, received.source, Duration::ZERO).await;
        let token = sent.map_err(|error| {
            tracing::debug!(to = %received.source, %error, "failed to send the answer to a probe");
            Refusal::NotSent
        })?;
        self.state.record_sent(&answer, stamp);
        if let Some(token) = token {
            if self.awaited_departures.len() >= MAX_AWAITED_DEPARTURES {
                self.awaited_departures.pop_front();
            }
            let (session, sequence) = (answer.session(), answer.sequence());
            self.awaited_departures.push_back(DepartingReply { token, session, sequence, ahead });
        }
        Ok(())
    }

    /// Handles the kernel's stamp of a reply's departure.
    fn record_departure(&mut self, token: Token, departed_at: Option<WallTime>) {
        // Stamps come in the order of departure. The stamps of dropped packets never come.
        let Some(index) = self.awaited_departures.iter().position(|reply| reply.token == token) else {
            return;
        };
        let reply = self.awaited_departures.drain(..=index).next_back();
        if let (Some(DepartingReply { session, sequence, ahead, .. }), Some(departed_at)) =
            (reply, departed_at)
        {
            let departed_at_raw =
                KernelStamp::from_comparisons(departed_at, ahead, self.compare_clocks()).earliest;
            self.state.record_departure(&session, sequence, departed_at, departed_at_raw);
        }
    }

    /// Compares the wall clock with the free-running clock. Remembers and returns the difference.
    fn compare_clocks(&mut self) -> Interval {
        let ahead = self.clock.wall_ahead();
        let at = self.clock.raw();
        if self.comparisons.len() >= MAX_COMPARISONS {
            self.comparisons.pop_front();
        }
        self.comparisons.push_back(ClockComparison { at, ahead });
        ahead
    }

    /// Returns the difference of the clocks at the newest comparison that was certainly before the kernel's stamp.
    /// `None` if all remembered comparisons may have been after the stamp.
    fn difference_before(&self, stamp: WallTime) -> Option<Interval> {
        let newest = self.comparisons.back()?.ahead;
        let is_before = |comparison: &&ClockComparison| {
            comparison.at < KernelStamp::from_comparisons(stamp, comparison.ahead, newest).earliest
        };
        self.comparisons.iter().rev().find(is_before).map(|comparison| comparison.ahead)
    }
}
