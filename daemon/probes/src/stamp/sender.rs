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

/// Largest number of remembered probes, waiting or answered. A further one replaces the oldest.
const MAX_PENDING: usize = 1024;

/// Longest plausible time between the program's stamp and the kernel's.
const LONGEST_DEPARTURE: Span = Span::from_seconds(1);

/// Configuration of a sender.
#[derive(Clone, Debug)]
pub struct SenderConfig {
    /// Key shared with the reflector.
    pub key: Option<Key>,
    /// The only accepted reflector, by its [`Origin::instance`]; `None` accepts any.
    pub instance: Option<u64>,
    /// `true` if each request carries random octets that its answer must return; only used with a key. The TLVs of such
    /// an answer were written for this request, and not for another one of the same number that the same key
    /// authenticated.
    pub bound: bool,
    /// Clock of the reflector that is requested. Reflectors of other implementations only have the wall clock.
    pub clocks: RelatedClocks,
    /// Distinguishes the session from other sessions between the same ports.
    pub ssid: u16,
    /// Number of the first packet.
    pub first: u32,
    /// Bytes of padding.
    pub padding_bytes: u16,
    /// Time after which a probe without an answer counts as lost.
    pub timeout: Span,
}

/// State of a sender.
#[derive(Debug)]
pub struct SenderState {
    key: Option<Key>,
    instance: Option<u64>,
    clocks: RelatedClocks,
    ssid: u16,
    next: u32,
    packet: RequestPacket,
    timeout: Span,
    pending: VecDeque<PendingProbe>,
    /// Requests that were lost recently, whose answers are late. At most [`MAX_PENDING`].
    lost: VecDeque<Departure>,
    /// `true` if the kernel's stamps are of another clock than the program's.
    distrusts_kernel: bool,
}

/// A request with its departure stamp.
#[derive(Clone, Copy, Debug)]
pub struct Departure {
    sequence: u32,
    timestamp: u64,
    sent: Stamp,
    nonce: Option<Nonce>,
    /// Difference wall clock minus free-running clock, read before the stamp.
    ahead: Interval,
    /// Edge's epoch, read before: the stamp belongs to this epoch or a later one.
    epoch: u32,
}

impl Departure {
    /// Returns the number of the request, for [`SenderState::departed`].
    pub const fn sequence(&self) -> u32 {
        self.sequence
    }
}

#[derive(Debug)]
struct PendingProbe {
    departure: Departure,
    /// Departure by the kernel's stamp, not later than the true one.
    left: Option<RawTime>,
    /// `true` if the kernel's stamp is before the program's.
    left_early: bool,
    answer: Option<AnsweredProbe>,
}

#[derive(Debug)]
struct AnsweredProbe {
    /// Number of the reply.
    sequence: u32,
    /// `None` if the edge's clock was interrupted in between.
    observation: Option<ExchangeObservation>,
}

/// Arrival of a packet.
#[derive(Clone, Copy, Debug)]
pub struct ReplyArrival {
    /// Kernel's stamp of the arrival, if it made one.
    pub kernel: Option<WallTime>,
    /// Clocks, read by the program afterwards.
    pub read: Stamp,
    /// Difference wall clock minus free-running clock, read afterwards.
    pub ahead: Interval,
    /// Edge's epoch, read afterwards.
    pub epoch: u32,
}

/// Result of a valid reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplyResult {
    /// An earlier exchange, now with the stamp of its reply's true departure.
    pub refined: Option<ExchangeObservation>,
    /// The exchange that the reply completes. `None` if the edge's clock was interrupted in between: nothing follows
    /// from its stamps.
    pub answered: Option<ExchangeObservation>,
}

/// Values of the TLVs of a reply.
#[derive(Clone, Copy, Debug, Default)]
struct TlvValues {
    follow_up: Option<FollowUp>,
    origin: Option<Origin>,
    raw: Option<RawStamps>,
    nonce: Option<Nonce>,
    /// Reason why none of them is believed, if the TLVs were altered.
    altered: Option<&'static str>,
}

/// Times of the reflector's related clock in a reply.
#[derive(Clone, Copy, Debug)]
struct ReflectorTimes {
    received: RawTime,
    replied: RawTime,
    epoch: Option<u32>,
    /// Number of an earlier reply, and its true departure.
    previous: Option<(u32, RawTime)>,
}

impl SenderState {
    /// Creates a session that has sent nothing.
    pub fn new(config: SenderConfig) -> Self {
        let packet = RequestPacket::new(&config);
        let SenderConfig { key, instance, clocks, ssid, first, timeout, .. } = config;
        let (pending, lost) = (VecDeque::new(), VecDeque::new());
        let distrusts_kernel = false;
        Self { key, instance, clocks, ssid, next: first, packet, timeout, pending, lost, distrusts_kernel }
    }

    /// Returns the next request with its stamp. It must be sent at once and then passed to [`sent`](Self::sent).
    pub fn request(&mut self, clock: &dyn Clock) -> (Departure, &[u8]) {
        self.request_with(clock, rand::random())
    }

    /// Returns the next request with the given octets, if requests carry octets. They must be secret until the request
    /// is sent.
    pub fn request_with(&mut self, clock: &dyn Clock, octets: Nonce) -> (Departure, &[u8]) {
        let key = self.key.as_ref();
        let nonce = self.packet.prepare(key, self.next, octets);
        let ahead = clock.wall_ahead();
        // Read before the stamp, while the epoch at the return is read after its stamp. If both are equal, the clock
        // was not interrupted in between.
        let epoch = clock.epoch();
        let sent = clock.stamp();
        // NTP's format, because a stamp is returned exactly in it.
        let timestamp = Format::Ntp.encode(sent.wall);
        let estimate = ErrorEstimate::new(Format::Ntp, uncertainty::OWN);
        let request = Request { sequence: self.next, timestamp, estimate, ssid: self.ssid };
        let packet = self.packet.finish(key, &request);
        (Departure { sequence: self.next, timestamp, sent, nonce, ahead, epoch }, packet)
    }

    /// Notes that the request was sent. Returns the number of earlier ones that are given up for it.
    pub fn sent(&mut self, departure: Departure) -> usize {
        self.next = departure.sequence.wrapping_add(1);
        let given_up = self.pending.len().saturating_sub(MAX_PENDING - 1);
        let lost = self.forget(given_up);
        self.pending.push_back(PendingProbe { departure, left: None, left_early: false, answer: None });
        lost
    }

    /// Handles the kernel's stamp of a request's departure; `ahead` is the difference of the clocks that was read
    /// afterwards. A time outside the range from the program's stamp to the longest wait of a packet is ignored.
    pub fn departed(&mut self, sequence: u32, left: WallTime, ahead: Interval) {
        if self.distrusts_kernel {
            return;
        }
        if let Some(pending) = find(&mut self.pending, sequence) {
            let Departure { sent, ahead: before, .. } = pending.departure;
            let left = KernelStamp::between(left, before, ahead);
            let after = left.earliest - sent.raw;
            pending.left = (Span::ZERO..=LONGEST_DEPARTURE).contains(&after).then_some(left.earliest);
            pending.left_early = left.is_steady && left.latest < sent.raw - ORDER_TOLERANCE;
        }
    }

    /// Returns whether the kernel's stamps were found to be of another clock than the program's, for example if a tool
    /// shows the program a false time. They are then ignored.
    pub const fn distrusts_kernel(&self) -> bool {
        self.distrusts_kernel
    }

    /// Ignores the kernel's stamps from now on.
    pub fn distrust_kernel(&mut self) {
        self.distrusts_kernel = true;
        for pending in &mut self.pending {
            (pending.left, pending.left_early) = (None, false);
        }
    }

    /// Forgets probes that are older than the timeout. Returns how many of them are lost.
    pub fn expire(&mut self, now: MonoTime) -> usize {
        let old = self.pending.iter().take_while(|pending| now - pending.departure.sent.mono >= self.timeout);
        let old = old.count();
        self.forget(old)
    }

    /// Forgets the `oldest` oldest probes. Returns how many of them are lost.
    fn forget(&mut self, oldest: usize) -> usize {
        let unanswered = self.pending.drain(..oldest).filter(|pending| pending.answer.is_none());
        let before = self.lost.len();
        self.lost.extend(unanswered.map(|pending| pending.departure));
        let lost = self.lost.len() - before;
        self.lost.drain(..self.lost.len().saturating_sub(MAX_PENDING));
        lost
    }

    /// Returns the time at which the next probe will be lost if it is not answered.
    pub fn deadline(&self) -> Option<MonoTime> {
        let waiting = self.pending.iter().find(|pending| pending.answer.is_none())?;
        Some(waiting.departure.sent.mono + self.timeout)
    }

    /// Handles a packet from the target. [`expire`](Self::expire) must be called before.
    ///
    /// # Errors
    /// The reason why it is not an answer.
    pub fn receive(&mut self, packet: &[u8], returned: &ReplyArrival) -> Result<ReplyResult, &'static str> {
        let mode = Mode::of(self.key.as_ref());
        let reply = Reply::parse(mode, packet).ok_or("shorter than a reply")?;
        if self.key.as_ref().is_some_and(|key| !packet::is_sealed(key, packet)) {
            return Err("not authenticated by the key");
        }
        // A reflector that does not know session identifiers leaves zero (RFC 8972, section 3).
        if reply.asked.ssid != self.ssid && reply.asked.ssid != 0 {
            return Err("of another session");
        }
        let tlv_values = read_tlvs(self.key.as_ref(), reply.sequence, &packet[mode.base_bytes()..]);
        match (self.instance, tlv_values.origin) {
            (Some(expected), Some(origin)) if origin.instance != expected => return Err(ANOTHER_PROCESS),
            (Some(_), None) => {
                let found = if self.key.is_some() { UNNAMED } else { NOT_OURS };
                return Err(tlv_values.altered.unwrap_or(found));
            }
            _ => {}
        }
        let reflector_times = self.reflector_times(&reply, &tlv_values, returned.read.wall)?;
        let Some(pending) = find(&mut self.pending, reply.asked.sequence) else {
            let late =
                self.lost.iter().position(|lost| lost.sequence == reply.asked.sequence).ok_or(UNKNOWN)?;
            is_answer_to(&self.lost[late], &reply, &tlv_values)?;
            self.lost.remove(late);
            return Err(LATE);
        };
        is_answer_to(&pending.departure, &reply, &tlv_values)?;
        // A reply may come to a probe that is answered; it must not replace the first answer.
        if pending.answer.is_some() {
            return Err("a second answer to the same probe");
        }
        // If the two epochs are equal, all stamps are of one clock.
        let Departure { sent, ahead, epoch, .. } = pending.departure;
        if epoch != returned.epoch {
            pending.answer = Some(AnsweredProbe { sequence: reply.sequence, observation: None });
            return Ok(ReplyResult { refined: None, answered: None });
        }
        let kernel = returned.kernel.map(|stamp| KernelStamp::between(stamp, ahead, returned.ahead));
        let is_impossible = |kernel: KernelStamp| {
            kernel.is_steady
                && (kernel.earliest > returned.read.raw + ORDER_TOLERANCE
                    || kernel.latest < sent.raw - ORDER_TOLERANCE)
        };
        if pending.left_early || kernel.is_some_and(is_impossible) {
            self.distrust_kernel();
        }
        let kernel = kernel.filter(|_| !self.distrusts_kernel);
        let pending = find(&mut self.pending, reply.asked.sequence).ok_or(UNKNOWN)?;
        // The program's readings are the outer bounds, which the kernel's stamps may narrow.
        let exchange = Exchange {
            sent: pending.left.map_or(sent.raw, |left| left.max(sent.raw)),
            received: reflector_times.received,
            replied: reflector_times.replied,
            returned: kernel.map_or(returned.read.raw, |kernel| kernel.latest.min(returned.read.raw)),
            uncertainty: if tlv_values.origin.is_some() { uncertainty::OWN } else { uncertainty::FOREIGN },
        };
        let answered = ExchangeObservation {
            exchange,
            cloud_elapsed: None,
            edge_epoch: returned.epoch,
            cloud_epoch: reflector_times.epoch,
        };
        pending.answer = Some(AnsweredProbe { sequence: reply.sequence, observation: Some(answered) });
        let refined = reflector_times.previous.and_then(|(sequence, left)| {
            refine(&mut self.pending, reply.asked.sequence, sequence, left, answered.cloud_epoch)
        });
        Ok(ReplyResult { refined, answered: Some(answered) })
    }

    /// Returns the times of the requested clock in a reply.
    fn reflector_times(
        &self,
        reply: &Reply,
        tlv_values: &TlvValues,
        near: WallTime,
    ) -> Result<ReflectorTimes, &'static str> {
        if self.clocks == RelatedClocks::Raw {
            let RawStamps { epoch, received, replied, previous } = tlv_values.raw.ok_or(NOT_RAW)?;
            return Ok(ReflectorTimes { received, replied, epoch: Some(epoch), previous });
        }
        let format = reply.estimate.format();
        let decode = |bits| if bits == 0 { None } else { format.decode(bits, near).map(RawTime::from_wall) };
        let stamps = decode(reply.received).zip(decode(reply.timestamp));
        let (received, replied) = stamps.ok_or("without the reflector's stamps")?;
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

/// Reason for a valid reply to a probe that is already lost. It is the only reason that says nothing against the reply.
pub const LATE: &str = "later than the timeout of the probe";
/// Reason for a reply that no probe waits for.
const UNKNOWN: &str = "to no probe of ours, or to one of long ago";
/// Reason for a reply with the values of another reply.
const NOT_BOUND: &str = "with what was told to another probe";
/// Reason for a reply of another PEERNet reflector than the expected one.
pub const ANOTHER_PROCESS: &str = "another process answers the probes than serves the data";
/// Reason for a reply that is not of a PEERNet reflector although one was expected.
pub const NOT_OURS: &str = "something else answers the probes than the agent that serves the data";

/// Reason for an authentic reply with TLVs that do not match their code (RFC 8972, section 4.8).
pub const ALTERED_ANSWER: &str = "an authentic reply with TLVs whose HMAC does not fit: they were altered on the way, or the reflector \
                                  does not know them";
/// Reason for an authentic reply with flag I: the code of the request's TLVs did not match at the reflector.
pub const ALTERED_PROBE: &str = "an authentic reply whose TLVs say that the HMAC of the probe's TLVs does not fit: they were altered on the way";
/// Reason for an authentic reply without the TLV that names its reflector.
pub const UNNAMED: &str = "an authentic reply that does not say which process wrote it: its TLVs were cut off on the way, or the \
                           reflector is not of PEERNet";

/// Reason for a reply of a PEERNet reflector without the requested stamps of its free-running clock.
const NOT_RAW: &str = "without the stamps of the reflector's free-running clock";

/// Checks that a reply returns the stamp and the octets of its request.
fn is_answer_to(request: &Departure, reply: &Reply, tlv_values: &TlvValues) -> Result<(), &'static str> {
    if request.timestamp != reply.asked.timestamp {
        return Err("to another stamp than was sent");
    }
    if request.nonce.is_some_and(|nonce| tlv_values.nonce != Some(nonce)) {
        return Err(NOT_BOUND);
    }
    Ok(())
}

/// Returns the probe with this number. The probes are in order and without gaps.
fn find(pending: &mut VecDeque<PendingProbe>, sequence: u32) -> Option<&mut PendingProbe> {
    let first = pending.front()?.departure.sequence;
    pending.get_mut(sequence.wrapping_sub(first) as usize)
}

/// Corrects the departure of the reply with the number `sequence` to `left`, and returns the exchange. A later stamp of
/// departure is a better one. The stamp was made after that reply's epoch was read and before this one's, so that both
/// epochs must be equal.
fn refine(
    pending: &mut VecDeque<PendingProbe>,
    now: u32,
    sequence: u32,
    left: RawTime,
    epoch: Option<u32>,
) -> Option<ExchangeObservation> {
    let earlier = pending.iter_mut().rev().filter(|pending| pending.departure.sequence != now);
    let answered = earlier
        .filter_map(|pending| pending.answer.as_mut())
        .find(|answered| answered.sequence == sequence)?;
    let observation = answered.observation.as_mut()?;
    let later = left - observation.exchange.replied;
    if later <= Span::ZERO || later > LONGEST_DEPARTURE || observation.cloud_epoch != epoch {
        return None;
    }
    observation.exchange.replied = left;
    Some(*observation)
}

/// Returns the values of the TLVs that may be believed (RFC 8972, section 4).
fn read_tlvs(key: Option<&Key>, sequence: u32, tlvs: &[u8]) -> TlvValues {
    let mut tlv_values = TlvValues::default();
    // A reflector that sets this flag returns the TLVs unchanged, so that their code does not match. The flag is
    // therefore checked first.
    if tlv::places(tlvs).any(|place| place.flags & tlv::NOT_INTACT != 0) {
        return TlvValues { altered: Some(ALTERED_PROBE), ..tlv_values };
    }
    if !tlv::are_intact(key, sequence, tlvs) {
        return TlvValues { altered: Some(ALTERED_ANSWER), ..tlv_values };
    }
    for place in tlv::places(tlvs) {
        // The TLVs after it are not authenticated.
        if place.overruns || place.flags & tlv::MALFORMED != 0 || place.kind == tlv::HMAC {
            break;
        }
        if place.flags & tlv::UNRECOGNISED == 0 {
            match place.kind {
                tlv::EXTRA_PADDING => {
                    tlv_values.nonce = tlv_values.nonce.or(tlvs[place.value].try_into().ok());
                }
                tlv::FOLLOW_UP => tlv_values.follow_up = FollowUp::from_value(&tlvs[place.value]),
                tlv::ORIGIN => tlv_values.origin = Origin::from_value(&tlvs[place.value]),
                tlv::RAW_STAMPS => {
                    tlv_values.raw = RawStamps::from_value(&tlvs[place.value]).filter(RawStamps::is_filled);
                }
                _ => {}
            }
        }
    }
    tlv_values
}
