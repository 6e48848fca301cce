//! Decoding of the wire form from an untrusted source.

use peernet_clock::{DelaySource, Interval, OneWayDelay, RawTime, Span, Verdict, WallTime};
use rmp::{Marker, decode};

use super::{VERSION, WireError};
use crate::limits::{MAX_ANCHORS, MAX_NAME_BYTES, MAX_NODES, MAX_TREE_BYTES};
use crate::{Anchor, HostId, HostIndex, Measure, Name, Node, NodeId, Rate, RawStamps, Transit, Unit, stage};

/// Length of the shortest node, in bytes. The unread input cannot contain more nodes than its length divided by this
/// length. Capacity is reserved for at most this number of nodes of the input.
// One byte each for the array and the node's parent, name, host, start and kind.
const MIN_NODE_BYTES: usize = 6;
/// Length of the shortest anchor, in bytes. It limits the capacity that is reserved for anchors, as above.
// One byte for the array, two for the head of the host's identifier and 16 for the identifier itself, one for the time:
// 1 + 2 + 16 + 1.
const MIN_ANCHOR_BYTES: usize = 20;

/// Reader of the wire form of a tree or a tree delta.
pub(super) struct Reader<'a> {
    /// Bytes that have not been read yet.
    rest: &'a [u8],
    /// Length of the whole input.
    length: usize,
}

/// Result of reading a part of the input.
type ReadResult<T> = Result<T, WireError>;

impl<'a> Reader<'a> {
    /// Reads the header that trees and tree deltas share.
    pub(super) fn new(bytes: &'a [u8], expected_fields: u32, item: &'static str) -> ReadResult<Self> {
        if bytes.len() > MAX_TREE_BYTES {
            return Err(WireError::TooLong(bytes.len()));
        }
        let mut reader = Self { rest: bytes, length: bytes.len() };
        let field_count = reader.array(item)?;
        match reader.uint("a version")? {
            // The version is checked before the number of fields, because another version may have another number of
            // fields.
            VERSION if field_count == expected_fields => Ok(reader),
            VERSION => Err(WireError::Malformed { at: 0, expected: item }),
            other => Err(WireError::Version(other)),
        }
    }

    /// Checks that no bytes follow.
    pub(super) fn finish(self) -> ReadResult<()> {
        if self.rest.is_empty() { Ok(()) } else { Err(WireError::Trailing(self.rest.len())) }
    }

    /// Returns the error that the item at the current position is not the expected item. The callers create the error
    /// before they read, because reading changes the position.
    const fn malformed(&self, expected: &'static str) -> WireError {
        WireError::Malformed { at: self.length - self.rest.len(), expected }
    }

    fn array(&mut self, expected: &'static str) -> ReadResult<u32> {
        let error = self.malformed(expected);
        decode::read_array_len(&mut self.rest).map_err(|_| error)
    }

    fn uint(&mut self, expected: &'static str) -> ReadResult<u64> {
        let error = self.malformed(expected);
        decode::read_int(&mut self.rest).map_err(|_| error)
    }

    pub(super) fn int(&mut self, expected: &'static str) -> ReadResult<i64> {
        let error = self.malformed(expected);
        decode::read_int(&mut self.rest).map_err(|_| error)
    }

    /// Reads a position within a tree.
    pub(super) fn position(&mut self, expected: &'static str) -> ReadResult<u32> {
        let number = self.uint(expected)?;
        match u32::try_from(number) {
            // The limit itself is valid, because this function also reads the length of a tree, which may be full.
            Ok(position) if position as usize <= MAX_NODES => Ok(position),
            _ => {
                let found = usize::try_from(number).unwrap_or(usize::MAX);
                Err(WireError::Limit { what: "nodes", found, limit: MAX_NODES })
            }
        }
    }

    fn marker(&self) -> Option<Marker> {
        self.rest.first().map(|byte| Marker::from_u8(*byte))
    }

    fn optional<T>(&mut self, read: impl FnOnce(&mut Self) -> ReadResult<T>) -> ReadResult<Option<T>> {
        if self.marker() == Some(Marker::Null) {
            self.rest = &self.rest[1..];
            return Ok(None);
        }
        read(self).map(Some)
    }

    fn number(&mut self, expected: &'static str) -> ReadResult<f64> {
        // Whole numbers are written as integers, which are shorter.
        if self.marker() == Some(Marker::F64) {
            let error = self.malformed(expected);
            return decode::read_f64(&mut self.rest).map_err(|_| error);
        }
        Ok(self.int(expected)? as f64)
    }

    fn span(&mut self, expected: &'static str) -> ReadResult<Span> {
        self.int(expected).map(Span::from_nanos)
    }

    fn wall(&mut self, expected: &'static str) -> ReadResult<WallTime> {
        self.int(expected).map(WallTime::from_unix_nanos)
    }

    fn raw(&mut self, expected: &'static str) -> ReadResult<RawTime> {
        self.int(expected).map(RawTime::from_nanos)
    }

    fn text(&mut self, expected: &'static str) -> ReadResult<&'a str> {
        let error = self.malformed(expected);
        let length = decode::read_str_len(&mut self.rest).map_err(|_| error)? as usize;
        // A long text is refused and not truncated: two different names could become equal.
        if length > MAX_NAME_BYTES {
            return Err(WireError::Limit { what: "bytes of a name", found: length, limit: MAX_NAME_BYTES });
        }
        let (text, rest) = self.rest.split_at_checked(length).ok_or(error)?;
        self.rest = rest;
        std::str::from_utf8(text).map_err(|_| error)
    }

    fn name(&mut self) -> ReadResult<Name> {
        let error = self.malformed("a name");
        match self.marker() {
            // A standard name is written as its number, which takes one or two bytes.
            Some(Marker::FixPos(_) | Marker::U8) => stage::decode(self.uint("a name")?).ok_or(error),
            _ => self.text("a name").map(Name::from),
        }
    }

    fn unit(&mut self) -> ReadResult<Unit> {
        self.text("a unit").map(Unit::new)
    }

    pub(super) fn anchor(&mut self) -> ReadResult<Anchor> {
        let error = self.malformed("a host and its wall clock");
        if self.array("an anchor")? != 2 || decode::read_bin_len(&mut self.rest).ok() != Some(16) {
            return Err(error);
        }
        let (host, rest) = self.rest.split_first_chunk::<16>().ok_or(error)?;
        self.rest = rest;
        Ok(Anchor { host: HostId::from_bytes(*host), wall: self.wall("a wall clock")? })
    }

    pub(super) fn anchors(&mut self) -> ReadResult<Vec<Anchor>> {
        let count = self.array("the hosts")? as usize;
        if count > MAX_ANCHORS {
            return Err(WireError::Limit { what: "hosts", found: count, limit: MAX_ANCHORS });
        }
        // The stated count may be wrong, so the length of the input limits the capacity.
        let mut anchors = Vec::with_capacity(count.min(self.rest.len() / MIN_ANCHOR_BYTES));
        for _ in 0..count {
            anchors.push(self.anchor()?);
        }
        Ok(anchors)
    }

    pub(super) fn nodes(&mut self) -> ReadResult<Vec<Node>> {
        let count = self.array("the nodes")? as usize;
        if count > MAX_NODES {
            return Err(WireError::Limit { what: "nodes", found: count, limit: MAX_NODES });
        }
        // The capacity is larger by 8 than the input needs, because the edge adds computed nodes.
        let mut nodes = Vec::with_capacity(count.min(self.rest.len() / MIN_NODE_BYTES) + 8);
        for _ in 0..count {
            nodes.push(self.node()?);
        }
        Ok(nodes)
    }

    fn node(&mut self) -> ReadResult<Node> {
        let error = self.malformed("a node");
        let length = self.array("a node")?;
        let parent = self.optional(|reader| reader.position("a parent"))?.map(NodeId);
        let name = self.name()?;
        let host = u8::try_from(self.uint("a host")?).map(HostIndex).map_err(|_| error)?;
        let start = self.span("a start")?;
        // The kind determines the number of fields; a mismatch is refused.
        let measure = match (self.uint("a kind")?, length) {
            (0, 5) => Measure::Container,
            (1, 6) => Measure::Timer(self.optional(|reader| reader.span("a duration"))?),
            // A transit has no raw stamps if a release before 0.3 wrote it, or while its message is in flight.
            (2, 8) => Measure::Transit(Box::new(self.transit()?)),
            (2, 10) => {
                let transit = self.transit()?;
                let sent = self.raw("the raw time of sending")?;
                let raw_stamps = Some(RawStamps { sent, received: self.raw("the raw time of receipt")? });
                Measure::Transit(Box::new(Transit { raw_stamps, ..transit }))
            }
            (3, 7) => Measure::Value(self.number("a value")?, self.unit()?),
            (4, 8) => {
                let value = self.optional(|reader| reader.number("a throughput"))?;
                let lo = self.optional(|reader| reader.number("a lower bound"))?;
                let hi = self.optional(|reader| reader.number("an upper bound"))?;
                Measure::Throughput(Rate { value, bounds: paired_bounds(lo, hi).ok_or(error)? })
            }
            (5, 6) => Measure::TokenRate(self.optional(|reader| reader.number("a rate"))?),
            (6, 8) => {
                let (kind, unit) = (self.name()?, self.unit()?);
                Measure::Custom(kind, unit, self.optional(|reader| reader.number("a value"))?)
            }
            _ => return Err(error),
        };
        Ok(Node { parent, name, host, start, measure })
    }

    fn transit(&mut self) -> ReadResult<Transit> {
        let sent = self.wall("the time of sending")?;
        let received = self.optional(|reader| reader.wall("the time of receipt"))?;
        Ok(Transit { sent, received, delay: self.optional(Self::delay)?, raw_stamps: None })
    }

    fn delay(&mut self) -> ReadResult<OneWayDelay> {
        let error = self.malformed("a delay");
        if self.array("a delay")? != 6 {
            return Err(error);
        }
        let raw = self.span("a raw delay")?;
        let value = self.optional(|reader| reader.span("a delay"))?;
        let lo = self.optional(|reader| reader.span("a lower bound"))?;
        let hi = self.optional(|reader| reader.span("an upper bound"))?;
        let bounds = paired_bounds(lo, hi).ok_or(error)?.map(|(lo, hi)| Interval { lo, hi });
        let source = variant(DelaySource::ALL, self.uint("a source")?).ok_or(error)?;
        let verdict = variant(Verdict::ALL, self.uint("a verdict")?).ok_or(error)?;
        Ok(OneWayDelay { raw, value, bounds, source, verdict })
    }
}

/// Returns both bounds if both exist, or `Some(None)` if neither exists. The result is `None`, which is an error, if
/// only one of them exists.
fn paired_bounds<T>(lo: Option<T>, hi: Option<T>) -> Option<Option<(T, T)>> {
    match (lo, hi) {
        (Some(lo), Some(hi)) => Some(Some((lo, hi))),
        (None, None) => Some(None),
        _ => None,
    }
}

/// Returns the variant at a position; `None` if there is none, such as for a variant of a later release.
fn variant<T: Copy>(all: &[T], position: u64) -> Option<T> {
    all.get(usize::try_from(position).ok()?).copied()
}
