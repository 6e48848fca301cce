//! The prober: sends probes and receives answers, with its socket and timers.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use peernet_clock::{ExchangeObservation, MonoTime, RelatedClocks, SharedClock, WallTime};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::schedule::Schedule;
use crate::socket::{ProbeSocket, Received, Token};
use crate::stamp::sender::{LATE, ReplyArrival, SenderConfig, SenderState};
use crate::{Key, Stamps};

/// Largest reply without its padding. Bytes.
const MAX_REPLY: usize = 2048;

/// Time limit for sending a probe. A probe that takes longer is given up because its stamp becomes old. The first one
/// waits until the runtime knows the socket.
const SEND_PATIENCE: Duration = Duration::from_millis(20);

/// Largest number of awaited departure stamps.
const MAX_DEPARTING: usize = 64;

const FAILURE_PAUSE: Duration = Duration::from_millis(5);

/// Configuration of a prober.
#[derive(Clone, Debug)]
pub struct ProberConfig {
    /// Address of the reflector.
    pub target: SocketAddr,
    /// Key shared with the reflector; `None` sends unauthenticated probes.
    pub key: Option<Key>,
    /// Process that must answer, by its [`ReflectorConfig::instance`](crate::ReflectorConfig). It is the process that
    /// serves the data and whose clock is measured. `None` accepts any reflector, including other implementations.
    pub instance: Option<u64>,
    /// Clocks of the exchanges: both free-running clocks, which needs a reflector of PEERNet 0.3.0 or later, or this
    /// host's free-running clock and the reflector's wall clock.
    pub clocks: RelatedClocks,
    /// Bytes of padding (value of an Extra Padding TLV, RFC 8972, section 4.1); 0 for none.
    pub padding_bytes: u16,
    /// Source of the packet stamps.
    pub stamps: Stamps,
    /// Time after which a probe without an answer counts as lost.
    pub timeout: Duration,
}

/// Event of a probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeResult {
    /// The probe was sent.
    Sent,
    /// The probe was answered.
    Answered(ExchangeObservation),
    /// The probe was answered, but this host's free-running clock was interrupted in between, so that nothing follows
    /// from its stamps. The value is the clock's new epoch.
    Stepped(u32),
    /// An exchange that was reported as answered, with a better stamp of the reply's departure.
    Refined(ExchangeObservation),
    /// No answer arrived within the timeout.
    Lost,
    /// The answer to a lost probe arrived after all.
    Late,
    /// A packet that is not a valid answer arrived, or a probe could not be sent, for this reason.
    Refused(&'static str),
}

/// Reason why a prober could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The system provides no socket for this target.
    #[error(
        "cannot open a socket for probes to {target}: {error}; this host lacks that address family or has too many \
         open files"
    )]
    Socket {
        /// Address of the reflector.
        target: SocketAddr,
        /// Error of the system.
        error: io::Error,
    },
}

/// Probes one reflector (session-sender of RFC 8762).
#[derive(Debug)]
pub struct Prober {
    config: ProberConfig,
    clock: SharedClock,
    socket: ProbeSocket,
    logic: SenderState,
    /// Probes whose departure stamps may still come.
    departing: VecDeque<(Token, u32)>,
}

impl Prober {
    /// Opens the socket. Sends nothing yet. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// If there is no socket for the target.
    pub fn open(config: ProberConfig, clock: SharedClock) -> Result<Self, OpenError> {
        let target = config.target;
        let socket = ProbeSocket::open_for_target(target, config.stamps, clock.clone())
            .map_err(|error| OpenError::Socket { target, error })?;
        // Not zero: reflectors that do not know session identifiers leave zero.
        let ssid = rand::random_range(1..=u16::MAX);
        let logic = SenderState::new(SenderConfig {
            key: config.key.clone(),
            instance: config.instance,
            // Other implementations need not return the octets.
            bound: config.instance.is_some(),
            clocks: config.clocks,
            ssid,
            first: 0,
            padding_bytes: config.padding_bytes,
            timeout: config.timeout.into(),
        });
        Ok(Self { config, clock, socket, logic, departing: VecDeque::new() })
    }

    /// Returns the source of the packet stamps: `kernel, send and receive`, `kernel, receive only`, or `program`.
    pub fn stamps_in_words(&self) -> &'static str {
        self.socket.stamps_in_words()
    }

    /// Checks that the kernel stamps by the clock that the program reads; otherwise its stamps are not used.
    /// [`run`](Self::run) does the same. After an earlier call, [`stamps_in_words`](Self::stamps_in_words) returns its
    /// final value.
    pub async fn check_stamps(&mut self) {
        self.socket.check().await;
        if self.socket.is_distrusted() {
            self.distrust_kernel();
        }
    }

    fn distrust_kernel(&mut self) {
        self.socket.disable_kernel_stamps();
        self.logic.distrust_kernel();
        self.config.stamps = Stamps::Program;
    }

    /// Sends `rate_hz` probes per second until stopped or until the receiver of `results` is dropped. A rate of 0 sends
    /// none; the largest rate is 1,000. A new rate applies at once. While `results` is full, nothing is sent or
    /// received.
    pub async fn run(
        mut self,
        mut rate_hz: watch::Receiver<f64>,
        results: mpsc::Sender<ProbeResult>,
        stop: CancellationToken,
    ) {
        self.check_stamps().await;
        let mut schedule = Schedule::new(*rate_hz.borrow_and_update(), self.clock.mono());
        let mut buffer = vec![0; MAX_REPLY + usize::from(self.config.padding_bytes)];
        let mut rate_is_fixed = false;
        loop {
            let mut pending_results = PendingResults::default();
            let wake = [schedule.due(), self.logic.deadline()].into_iter().flatten().min();
            tokio::select! {
                biased;
                () = stop.cancelled() => return,
                () = results.closed() => return,
                // Before the reply, because the stamp belongs to the reply's exchange.
                departure = self.socket.departure() => match departure {
                    Ok((token, left)) => self.departed(token, left),
                    Err(error) => self.failed(&error).await,
                },
                received = self.socket.receive(&mut buffer) => match received {
                    Ok(received) => {
                        self.handle_packet(&buffer[..received.bytes], &received, &mut pending_results);
                    }
                    Err(error) => self.failed(&error).await,
                },
                changed = rate_hz.changed(), if !rate_is_fixed => match changed {
                    Ok(()) => schedule.change(*rate_hz.borrow_and_update(), self.clock.mono()),
                    Err(_) => rate_is_fixed = true,
                },
                () = sleep_until(wake, &self.clock) => {
                    let now = self.clock.mono();
                    pending_results.lost(self.logic.expire(now));
                    if schedule.is_due(now) {
                        schedule.advance(now);
                        self.send(&mut pending_results).await;
                    }
                }
            }
            for result in pending_results.0 {
                tokio::select! {
                    biased;
                    () = stop.cancelled() => return,
                    sent = results.send(result) => if sent.is_err() { return },
                }
            }
        }
    }

    async fn send(&mut self, pending_results: &mut PendingResults) {
        let (departure, packet) = self.logic.request(&*self.clock);
        match self.socket.send(packet, None, self.config.target, SEND_PATIENCE).await {
            Ok(token) => {
                pending_results.lost(self.logic.sent(departure));
                if let Some(token) = token {
                    if self.departing.len() >= MAX_DEPARTING {
                        self.departing.pop_front();
                    }
                    self.departing.push_back((token, departure.sequence()));
                }
                pending_results.push(ProbeResult::Sent);
            }
            Err(error) => {
                tracing::debug!(target = %self.config.target, %error, "a probe could not be sent");
                pending_results.push(ProbeResult::Refused(not_sent_in_words(&error)));
                self.renew();
            }
        }
    }

    /// Opens a new socket, whose count of packets starts from zero. A packet that was refused on its way may have used
    /// a number in the kernel's count but not in the socket's. Later departure stamps would then belong to other
    /// packets.
    fn renew(&mut self) {
        if !self.socket.stamps_departures() {
            return;
        }
        match ProbeSocket::open_for_target(self.config.target, self.config.stamps, self.clock.clone()) {
            Ok(socket) => {
                self.socket = socket;
                self.departing.clear();
            }
            Err(error) => tracing::debug!(%error, "no new socket for probes: the old one is kept"),
        }
    }

    fn departed(&mut self, token: Token, left: Option<WallTime>) {
        // Stamps come in the order of departure. Those of dropped packets never come.
        let Some(found) = self.departing.iter().position(|(departing, _)| *departing == token) else {
            return;
        };
        let named = self.departing.drain(..=found).next_back();
        if let (Some((_, sequence)), Some(left)) = (named, left) {
            self.logic.departed(sequence, left, self.clock.wall_ahead());
        }
    }

    fn handle_packet(&mut self, packet: &[u8], received: &Received, pending_results: &mut PendingResults) {
        let read = self.clock.stamp();
        let (from, target) = (received.source, self.config.target);
        // A packet from elsewhere is not an answer, even if its contents fit.
        if from.port() != target.port() || from.ip() != target.ip() {
            pending_results.push(ProbeResult::Refused("not from the target"));
            return;
        }
        let (ahead, epoch) = (self.clock.wall_ahead(), self.clock.epoch());
        let returned = ReplyArrival { kernel: received.kernel, read, ahead, epoch };
        pending_results.lost(self.logic.expire(read.mono));
        let reply = self.logic.receive(packet, &returned);
        if self.logic.distrusts_kernel() && !self.socket.is_distrusted() {
            self.distrust_kernel();
        }
        match reply {
            Ok(reply) => {
                pending_results.0.extend(reply.refined.map(ProbeResult::Refined));
                let stepped = ProbeResult::Stepped(returned.epoch);
                pending_results.push(reply.answered.map_or(stepped, ProbeResult::Answered));
            }
            Err(LATE) => pending_results.push(ProbeResult::Late),
            Err(why) => pending_results.push(ProbeResult::Refused(why)),
        }
    }

    /// Waits shortly after an error. The system also reports errors of single packets on receiving; a permanent error
    /// must not cause a busy loop.
    async fn failed(&mut self, error: &io::Error) {
        tracing::debug!(target = %self.config.target, %error, "a probe's reply could not be received");
        tokio::time::sleep(FAILURE_PAUSE).await;
    }
}

/// Events of one pass of the loop.
#[derive(Default)]
struct PendingResults(Vec<ProbeResult>);

impl PendingResults {
    fn push(&mut self, result: ProbeResult) {
        self.0.push(result);
    }

    fn lost(&mut self, count: usize) {
        self.0.extend(std::iter::repeat_n(ProbeResult::Lost, count));
    }
}

fn not_sent_in_words(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::WouldBlock => "not sent: the socket is busy",
        io::ErrorKind::NetworkUnreachable => "not sent: the network is unreachable",
        io::ErrorKind::HostUnreachable => "not sent: the host is unreachable",
        io::ErrorKind::PermissionDenied => "not sent: a firewall of this machine refuses it",
        io::ErrorKind::NetworkDown => "not sent: the network is down",
        _ => "not sent: the system refuses it",
    }
}

async fn sleep_until(wake: Option<MonoTime>, clock: &SharedClock) {
    match wake {
        Some(wake) => tokio::time::sleep((wake - clock.mono()).to_duration()).await,
        None => std::future::pending().await,
    }
}
