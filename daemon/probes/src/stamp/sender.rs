//! State machine of a sender (session-sender of RFC 8762, section 4.2).

use std::collections::VecDeque;

use peernet_clock::{
    Clock, Exchange, ExchangeObservation, Interval, MonoTime, RawTime, RelatedClocks, Span, Stamp, WallTime,
};

use super::auth::Key;
use super::kernel::KernelStamp;
use super::packet::{self, Mode, Reply, Request};
pub use super::request_packet::Nonce;
use super::request_packet::RequestPacket;
use super::timestamp::{ErrorEstimate, Format};
use super::tlv::{self, FollowUp, Origin, RawStamps};
use super::uncertainty::{self, ORDER_TOLERANCE};

/// Maximum number of remembered probes, whether answered or not. A further probe replaces the oldest.
const MAX_PENDING: usize = 1024;

/// Longest plausible time from the program's stamp of a departure to the kernel's stamp.
const MAX_DEPARTURE_DELAY: Span = Span::from_seconds(1);

/// Configuration of a sender.
#[derive(Clone, Debug)]
pub struct SenderConfig {
    /// Key shared with the reflector.
    pub key: Option<Key>,
    /// The only accepted reflector, by its [`Origin::instance`]; `None` accepts any.
    pub instance: Option<u64>,
    /// `true` if each request carries random octets that its answer must return. Has no effect without a
    /// key.
    // The octets prove that the TLVs of an answer were written for this request, and not for another request with the
    // same number and key.
    pub with_nonce: bool,
    /// Clocks that are related. Reflectors of other implementations only stamp by the wall clock.
    pub clocks: RelatedClocks,
    /// Distinguishes the session from other sessions between the same ports.
    pub ssid: u16,
    /// Number of the first packet.
    pub first_sequence: u32,
    /// Bytes of padding.
    pub padding_bytes: u16,
    /// Time after which a probe without an answer counts as lost.
    pub timeout: Span,
}

/// State of a sender. The sender runs on the edge, and its reflector runs on the cloud.
#[derive(Debug)]
pub struct SenderState {
    key: Option<Key>,
    instance: Option<u64>,
    clocks: RelatedClocks,
    ssid: u16,
    next_sequence: u32,
    packet: RequestPacket,
    timeout: Span,
    /// Probes that are not older than the timeout, oldest first.
    pending: VecDeque<PendingProbe>,
    /// Requests that were lost recently, at most [`MAX_PENDING`]. An answer to such a request is late.
    lost: VecDeque<Departure>,
    /// `true` if the kernel's stamps are of another clock than the program's.
    ignores_kernel_stamps: bool,
}

/// A request with its departure stamp, before it is recorded as sent.
#[derive(Clone, Copy, Debug)]
pub struct Departure {
    sequence: u32,
    /// Wall time of `sent` in the wire form; the answer must repeat it.
    timestamp: u64,
    sent: Stamp,
    /// Random octets of the request; `None` if requests carry no octets.
    nonce: Option<Nonce>,
    /// Difference wall clock minus free-running clock, read before the stamp.
    ahead: Interval,
    /// Edge's epoch, read before the stamp, so the stamp belongs to this epoch or a later epoch.
    epoch: u32,
}

impl Departure {
    /// Returns the number of the request, for [`SenderState::record_departure`].
    pub const fn sequence(&self) -> u32 {
        self.sequence
    }
}

/// A probe that was sent, whether answered or not.
#[derive(Debug)]
struct PendingProbe {
    departure: Departure,
    /// Departure by the kernel's stamp, not later than the true departure; `None` until the stamp arrives.
    kernel_departure: Option<RawTime>,
    /// `true` if the kernel's stamp is before the program's.
    is_kernel_stamp_too_early: bool,
    answer: Option<AnsweredProbe>,
}

/// The accepted answer to a probe.
#[derive(Debug)]
struct AnsweredProbe {
    /// Number of the reply.
    sequence: u32,
    /// `None` if the edge's clock was interrupted between the departure of the request and the arrival of the answer.
    observation: Option<ExchangeObservation>,
}

/// Arrival of a packet.
#[derive(Clone, Copy, Debug)]
pub struct ReplyArrival {
    /// Kernel's stamp of the arrival; `None` if the kernel did not stamp the packet.
    pub kernel: Option<WallTime>,
    /// Clocks, read by the program after it received the packet.
    pub read: Stamp,
    /// Difference wall clock minus free-running clock, read after `read`.
    pub ahead: Interval,
    /// Edge's epoch, read after `read`.
    pub epoch: u32,
}

/// Result of a valid reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplyResult {
    /// An earlier exchange, now with the stamp of its reply's true departure.
    pub refined: Option<ExchangeObservation>,
    /// The exchange that the reply completes. `None` if the edge's clock was interrupted between the departure of the
    /// request and the arrival of the reply, so the two stamps cannot be compared.
    pub answered: Option<ExchangeObservation>,
}

/// Values of the TLVs of a reply.
#[derive(Clone, Copy, Debug, Default)]
struct TlvValues {
    follow_up: Option<FollowUp>,
    origin: Option<Origin>,
    raw: Option<RawStamps>,
    nonce: Option<Nonce>,
    /// Reason why all TLVs are ignored, if they were altered.
    alteration: Option<&'static str>,
}

/// Times in a reply, by the reflector's clock that [`SenderConfig::clocks`] selects. If this is the wall clock, the
/// fields of type [`RawTime`] contain wall times.
#[derive(Clone, Copy, Debug)]
struct ReflectorTimes {
    received: RawTime,
    replied: RawTime,
    /// Epoch of the same clock; `None` if the reflector does not report it.
    epoch: Option<u32>,
    /// Number of an earlier reply, and its true departure.
    previous: Option<(u32, RawTime)>,
}

impl SenderState {
    /// Creates a session that has sent nothing.
    pub fn new(config: SenderConfig) -> Self {
        let packet = RequestPacket::new(&config);
        let SenderConfig { key, instance, clocks, ssid, first_sequence, timeout, .. } = config;
        let (pending, lost) = (VecDeque::new(), VecDeque::new());
        let ignores_kernel_stamps = false;
        Self {
            key,
            instance,
            clocks,
            ssid,
            next_sequence: first_sequence,
            packet,
            timeout,
            pending,
            lost,
            ignores_kernel_stamps,
        }
    }

    /// Returns the next request with its stamp. The caller must send it at once and then call
    /// [`record_sent`](Self::record_sent).
    pub fn request(&mut self, clock: &dyn Clock) -> (Departure, &[u8]) {
        self.request_with_nonce(clock, rand::random())
    }

    /// Returns the next request with the given octets, if requests carry octets. The octets must be secret until the
    /// request is sent.
    pub fn request_with_nonce(&mut self, clock: &dyn Clock, octets: Nonce) -> (Departure, &[u8]) {
        let key = self.key.as_ref();
        let nonce = self.packet.prepare(key, self.next_sequence, octets);
        let ahead = clock.wall_ahead();
        // The epoch is read before the stamp of the request. The epoch of the reply's arrival is read after the stamp
        // of the arrival. If both epochs are equal, the clock was not interrupted in between.
        let epoch = clock.epoch();
        let sent = clock.stamp();
        // The stamp is in NTP's format, because decoding returns exactly the stamp that was encoded.
        let timestamp = Format::Ntp.encode(sent.wall);
        let estimate = ErrorEstimate::new(Format::Ntp, uncertainty::PEERNET_ENDS);
        let request = Request { sequence: self.next_sequence, timestamp, estimate, ssid: self.ssid };
        let packet = self.packet.finish(key, &request);
        (Departure { sequence: self.next_sequence, timestamp, sent, nonce, ahead, epoch }, packet)
    }

    /// Records that the request was sent. Returns how many unanswered earlier probes were dropped to make
    /// room for the new probe.
    pub fn record_sent(&mut self, departure: Departure) -> usize {
        // The number increases here and not in `request`: a request that was not sent must leave no gap in the numbers,
        // because `find_probe` computes the position of a probe from its number.
        self.next_sequence = departure.sequence.wrapping_add(1);
        let excess = self.pending.len().saturating_sub(MAX_PENDING - 1);
        let lost = self.drop_oldest(excess);
        self.pending.push_back(PendingProbe {
            departure,
            kernel_departure: None,
            is_kernel_stamp_too_early: false,
            answer: None,
        });
        lost
    }

    /// Handles the kernel's stamp of a request's departure; `ahead` is the difference of the clocks that was read
    /// afterwards. The stamp is ignored if it is before the program's stamp or more than one second after it.
    pub fn record_departure(&mut self, sequence: u32, stamp: WallTime, ahead: Interval) {
        if self.ignores_kernel_stamps {
            return;
        }
        if let Some(probe) = find_probe(&mut self.pending, sequence) {
            let Departure { sent, ahead: ahead_before, .. } = probe.departure;
            let stamp = KernelStamp::from_comparisons(stamp, ahead_before, ahead);
            let delay = stamp.earliest - sent.raw;
            probe.kernel_departure =
                (Span::ZERO..=MAX_DEPARTURE_DELAY).contains(&delay).then_some(stamp.earliest);
            // If the wall clock was set between the comparisons, the order of the stamps proves nothing.
            probe.is_kernel_stamp_too_early = stamp.is_steady && stamp.latest < sent.raw - ORDER_TOLERANCE;
        }
    }

    /// Returns whether the kernel's stamps are ignored, because they are of another clock than the program's. A tool
    /// such as libfaketime causes this.
    pub const fn ignores_kernel_stamps(&self) -> bool {
        self.ignores_kernel_stamps
    }

    /// Ignores the kernel's stamps from now on.
    pub fn ignore_kernel_stamps(&mut self) {
        self.ignores_kernel_stamps = true;
        for probe in &mut self.pending {
            (probe.kernel_departure, probe.is_kernel_stamp_too_early) = (None, false);
        }
    }

    /// Drops probes that are older than the timeout. Returns how many of them were not answered.
    pub fn expire(&mut self, now: MonoTime) -> usize {
        let expired = self.pending.iter().take_while(|probe| now - probe.departure.sent.mono >= self.timeout);
        let count = expired.count();
        self.drop_oldest(count)
    }

    /// Drops the `count` oldest probes. Returns how many of them were not answered.
    fn drop_oldest(&mut self, count: usize) -> usize {
        let unanswered = self.pending.drain(..count).filter(|probe| probe.answer.is_none());
        let lost_before = self.lost.len();
        self.lost.extend(unanswered.map(|probe| probe.departure));
        let lost = self.lost.len() - lost_before;
        self.lost.drain(..self.lost.len().saturating_sub(MAX_PENDING));
        lost
    }

    /// Returns the time at which the oldest unanswered probe will count as lost; `None` if all probes are answered.
    pub fn deadline(&self) -> Option<MonoTime> {
        let oldest_unanswered = self.pending.iter().find(|probe| probe.answer.is_none())?;
        Some(oldest_unanswered.departure.sent.mono + self.timeout)
    }

    /// Handles a packet from the target. [`expire`](Self::expire) must be called before, so that a reply after the
    /// timeout does not count as an answer.
    ///
    /// # Errors
    /// The reason why the packet is not an answer.
    pub fn receive(&mut self, packet: &[u8], arrival: &ReplyArrival) -> Result<ReplyResult, &'static str> {
        let mode = Mode::for_key(self.key.as_ref());
        let reply = Reply::parse(mode, packet).ok_or("shorter than a reply")?;
        if self.key.as_ref().is_some_and(|key| !packet::is_authentic(key, packet)) {
            return Err("not authenticated by the key");
        }
        // A reflector that does not know session identifiers leaves zero (RFC 8972, section 3).
        if reply.request.ssid != self.ssid && reply.request.ssid != 0 {
            return Err("an answer of another session");
        }
        let tlv_values = read_tlvs(self.key.as_ref(), reply.sequence, &packet[mode.base_bytes()..]);
        match (self.instance, tlv_values.origin) {
            (Some(expected), Some(origin)) if origin.instance != expected => return Err(WRONG_PROCESS),
            (Some(_), None) => {
                let reason = if self.key.is_some() { NO_ORIGIN } else { NOT_PEERNET };
                return Err(tlv_values.alteration.unwrap_or(reason));
            }
            _ => {}
        }
        let reflector_times = self.reflector_times(&reply, &tlv_values, arrival.read.wall)?;
        let Some(probe) = find_probe(&mut self.pending, reply.request.sequence) else {
            let lost_index = self
                .lost
                .iter()
                .position(|lost| lost.sequence == reply.request.sequence)
                .ok_or(NO_SUCH_PROBE)?;
            check_answer(&self.lost[lost_index], &reply, &tlv_values)?;
            self.lost.remove(lost_index);
            return Err(LATE_REPLY);
        };
        check_answer(&probe.departure, &reply, &tlv_values)?;
        // A second reply must not replace the first answer.
        if probe.answer.is_some() {
            return Err("a second answer to the same probe");
        }
        // The edge's stamps can be compared only if its epoch did not change in between.
        let Departure { sent, ahead, epoch, .. } = probe.departure;
        if epoch != arrival.epoch {
            probe.answer = Some(AnsweredProbe { sequence: reply.sequence, observation: None });
            return Ok(ReplyResult { refined: None, answered: None });
        }
        let kernel_stamp =
            arrival.kernel.map(|stamp| KernelStamp::from_comparisons(stamp, ahead, arrival.ahead));
        let is_of_another_clock = |kernel: KernelStamp| {
            kernel.is_steady
                && (kernel.earliest > arrival.read.raw + ORDER_TOLERANCE
                    || kernel.latest < sent.raw - ORDER_TOLERANCE)
        };
        if probe.is_kernel_stamp_too_early || kernel_stamp.is_some_and(is_of_another_clock) {
            self.ignore_kernel_stamps();
        }
        let kernel_stamp = kernel_stamp.filter(|_| !self.ignores_kernel_stamps);
        // The probe is looked up again, because `ignore_kernel_stamps` may have changed all pending probes.
        let probe = find_probe(&mut self.pending, reply.request.sequence).ok_or(NO_SUCH_PROBE)?;
        // The program's readings always hold; the kernel's stamps may narrow the bounds.
        let exchange = Exchange {
            sent: probe.kernel_departure.map_or(sent.raw, |departure| departure.max(sent.raw)),
            received: reflector_times.received,
            replied: reflector_times.replied,
            returned: kernel_stamp.map_or(arrival.read.raw, |kernel| kernel.latest.min(arrival.read.raw)),
            uncertainty: if tlv_values.origin.is_some() {
                uncertainty::PEERNET_ENDS
            } else {
                uncertainty::OTHER_IMPLEMENTATION
            },
        };
        let observation = ExchangeObservation {
            exchange,
            // A STAMP reply does not contain a time of the reflector's monotonic clock.
            cloud_elapsed: None,
            edge_epoch: arrival.epoch,
            cloud_epoch: reflector_times.epoch,
        };
        probe.answer = Some(AnsweredProbe { sequence: reply.sequence, observation: Some(observation) });
        let refined = reflector_times.previous.and_then(|(sequence, departure)| {
            refine_departure(
                &mut self.pending,
                reply.request.sequence,
                sequence,
                departure,
                observation.cloud_epoch,
            )
        });
        Ok(ReplyResult { refined, answered: Some(observation) })
    }

    /// Returns the times of the requested clock in a reply. `near` is a time close to them, which resolves the era.
    fn reflector_times(
        &self,
        reply: &Reply,
        tlv_values: &TlvValues,
        near: WallTime,
    ) -> Result<ReflectorTimes, &'static str> {
        if self.clocks == RelatedClocks::Raw {
            let RawStamps { epoch, received, replied, previous } = tlv_values.raw.ok_or(NO_RAW_STAMPS)?;
            return Ok(ReflectorTimes { received, replied, epoch: Some(epoch), previous });
        }
        let format = reply.estimate.format();
        let decode = |bits| if bits == 0 { None } else { format.decode(bits, near).map(RawTime::from_wall) };
        let stamps = decode(reply.received).zip(decode(reply.timestamp));
        let (received, replied) = stamps.ok_or("an answer without the reflector's stamps")?;
        let previous = tlv_values
            .follow_up
            .and_then(|follow_up| Some((follow_up.sequence, decode(follow_up.timestamp)?)));
        Ok(ReflectorTimes {
            received,
            replied,
            epoch: tlv_values.origin.map(|origin| origin.epoch),
            previous,
        })
    }
}

// Reasons that `SenderState::receive` returns for packets that it refuses.

/// Reason for a valid reply to a probe that already counts as lost. All other reasons mean that the reply is invalid.
pub const LATE_REPLY: &str = "later than the timeout of the probe";
/// Reason for a reply to none of the remembered probes.
const NO_SUCH_PROBE: &str = "an answer to an unknown or forgotten probe";
/// Reason for a reply whose TLVs were written for another request.
const WRONG_NONCE: &str = "an answer with the random octets of another probe";
/// Reason for a reply of another PEERNet reflector than the expected one.
pub const WRONG_PROCESS: &str =
    "the probes are answered by another process than the one that serves the data";
/// Reason for a reply of another implementation where a PEERNet reflector was expected.
pub const NOT_PEERNET: &str =
    "the probes are answered by another program than the agent that serves the data";

/// Reason for an authentic reply with TLVs that do not match their code (RFC 8972, section 4.8).
pub const ALTERED_REPLY_TLVS: &str = "an authentic reply with TLVs whose HMAC does not fit: they were altered on the way, or the reflector \
                                  does not know them";
/// Reason for an authentic reply with flag I: the code of the request's TLVs did not match at the reflector.
pub const ALTERED_PROBE_TLVS: &str = "an authentic reply whose TLVs say that the HMAC of the probe's TLVs does not fit: these TLVs were altered on the way";
/// Reason for an authentic reply without the TLV that names its reflector.
pub const NO_ORIGIN: &str = "an authentic reply that does not say which process wrote it: its TLVs were cut off on the way, or the \
                           reflector is not of PEERNet";

/// Reason for a reply of a PEERNet reflector without the requested stamps of its free-running clock.
const NO_RAW_STAMPS: &str = "without the stamps of the reflector's free-running clock";

/// Checks that a reply returns the stamp and the octets of its request.
fn check_answer(request: &Departure, reply: &Reply, tlv_values: &TlvValues) -> Result<(), &'static str> {
    if request.timestamp != reply.request.timestamp {
        return Err("an answer with another stamp than its probe");
    }
    if request.nonce.is_some_and(|nonce| tlv_values.nonce != Some(nonce)) {
        return Err(WRONG_NONCE);
    }
    Ok(())
}

/// Returns the probe with this number. The probes are in order and without gaps.
fn find_probe(pending: &mut VecDeque<PendingProbe>, sequence: u32) -> Option<&mut PendingProbe> {
    let first = pending.front()?.departure.sequence;
    pending.get_mut(sequence.wrapping_sub(first) as usize)
}

/// Sets the departure of the earlier reply `reply_sequence` to `departure` if that is later than the known departure.
/// Returns the changed exchange. The reply to the request `reporting_request` reports `departure`. The search skips
/// this reply, because a reply cannot report its own departure.
// A later stamp of a departure is closer to the true departure. The stamp was made between the readings of the two
// replies' epochs, so it can be used only if both epochs are equal.
fn refine_departure(
    pending: &mut VecDeque<PendingProbe>,
    reporting_request: u32,
    reply_sequence: u32,
    departure: RawTime,
    epoch: Option<u32>,
) -> Option<ExchangeObservation> {
    let earlier_probes =
        pending.iter_mut().rev().filter(|probe| probe.departure.sequence != reporting_request);
    let answered_probe = earlier_probes
        .filter_map(|probe| probe.answer.as_mut())
        .find(|answered_probe| answered_probe.sequence == reply_sequence)?;
    let observation = answered_probe.observation.as_mut()?;
    let delay = departure - observation.exchange.replied;
    if delay <= Span::ZERO || delay > MAX_DEPARTURE_DELAY || observation.cloud_epoch != epoch {
        return None;
    }
    observation.exchange.replied = departure;
    Some(*observation)
}

/// Returns the values of the intact TLVs (RFC 8972, section 4).
fn read_tlvs(key: Option<&Key>, sequence: u32, tlvs: &[u8]) -> TlvValues {
    let mut tlv_values = TlvValues::default();
    // This flag is checked before the code: a reflector that sets the flag returns the TLVs unchanged, so their code
    // does not match.
    if tlv::headers(tlvs).any(|header| header.flags & tlv::NOT_INTACT != 0) {
        return TlvValues { alteration: Some(ALTERED_PROBE_TLVS), ..tlv_values };
    }
    if !tlv::are_intact(key, sequence, tlvs) {
        return TlvValues { alteration: Some(ALTERED_REPLY_TLVS), ..tlv_values };
    }
    for header in tlv::headers(tlvs) {
        // The TLVs after an HMAC are not authenticated.
        if header.overruns || header.flags & tlv::MALFORMED != 0 || header.kind == tlv::HMAC {
            break;
        }
        if header.flags & tlv::UNRECOGNISED == 0 {
            match header.kind {
                tlv::EXTRA_PADDING => {
                    tlv_values.nonce = tlv_values.nonce.or(tlvs[header.value].try_into().ok());
                }
                tlv::FOLLOW_UP => tlv_values.follow_up = FollowUp::from_value(&tlvs[header.value]),
                tlv::ORIGIN => tlv_values.origin = Origin::from_value(&tlvs[header.value]),
                tlv::RAW_STAMPS => {
                    tlv_values.raw = RawStamps::from_value(&tlvs[header.value]).filter(RawStamps::is_filled);
                }
                _ => {}
            }
        }
    }
    tlv_values
}
