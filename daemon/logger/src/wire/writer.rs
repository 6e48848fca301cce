//! Encoding of the wire form.

use peernet_clock::{OneWayDelay, Span};
use rmp::encode;

use crate::{Anchor, Measure, Name, Node, Unit, stage};

/// Unwraps the result of a write to memory, which cannot fail.
// The library returns a result because it also writes to sockets and files, for which a write can fail.
macro_rules! write_to_memory {
    ($result:expr) => {
        $result.expect("a vector takes all bytes")
    };
}

/// Length of a usual node, in bytes. Memory is reserved for nodes of this length; a longer node is written, too.
pub(super) const USUAL_NODE_BYTES: usize = 24;

/// Largest magnitude up to which every integer is an exact `f64`.
const MAX_EXACT_INTEGER: f64 = 9_007_199_254_740_992.0;

pub(super) fn array(out: &mut Vec<u8>, length: u32) {
    write_to_memory!(encode::write_array_len(out, length));
}

pub(super) fn uint(out: &mut Vec<u8>, number: u64) {
    write_to_memory!(encode::write_uint(out, number));
}

pub(super) fn int(out: &mut Vec<u8>, number: i64) {
    write_to_memory!(encode::write_sint(out, number));
}

fn nil(out: &mut Vec<u8>) {
    write_to_memory!(encode::write_nil(out));
}

fn optional<T>(out: &mut Vec<u8>, value: Option<T>, write: impl Fn(&mut Vec<u8>, T)) {
    match value {
        Some(value) => write(out, value),
        None => nil(out),
    }
}

/// Writes a number. A whole number, such as a size or a count, is written as an integer, which is shorter than a float.
fn number(out: &mut Vec<u8>, number: f64) {
    let whole = number as i64;
    // The bits are compared, because −0.0 equals 0 and would lose its sign as an integer.
    if number.abs() < MAX_EXACT_INTEGER && (whole as f64).to_bits() == number.to_bits() {
        int(out, whole);
    } else {
        write_to_memory!(encode::write_f64(out, number));
    }
}

fn span(out: &mut Vec<u8>, span: Span) {
    int(out, span.nanos());
}

fn name(out: &mut Vec<u8>, name: &Name) {
    match stage::code(name) {
        Some(code) => uint(out, u64::from(code)),
        None => write_to_memory!(encode::write_str(out, name)),
    }
}

fn unit(out: &mut Vec<u8>, unit: &Unit) {
    write_to_memory!(encode::write_str(out, unit.symbol()));
}

pub(super) fn anchor(out: &mut Vec<u8>, anchor: &Anchor) {
    array(out, 2);
    write_to_memory!(encode::write_bin(out, anchor.host.as_bytes()));
    int(out, anchor.wall.unix_nanos());
}

pub(super) fn anchors(out: &mut Vec<u8>, anchors: &[Anchor]) {
    array(out, anchors.len() as u32);
    anchors.iter().for_each(|item| anchor(out, item));
}

pub(super) fn nodes(out: &mut Vec<u8>, nodes: &[Node]) {
    out.reserve(nodes.len() * USUAL_NODE_BYTES);
    array(out, nodes.len() as u32);
    nodes.iter().for_each(|item| node(out, item));
}

fn node(out: &mut Vec<u8>, node: &Node) {
    let (kind, length) = match &node.measure {
        Measure::Container => (0, 5),
        Measure::Timer(_) => (1, 6),
        Measure::Transit(transit) if transit.raw_stamps.is_some() => (2, 10),
        Measure::Transit(_) => (2, 8),
        Measure::Value(..) => (3, 7),
        Measure::Throughput(_) => (4, 8),
        Measure::TokenRate(_) => (5, 6),
        Measure::Custom(..) => (6, 8),
    };
    array(out, length);
    optional(out, node.parent, |out, parent| uint(out, u64::from(parent.0)));
    name(out, &node.name);
    uint(out, u64::from(node.host.0));
    span(out, node.start);
    uint(out, kind);
    match &node.measure {
        Measure::Container => {}
        Measure::Timer(duration) => optional(out, *duration, span),
        Measure::Transit(transit) => {
            int(out, transit.sent.unix_nanos());
            optional(out, transit.received, |out, at| int(out, at.unix_nanos()));
            optional(out, transit.delay.as_ref(), delay);
            if let Some(stamps) = transit.raw_stamps {
                int(out, stamps.sent.nanos());
                int(out, stamps.received.nanos());
            }
        }
        Measure::Value(value, value_unit) => {
            number(out, *value);
            unit(out, value_unit);
        }
        Measure::Throughput(rate) => {
            optional(out, rate.value, number);
            optional(out, rate.bounds.map(|(lo, _)| lo), number);
            optional(out, rate.bounds.map(|(_, hi)| hi), number);
        }
        Measure::TokenRate(rate) => optional(out, *rate, number),
        Measure::Custom(kind, value_unit, value) => {
            name(out, kind);
            unit(out, value_unit);
            optional(out, *value, number);
        }
    }
}

fn delay(out: &mut Vec<u8>, delay: &OneWayDelay) {
    array(out, 6);
    span(out, delay.raw);
    optional(out, delay.value, span);
    optional(out, delay.bounds.map(|bounds| bounds.lo), span);
    optional(out, delay.bounds.map(|bounds| bounds.hi), span);
    // The numbers are positions in `DelaySource::ALL` and `Verdict::ALL`. A variant may be added at the end, but no
    // variant may move.
    uint(out, delay.source as u64);
    uint(out, delay.verdict as u64);
}
