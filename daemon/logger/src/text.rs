//! Text form of a tree for people.
//!
//! The form is that of the paper's program, with four spaces per level and `name --> Time: 0.1234`. Units, bounds and
//! hosts are added.

use std::fmt;

use crate::{HostIndex, Measure, NodeId, Tree};

/// Formatter of a tree, created by [`Tree::text`].
#[derive(Clone, Copy, Debug)]
pub struct Text<'a>(&'a Tree);

impl Tree {
    /// Returns the tree as indented text with one line per node.
    ///
    /// ```
    /// # use std::sync::Arc;
    /// # use peernet_clock::{ClockIdentity, ManualClock, Span, WallTime};
    /// # use peernet_logger::{HostId, Recorder, Unit, stage};
    /// # let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("b", "c")));
    /// # let mut log = Recorder::new(clock.clone(), HostId::random());
    /// {
    ///     let mut sensing = log.time(stage::SENSING);
    ///     let _capture = sensing.time(stage::CAPTURE);
    ///     clock.advance(Span::from_micros(123_400));
    /// }
    /// log.record_value(stage::UPLOAD_BYTES, 150_000.0, Unit::BYTES);
    /// assert_eq!(log.finish().text().to_string(), "\
    /// iteration
    ///     sensing --> Time: 0.1234 s
    ///         capture --> Time: 0.1234 s
    ///     upload-bytes --> Value: 150000 B
    /// ");
    /// ```
    pub const fn text(&self) -> Text<'_> {
        Text(self)
    }
}

impl fmt::Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tree = self.0;
        // The children of each node in the order in which they were opened. One pass is enough, because parents precede
        // their children.
        let mut children = vec![Vec::new(); tree.nodes().len()];
        for (id, node) in tree.iter() {
            if let Some(parent) = node.parent {
                children[parent.index()].push(id);
            }
        }
        // The function uses a stack instead of recursion, so that a hostile tree cannot exhaust the call stack.
        let mut pending = vec![(NodeId::ROOT, 0)];
        while let Some((id, depth)) = pending.pop() {
            let Some(node) = tree.get(id) else { continue };
            write!(f, "{:indent$}{}", "", node.name, indent = 4 * depth)?;
            write_measure(f, &node.measure)?;
            if node.host != HostIndex::EDGE {
                write!(f, "  [host {}]", node.host.0)?;
            }
            f.write_str("\n")?;
            pending.extend(children[id.index()].iter().rev().map(|child| (*child, depth + 1)));
        }
        Ok(())
    }
}

fn write_measure(f: &mut fmt::Formatter<'_>, measure: &Measure) -> fmt::Result {
    let kind = match measure {
        Measure::Container => return Ok(()),
        Measure::Timer(_) | Measure::Transit(_) => "Time",
        Measure::Value(..) => "Value",
        Measure::Throughput(_) => "Throughput",
        Measure::TokenRate(_) => "Tokens per second",
        Measure::Custom(kind, ..) => kind.as_str(),
    };
    write!(f, " --> {kind}: ")?;
    match measure.value() {
        Some(value) => write_number(f, value)?,
        None if measure.is_open() => return f.write_str("not finished"),
        None => f.write_str("unknown")?,
    }
    let unit = measure.unit();
    if measure.value().is_some() && !unit.symbol().is_empty() {
        write!(f, " {}", unit.symbol())?;
    }
    match measure {
        Measure::Transit(transit) => match &transit.delay {
            Some(delay) => {
                if let Some(bounds) = delay.bounds.filter(|bounds| bounds.lo != bounds.hi) {
                    write_bounds(f, bounds.lo.seconds(), bounds.hi.seconds())?;
                }
                write!(f, " ({}, {})", delay.source, delay.verdict)
            }
            None => f.write_str(" (not corrected)"),
        },
        Measure::Throughput(rate) => match rate.bounds.filter(|(lo, hi)| lo < hi) {
            Some((lo, hi)) => write_bounds(f, lo, hi),
            None => Ok(()),
        },
        _ => Ok(()),
    }
}

fn write_bounds(f: &mut fmt::Formatter<'_>, lo: f64, hi: f64) -> fmt::Result {
    f.write_str(" within ")?;
    write_number(f, lo)?;
    f.write_str(" to ")?;
    write_number(f, hi)
}

/// Writes a number: whole numbers without decimals, small numbers with four significant digits, other numbers with four
/// decimals.
fn write_number(f: &mut fmt::Formatter<'_>, number: f64) -> fmt::Result {
    if number == number.trunc() && number.abs() < 1e15 {
        return write!(f, "{number}");
    }
    let magnitude = number.abs().log10().floor();
    if !(-9.0..15.0).contains(&magnitude) {
        return write!(f, "{number:.3e}");
    }
    write!(f, "{number:.*}", (3.0 - magnitude).clamp(4.0, 12.0) as usize)
}

#[cfg(test)]
mod tests {
    use peernet_clock::{DelaySource, Interval, OneWayDelay, Span, Verdict, WallTime};

    use super::*;
    use crate::{Anchor, HostId, Name, Node, Rate, Transit, Unit, stage};

    #[test]
    fn every_kind_has_its_text() {
        let anchor = || Anchor { host: HostId::random(), wall: WallTime::from_unix_nanos(0) };
        let node = |parent: u32, name: &str, host: u8, measure: Measure| Node {
            parent: Some(NodeId(parent)),
            name: Name::from(name),
            host: HostIndex(host),
            start: Span::ZERO,
            measure,
        };
        let transit = |delay| {
            let (sent, received) = (WallTime::from_unix_nanos(0), Some(WallTime::from_unix_nanos(1)));
            Measure::Transit(Box::new(Transit { sent, received, delay, raw_stamps: None }))
        };
        let delay = OneWayDelay {
            raw: Span::from_millis(5),
            value: Some(Span::from_micros(1_234)),
            bounds: Some(Interval { lo: Span::from_micros(1_200), hi: Span::from_micros(1_300) }),
            source: DelaySource::InBand,
            verdict: Verdict::Ok,
        };
        let root = Tree::new(stage::ITERATION, anchor()).nodes()[0].clone();
        let nodes = vec![
            root,
            node(0, "upload", 0, transit(Some(delay))),
            node(0, "inference", 1, Measure::Timer(Some(Span::from_nanos(20_130)))),
            node(0, "download", 1, transit(Some(OneWayDelay::unsynchronised(Span::ZERO)))),
            node(2, "board", 1, Measure::Custom("energy".into(), Unit::JOULES, Some(1.25))),
            node(0, "probe", 0, transit(None)),
            node(
                0,
                "rate",
                0,
                Measure::Throughput(Rate { value: Some(5e7), bounds: Some((4e7, f64::INFINITY)) }),
            ),
            node(0, "tokens", 0, Measure::TokenRate(Some(33.333_333))),
            node(0, "open", 0, Measure::Timer(None)),
            node(0, "grade", 0, Measure::Value(-0.5, Unit::NONE)),
            node(0, "tiny", 0, Measure::Value(1.5e-20, Unit::WATTS)),
        ];
        let tree = Tree::from_parts(vec![anchor(), anchor()], nodes).expect("a tree");
        let expected = "\
iteration
    upload --> Time: 0.001234 s within 0.001200 to 0.001300 (in-band, ok)
    inference --> Time: 0.00002013 s  [host 1]
        board --> energy: 1.2500 J  [host 1]
    download --> Time: unknown (none, unsynchronised)  [host 1]
    probe --> Time: unknown (not corrected)
    rate --> Throughput: 50000000 bit/s within 40000000 to inf
    tokens --> Tokens per second: 33.3333 token/s
    open --> Time: not finished
    grade --> Value: -0.5000
    tiny --> Value: 1.500e-20 W
";
        assert_eq!(tree.text().to_string(), expected);
    }
}
