//! The prober: sends probes and receives answers, with its socket and timers.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use peernet_clock::{ExchangeObservation, MonoTime, RelatedClocks, SharedClock, WallTime};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::schedule::Schedule;
use crate::socket::{ProbeSocket, ReceivedPacket, Token};
use crate::stamp::sender::{LATE_REPLY, ReplyArrival, SenderConfig, SenderState};
use crate::{Key, TimestampSource};

/// Largest reply without its padding. Bytes.
const MAX_REPLY_BYTES: usize = 2048;

/// Time limit for sending a probe. A probe that takes longer is dropped.
// The limit is short, because the stamp in a probe that waits becomes old. The limit is not 0, because the first probe
// must wait until the runtime has registered the socket.
const SEND_TIMEOUT: Duration = Duration::from_millis(20);

/// Maximum number of sent probes whose departure stamps are awaited. A further probe replaces the oldest.
const MAX_AWAITED_DEPARTURES: usize = 64;

/// Pause after a socket error.
const ERROR_PAUSE: Duration = Duration::from_millis(5);

/// Configuration of a prober.
#[derive(Clone, Debug)]
pub struct ProberConfig {
    /// Address of the reflector.
    pub target: SocketAddr,
    /// Key shared with the reflector; `None` sends unauthenticated probes.
    pub key: Option<Key>,
    /// Number of the process that must answer, [`ReflectorConfig::instance`](crate::ReflectorConfig): the process that
    /// serves the data and whose clock is measured. `None` accepts any reflector, including other implementations.
    pub instance: Option<u64>,
    /// Clocks that the exchanges relate: either the free-running clocks of both hosts, for which the reflector must be
    /// PEERNet 0.3.0 or later, or this host's free-running clock and the reflector's wall clock.
    pub clocks: RelatedClocks,
    /// Number of padding bytes (value of an Extra Padding TLV, RFC 8972, section 4.1); 0 for none.
    pub padding_bytes: u16,
    /// Source of the packet stamps.
    pub stamps: TimestampSource,
    /// Time after which a probe without an answer counts as lost.
    pub timeout: Duration,
}

/// Event of probing. Events are reported in the order in which they occur.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeResult {
    /// The probe was sent.
    Sent,
    /// The probe was answered.
    Answered(ExchangeObservation),
    /// The probe was answered, but this host's free-running clock was interrupted in between, so the stamps cannot
    /// be compared. The value is the clock's new epoch.
    ClockInterrupted(u32),
    /// An exchange that was reported as [`Answered`](Self::Answered) before, now with a better stamp of the reply's
    /// departure.
    Refined(ExchangeObservation),
    /// No answer arrived within the timeout.
    Lost,
    /// The answer to a lost probe arrived after all.
    Late,
    /// A packet arrived that is not a valid answer, or a probe could not be sent. The value is the reason.
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
    sender: SenderState,
    /// Probes whose departure stamps may still arrive, oldest first: the socket's token and the number of each probe.
    awaited_departures: VecDeque<(Token, u32)>,
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
        // Zero is excluded, because a reflector that does not know session identifiers leaves zero in its answer.
        let ssid = rand::random_range(1..=u16::MAX);
        let sender = SenderState::new(SenderConfig {
            key: config.key.clone(),
            instance: config.instance,
            // A nonce is random octets that the answer must return. Only a PEERNet reflector, which `instance`
            // identifies, gets a nonce, because other implementations need not return the octets.
            with_nonce: config.instance.is_some(),
            clocks: config.clocks,
            ssid,
            first_sequence: 0,
            padding_bytes: config.padding_bytes,
            timeout: config.timeout.into(),
        });
        Ok(Self { config, clock, socket, sender, awaited_departures: VecDeque::new() })
    }

    /// Returns the source of the packet stamps: `kernel, send and receive`, `kernel, receive only`, or `program`.
    pub fn stamp_source_name(&self) -> &'static str {
        self.socket.stamp_source_name()
    }

    /// Checks that the kernel stamps packets by the clock that the program reads. Otherwise the kernel's stamps are
    /// ignored from now on.
    /// [`run`](Self::run) does this check, too. A caller that needs the final
    /// [`stamp_source_name`](Self::stamp_source_name) before `run` must call this function first.
    pub async fn check_stamps(&mut self) {
        self.socket.check_kernel_stamps().await;
        if self.socket.are_kernel_stamps_disabled() {
            self.ignore_kernel_stamps();
        }
    }

    fn ignore_kernel_stamps(&mut self) {
        self.socket.disable_kernel_stamps();
        self.sender.ignore_kernel_stamps();
        self.config.stamps = TimestampSource::Program;
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
        let mut buffer = vec![0; MAX_REPLY_BYTES + usize::from(self.config.padding_bytes)];
        // After the sender of `rate_hz` is dropped, each call of `changed` returns at once, which would be a busy loop.
        let mut rate_is_fixed = false;
        loop {
            let mut pending_results = PendingResults::default();
            let wake_up_at = [schedule.due(), self.sender.deadline()].into_iter().flatten().min();
            tokio::select! {
                biased;
                () = stop.cancelled() => return,
                () = results.closed() => return,
                // The departure stamp is polled before the reply, because the reply completes the exchange to which the
                // stamp belongs.
                departure = self.socket.departure() => match departure {
                    Ok((token, departed_at)) => self.record_departure(token, departed_at),
                    Err(error) => self.pause_after_error(&error).await,
                },
                received = self.socket.receive(&mut buffer) => match received {
                    Ok(received) => {
                        self.handle_packet(&buffer[..received.bytes], &received, &mut pending_results);
                    }
                    Err(error) => self.pause_after_error(&error).await,
                },
                changed = rate_hz.changed(), if !rate_is_fixed => match changed {
                    Ok(()) => schedule.set_rate(*rate_hz.borrow_and_update(), self.clock.mono()),
                    Err(_) => rate_is_fixed = true,
                },
                () = sleep_until(wake_up_at, &self.clock) => {
                    let now = self.clock.mono();
                    pending_results.push_lost(self.sender.expire(now));
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

    /// Sends a probe.
    async fn send(&mut self, pending_results: &mut PendingResults) {
        let (departure, packet) = self.sender.request(&*self.clock);
        match self.socket.send(packet, None, self.config.target, SEND_TIMEOUT).await {
            Ok(token) => {
                // If `sender` is full, the new probe replaces the oldest, which counts as lost if it was not answered.
                pending_results.push_lost(self.sender.record_sent(departure));
                if let Some(token) = token {
                    if self.awaited_departures.len() >= MAX_AWAITED_DEPARTURES {
                        self.awaited_departures.pop_front();
                    }
                    self.awaited_departures.push_back((token, departure.sequence()));
                }
                pending_results.push(ProbeResult::Sent);
            }
            Err(error) => {
                tracing::debug!(target = %self.config.target, %error, "failed to send a probe");
                pending_results.push(ProbeResult::Refused(send_error_text(&error)));
                self.reopen_socket();
            }
        }
    }

    /// Replaces the socket by a new one, whose count of packets starts from zero. Does nothing if the kernel does not
    /// stamp departures.
    // The kernel may have counted a packet that could not be sent, while the socket did not count this packet. Each
    // later departure stamp would then be attributed to another packet.
    fn reopen_socket(&mut self) {
        if !self.socket.stamps_departures() {
            return;
        }
        match ProbeSocket::open_for_target(self.config.target, self.config.stamps, self.clock.clone()) {
            Ok(socket) => {
                self.socket = socket;
                // A token is the number of a packet of one socket; the new socket starts from zero.
                self.awaited_departures.clear();
            }
            Err(error) => {
                tracing::debug!(%error, "failed to reopen the socket for probes; the old socket remains in use");
            }
        }
    }

    /// Handles the kernel's stamp of a probe's departure.
    fn record_departure(&mut self, token: Token, departed_at: Option<WallTime>) {
        // Stamps come in the order of departure. The stamps of dropped packets never come.
        let Some(index) =
            self.awaited_departures.iter().position(|(awaited_token, _)| *awaited_token == token)
        else {
            return;
        };
        let departure = self.awaited_departures.drain(..=index).next_back();
        if let (Some((_, sequence)), Some(departed_at)) = (departure, departed_at) {
            self.sender.record_departure(sequence, departed_at, self.clock.wall_ahead());
        }
    }

    /// Handles a packet that arrived.
    fn handle_packet(
        &mut self,
        packet: &[u8],
        received: &ReceivedPacket,
        pending_results: &mut PendingResults,
    ) {
        let read = self.clock.stamp();
        let (from, target) = (received.source, self.config.target);
        // A packet from another address is not an answer, even if its contents match.
        // Only port and IP address are compared: the flow label and the scope of an IPv6 address may differ.
        if from.port() != target.port() || from.ip() != target.ip() {
            pending_results.push(ProbeResult::Refused("not from the target"));
            return;
        }
        let (ahead, epoch) = (self.clock.wall_ahead(), self.clock.epoch());
        let arrival = ReplyArrival { kernel: received.kernel_stamp, read, ahead, epoch };
        pending_results.push_lost(self.sender.expire(read.mono));
        let reply = self.sender.receive(packet, &arrival);
        if self.sender.ignores_kernel_stamps() && !self.socket.are_kernel_stamps_disabled() {
            self.ignore_kernel_stamps();
        }
        match reply {
            Ok(reply) => {
                pending_results.0.extend(reply.refined.map(ProbeResult::Refined));
                let interrupted = ProbeResult::ClockInterrupted(arrival.epoch);
                pending_results.push(reply.answered.map_or(interrupted, ProbeResult::Answered));
            }
            Err(LATE_REPLY) => pending_results.push(ProbeResult::Late),
            Err(reason) => pending_results.push(ProbeResult::Refused(reason)),
        }
    }

    /// Logs a socket error, and waits briefly.
    // The system also reports errors of single packets here, so the loop continues. The pause prevents a busy loop if
    // the error is permanent.
    async fn pause_after_error(&mut self, error: &io::Error) {
        tracing::debug!(target = %self.config.target, %error, "failed to receive a reply or a departure stamp");
        tokio::time::sleep(ERROR_PAUSE).await;
    }
}

/// Results of one pass of the loop in [`Prober::run`], which are sent at the end of the pass.
#[derive(Default)]
struct PendingResults(Vec<ProbeResult>);

impl PendingResults {
    fn push(&mut self, result: ProbeResult) {
        self.0.push(result);
    }

    fn push_lost(&mut self, count: usize) {
        self.0.extend(std::iter::repeat_n(ProbeResult::Lost, count));
    }
}

fn send_error_text(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::WouldBlock => "not sent: the socket is busy",
        io::ErrorKind::NetworkUnreachable => "not sent: the network is unreachable",
        io::ErrorKind::HostUnreachable => "not sent: the host is unreachable",
        io::ErrorKind::PermissionDenied => "not sent: a firewall of this machine refuses it",
        io::ErrorKind::NetworkDown => "not sent: the network is down",
        _ => "not sent: the system refuses it",
    }
}

async fn sleep_until(wake_up_at: Option<MonoTime>, clock: &SharedClock) {
    match wake_up_at {
        Some(wake_up_at) => tokio::time::sleep((wake_up_at - clock.mono()).to_duration()).await,
        None => std::future::pending().await,
    }
}
