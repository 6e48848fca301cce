//! The reflector's socket.

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use peernet_clock::{Interval, RawTime, SharedClock, WallTime};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::complaints::Complaints;
use crate::socket::{ProbeSocket, Received, Token};
use crate::stamp::kernel::KernelStamp;
use crate::stamp::reflector::{Arrival, Reflecting, SessionId};
use crate::stamp::uncertainty::AGREEMENT;
use crate::{Key, ReflectorFigures, Refusal, Stamps};

/// The largest packet that UDP carries.
const MAX_PACKET: usize = 65_535;

/// Errors in a row after which a socket counts as lost.
const MAX_FAILURES: u32 = 100;

/// Stamps of departures that are waited for at most.
const MAX_DEPARTING: usize = 1024;

/// Looks at both clocks that are remembered at most.
const MAX_LOOKS: usize = 8;

/// How a reflector works.
#[derive(Clone, Debug)]
pub struct ReflectorConfig {
    /// Where it listens.
    pub listen: SocketAddr,
    /// With a key, only requests that it authenticates are answered; without, only unauthenticated ones.
    pub key: Option<Key>,
    /// The key that peers are given with their session. Where there is no [`key`](Self::key) that all must have, requests that
    /// it authenticates get authenticated answers, and unauthenticated ones are answered as they are.
    pub session_key: Option<Key>,
    /// A number that this process chose at random: answers tell it, so that a prober knows whose clock they are of.
    pub instance: u64,
    /// Most answers per second to one source: an IPv4 address, or an IPv6 network of 64 bits. All sources that have no
    /// session ([`Reflector::peers`]) get at most ten times as many together.
    pub max_per_source_hz: u32,
    /// Where packet stamps are made.
    pub stamps: Stamps,
    /// Whether sessions are told apart (RFC 8762, section 4): replies are numbered by themselves, so that losses have
    /// a direction, and tell when the previous reply really left.
    pub stateful: bool,
}

/// Why a reflector could not be bound.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// Another program has the port.
    #[error(
        "cannot listen for probes on {0}: the port is in use; stop the other program or configure another port"
    )]
    InUse(SocketAddr),
    /// Ports below 1024 need a capability.
    #[error("cannot listen for probes on {0}: not permitted; grant CAP_NET_BIND_SERVICE or use port 8620")]
    NotPermitted(SocketAddr),
    /// The address is none of this machine.
    #[error(
        "cannot listen for probes on {0}: this machine has no such address; use one of its own, or 0.0.0.0 or [::]"
    )]
    NoSuchAddress(SocketAddr),
    /// Anything else.
    #[error("cannot listen for probes on {listen}: {error}")]
    Other {
        /// Where.
        listen: SocketAddr,
        /// What the system said.
        error: io::Error,
    },
}

/// A reflector cannot receive from its socket any more.
#[derive(Debug, thiserror::Error)]
#[error("cannot receive probes on {listen} any more: {error}")]
pub struct ReceiveError {
    /// Where it listened.
    pub listen: SocketAddr,
    /// What the system said.
    pub error: io::Error,
}

/// Answers probes (the session-reflector of RFC 8762).
///
/// It is of no use for attacks: an answer has the length of its request, each source has a limit, all sources without a
/// session have one together, with a key the rest of the world gets nothing, and what looks like a reply is never answered, so that two reflectors (or a reflector and
/// an echo service) cannot be set on each other. It keeps a bounded memory of sources and sessions.
#[derive(Debug)]
pub struct Reflector {
    socket: ProbeSocket,
    logic: Reflecting,
    clock: SharedClock,
    figures: ReflectorFigures,
    peers: watch::Sender<Vec<IpAddr>>,
    /// Replies whose stamp of departure may still come.
    departing: VecDeque<Departing>,
    /// The latest looks at both clocks, the newest last.
    looks: VecDeque<Look>,
    complaints: Complaints,
}

/// A reply whose stamp of departure may still come.
#[derive(Debug)]
struct Departing {
    token: Token,
    session: SessionId,
    sequence: u32,
    /// How far the wall clock was ahead before it was sent.
    ahead: Interval,
}

/// How far the wall clock was ahead, and a time thereafter.
#[derive(Clone, Copy, Debug)]
struct Look {
    at: RawTime,
    ahead: Interval,
}

impl Reflector {
    /// Binds the socket. Call it inside a tokio runtime.
    ///
    /// # Errors
    /// When the address cannot be had; the error says what to do.
    pub fn bind(config: ReflectorConfig, clock: SharedClock) -> Result<Self, BindError> {
        let listen = config.listen;
        // Only a session remembers when its last reply left.
        let departures = config.stateful;
        let bound = ProbeSocket::bind(listen, config.stamps, departures, clock.clone());
        let socket = bound.map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => BindError::InUse(listen),
            io::ErrorKind::PermissionDenied => BindError::NotPermitted(listen),
            io::ErrorKind::AddrNotAvailable => BindError::NoSuchAddress(listen),
            _ => BindError::Other { listen, error },
        })?;
        Ok(Self {
            socket,
            complaints: Complaints::new(config.key.is_some()),
            logic: Reflecting::new(config.key, config.instance, config.max_per_source_hz, config.stateful)
                .with_session_key(config.session_key),
            clock,
            figures: ReflectorFigures::default(),
            peers: watch::Sender::default(),
            departing: VecDeque::new(),
            looks: VecDeque::new(),
        })
    }

    /// Where it listens, with the port that was really given.
    pub fn address(&self) -> SocketAddr {
        self.socket.address()
    }

    /// What it did; stays valid while it runs.
    pub fn figures(&self) -> ReflectorFigures {
        self.figures.clone()
    }

    /// Where to send the addresses of all peers that have a session with this host, whenever they change: forged source
    /// addresses cannot use up what these are answered.
    pub fn peers(&self) -> watch::Sender<Vec<IpAddr>> {
        self.peers.clone()
    }

    /// In words where its packet stamps are made, as [`Prober::stamps_in_words`](crate::Prober::stamps_in_words).
    pub fn stamps_in_words(&self) -> &'static str {
        self.socket.stamps_in_words()
    }

    /// Answers until stopped.
    ///
    /// # Errors
    /// Only when the socket is lost.
    pub async fn run(mut self, stop: CancellationToken) -> Result<(), ReceiveError> {
        self.socket.check().await;
        self.look();
        let mut buffer = vec![0; MAX_PACKET];
        let mut failures = 0;
        let mut peers = self.peers.subscribe();
        peers.mark_changed();
        loop {
            let failed = tokio::select! {
                biased;
                () = stop.cancelled() => return Ok(()),
                // Before the first probe of a peer whose session was just opened.
                Ok(()) = peers.changed() => {
                    self.logic.set_peers(&peers.borrow_and_update());
                    None
                }
                // Before the next request, which asks for it.
                departure = self.socket.departure() => match departure {
                    Ok((token, left)) => {
                        self.departed(token, left);
                        None
                    }
                    Err(error) => Some(error),
                },
                received = self.socket.receive(&mut buffer) => match received {
                    Ok(received) => {
                        match self.answer(&mut buffer[..received.bytes], &received).await {
                            Ok(()) => self.figures.count_answered(),
                            Err(why) => {
                                self.figures.count_refused(why);
                                self.complain(why, received.source);
                            }
                        }
                        None
                    }
                    Err(error) => Some(error),
                },
            };
            // The system reports trouble of single packets here too.
            match failed {
                None => failures = 0,
                Some(error) if failures < MAX_FAILURES => {
                    tracing::debug!(%error, "a probe could not be received");
                    failures += 1;
                }
                Some(error) => {
                    return Err(ReceiveError { listen: self.address(), error });
                }
            }
        }
    }

    fn complain(&mut self, why: Refusal, source: SocketAddr) {
        if let Some((count, advice)) = self.complaints.due(why, self.clock.mono()) {
            let (why, listen) = (why.in_words(), self.address());
            tracing::warn!(
                %source, %listen, count,
                "a probe was refused: {why}; {advice} (told once a minute at most, with the number since then)"
            );
        }
    }

    async fn answer(&mut self, packet: &mut [u8], received: &Received) -> Result<(), Refusal> {
        let read = self.clock.stamp();
        let kernel = received.kernel.filter(|stamp| *stamp <= read.wall + AGREEMENT);
        if kernel.is_none() && received.kernel.is_some() {
            // Of another clock, or the clock was set back in between.
            self.socket.check().await;
        }
        let before = kernel.and_then(|stamp| self.ahead_before(stamp));
        let ahead = self.look();
        let latest = |stamp| before.map(|before| KernelStamp::between(stamp, before, ahead).latest);
        let arrival = Arrival {
            source: received.source,
            received: kernel.unwrap_or(read.wall),
            // The program's read is the outer bound, which the kernel's stamp may narrow.
            received_raw: kernel.and_then(latest).map_or(read.raw, |latest| latest.min(read.raw)),
            now: read.mono,
        };
        let answer = self.logic.prepare(packet, &arrival)?;
        let from = (!received.local.ip().is_unspecified()).then_some(received.local);
        let stamp = self.logic.complete(&answer, packet, &*self.clock);
        let sent = self.socket.send(packet, from, received.source, Duration::ZERO).await;
        let token = sent.map_err(|error| {
            tracing::debug!(to = %received.source, %error, "a probe's answer could not be sent");
            Refusal::NotSent
        })?;
        self.logic.sent(&answer, stamp);
        if let Some(token) = token {
            if self.departing.len() >= MAX_DEPARTING {
                self.departing.pop_front();
            }
            let (session, sequence) = (answer.session(), answer.sequence());
            self.departing.push_back(Departing { token, session, sequence, ahead });
        }
        Ok(())
    }

    fn departed(&mut self, token: Token, left: Option<WallTime>) {
        // Stamps come in the order of departure; those of dropped packets never do.
        let Some(found) = self.departing.iter().position(|departing| departing.token == token) else {
            return;
        };
        let named = self.departing.drain(..=found).next_back();
        if let (Some(Departing { session, sequence, ahead, .. }), Some(left)) = (named, left) {
            let left_raw = KernelStamp::between(left, ahead, self.look()).earliest;
            self.logic.departed(&session, sequence, left, left_raw);
        }
    }

    /// Looks how far the wall clock is ahead, and remembers it.
    fn look(&mut self) -> Interval {
        let ahead = self.clock.wall_ahead();
        let at = self.clock.raw();
        if self.looks.len() >= MAX_LOOKS {
            self.looks.pop_front();
        }
        self.looks.push_back(Look { at, ahead });
        ahead
    }

    /// How far the wall clock was ahead at the newest look that was certainly before the kernel's stamp; `None` where all that are
    /// remembered may have been after it.
    fn ahead_before(&self, stamp: WallTime) -> Option<Interval> {
        let newest = self.looks.back()?.ahead;
        let is_before = |look: &&Look| look.at < KernelStamp::between(stamp, look.ahead, newest).earliest;
        self.looks.iter().rev().find(is_before).map(|look| look.ahead)
    }
}
