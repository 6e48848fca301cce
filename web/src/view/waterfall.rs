//! The rows and sentences of an iteration's page.

mod bars;

use peernet_analysis::unaccounted_time::{NETWORK_AND_REST, UnaccountedTime};
use peernet_figures::scale::Scale;
use peernet_logger::stage;
use peernet_statistics::number::{
    EXACT, NONE, SPACE, StageColumn, ends_ms, interval_ms, shift_ms, signed_within_ms, within_ms,
};
use peernet_store::IterationDetail;

pub(crate) use bars::lanes;

use super::chip::Chip;
use super::link::basis::{brief, source_words};
use super::stack;
use crate::look;
use crate::picture::Picture;
use crate::timeline::{NodeLocation, PlacedNode, Timeline};

/// One node in the waterfall and in its table. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// Name of the host, in the first of consecutive rows of one host.
    pub group: Option<String>,
    /// Number of these rows.
    pub span: usize,
    pub class: &'static str,
    pub name: String,
    pub look: &'static str,
    pub depth: u8,
    pub host: String,
    pub value: String,
    pub bound: Option<String>,
    pub chip: Option<Chip>,
    pub difference: String,
    pub strong: bool,
    pub bar: Picture,
    pub start: String,
    pub lo: String,
    pub hi: String,
    pub median: String,
}

/// Computation of a one-way delay; times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DelayRow {
    pub name: String,
    pub raw: String,
    pub offset: String,
    pub value: String,
    pub lo: String,
    pub hi: String,
    pub source: &'static str,
    /// Assumptions behind the bounds; empty where they are not stored.
    pub basis: String,
    pub chip: Chip,
}

fn dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| NONE.to_owned())
}

/// Returns all rows: the nodes in order, the unattributed time, the total.
pub(crate) fn rows(
    detail: &IterationDetail,
    timeline: &Timeline,
    hosts: &[String],
    scale: &Scale,
) -> Vec<Row> {
    let column = timeline.column();
    let is_cause = |name: &str| detail.row.causes.iter().any(|cause| cause.name == *name);
    let row = |node: &PlacedNode| {
        let strong = node.is_counted && is_cause(node.name.as_str());
        Row::of(node, hosts, strong, bars::row(node, timeline, scale, strong), column)
    };
    let is_late = |node: &&PlacedNode| node.depth == 0 && node.name == *look::LATENESS;
    let mut rows: Vec<Row> = timeline.nodes.iter().filter(|node| !is_late(node)).map(row).collect();
    // Lateness is a part of the unattributed time, so its row is indented. Otherwise the column would seem to add up to more than the total.
    let late = timeline.nodes.iter().find(is_late).map(|node| Row { depth: 1, ..row(node) });

    let medians = detail.medians();
    let edge = hosts.first().cloned().unwrap_or_default();
    if let Some(durations) = stack::durations(&detail.row) {
        let (total, unaccounted) = (durations.total, UnaccountedTime::of(&durations));
        if let Some((name, seconds)) = unaccounted.network {
            let after = rows.iter().rposition(|row| row.class == "net").map_or(rows.len(), |last| last + 1);
            let usual = medians.both_ways().filter(|_| name == look::NETWORK);
            let mut row = Row::sum(name, "network".to_owned(), (seconds, usual), bars::blank(scale), column);
            row.strong = is_cause(name);
            rows.insert(after, row);
        }
        if let Some(rest) = unaccounted.unattributed {
            let median = medians.median(&stage::UNATTRIBUTED);
            let mut row = Row::sum("unattributed", edge.clone(), (rest, median), bars::blank(scale), column);
            row.strong = is_cause("unattributed");
            rows.push(row);
        }
        rows.extend(late);
        let mut total_row = Row::sum(
            "total",
            edge,
            (total, medians.median(&stage::TOTAL)),
            bars::total(total, scale),
            column,
        );
        total_row.class = "total";
        rows.push(total_row);
    }
    group(&mut rows);
    rows
}

/// Names each host once, at the first of its rows.
fn group(rows: &mut [Row]) {
    let mut begin = 0;
    while begin < rows.len() {
        let same = |row: &Row| row.host == rows[begin].host && row.class == rows[begin].class;
        let span = rows[begin..].iter().take_while(|row| same(row)).count().max(1);
        let total = rows[begin].class == "total";
        rows[begin].group = Some(if total { String::new() } else { rows[begin].host.clone() });
        rows[begin].span = span;
        begin += span;
    }
}

impl Row {
    fn of(node: &PlacedNode, hosts: &[String], strong: bool, bar: Picture, column: StageColumn) -> Self {
        let (host, class) = match node.at {
            NodeLocation::Network => ("network".to_owned(), "net"),
            NodeLocation::Host(0) => (hosts.first().cloned().unwrap_or_default(), ""),
            NodeLocation::Host(index) => (dash(hosts.get(usize::from(index)).cloned()), "cloud"),
        };
        let bounds = node.delay.and_then(|delay| delay.bounds);
        let difference =
            node.length.zip(node.median).map(|(length, median)| column.difference(length - median));
        Self {
            group: None,
            span: 1,
            class,
            name: node.name.to_string(),
            look: look::class(&node.name),
            depth: node.depth,
            host,
            value: dash(node.length.map(|length| digits(length, bounds, column))),
            bound: bounds.map(|(lo, hi)| if lo == hi { EXACT.to_owned() } else { interval_ms(lo, hi) }),
            chip: node.delay.map(|delay| Chip::verdict(delay.verdict)),
            difference: dash(difference),
            strong,
            bar,
            start: dash(node.start.map(|start| column.number(start))),
            lo: dash(bounds.map(|(lo, hi)| ends_ms(lo, hi)[0].clone())),
            hi: dash(bounds.map(|(lo, hi)| ends_ms(lo, hi)[1].clone())),
            median: dash(node.median.map(|median| column.duration(median))),
        }
    }

    /// Returns the row of a sum: its duration and the run's median, in seconds.
    fn sum(
        name: &str,
        host: String,
        (seconds, median): (f64, Option<f64>),
        bar: Picture,
        column: StageColumn,
    ) -> Self {
        Self {
            group: None,
            span: 1,
            class: if host == "network" { "net" } else { "" },
            name: name.to_owned(),
            look: look::class(name),
            depth: 0,
            host,
            value: column.duration(seconds),
            bound: (name == look::NETWORK || name == NETWORK_AND_REST).then(|| EXACT.to_owned()),
            chip: None,
            difference: dash(median.map(|median| column.difference(seconds - median))),
            strong: false,
            bar,
            start: NONE.to_owned(),
            lo: NONE.to_owned(),
            hi: NONE.to_owned(),
            median: dash(median.map(|median| column.duration(median))),
        }
    }
}

/// Returns a duration in ms: with the digits that its bounds support, or those of its column.
fn digits(seconds: f64, bounds: Option<(f64, f64)>, column: StageColumn) -> String {
    bounds.map_or_else(|| column.number(seconds), |bounds| within_ms(seconds, bounds))
}

/// Returns the computation of each one-way delay.
pub(crate) fn delays(timeline: &Timeline, stored_delays: &[peernet_store::DelayRow]) -> Vec<DelayRow> {
    let column = timeline.column();
    let nodes_with_delay = timeline.nodes.iter().filter_map(|node| Some((node, node.delay?)));
    let rows = nodes_with_delay.map(|(node, delay)| {
        let bounds = delay.bounds;
        // An exact delay has no interval next to its value.
        let interval_ends = bounds.filter(|(lo, hi)| hi > lo).map(|(lo, hi)| ends_ms(lo, hi));
        let end = |at: usize| {
            interval_ends.as_ref().map(|ends| ends[at].clone()).or(bounds.map(|_| EXACT.to_owned()))
        };
        DelayRow {
            name: node.name.to_string(),
            raw: digits(delay.raw, bounds, column),
            offset: dash(delay.value.map(|value| match bounds {
                Some(bounds) => signed_within_ms(value - delay.raw, bounds),
                None => column.difference(value - delay.raw),
            })),
            value: dash(delay.value.map(|value| digits(value, bounds, column))),
            lo: dash(end(0)),
            hi: dash(end(1)),
            source: source_words(delay.source),
            basis: stored_delays
                .iter()
                .find(|row| row.stage == node.name)
                .and_then(|row| row.assumptions.as_ref())
                .map_or_else(String::new, brief),
            chip: Chip::verdict(delay.verdict),
        }
    });
    rows.collect()
}

/// Returns a sentence on the way of the iteration to the other host and back, for readers who do not see the picture.
pub(crate) fn journey(timeline: &Timeline, edge: &str, cloud: &str) -> String {
    let Some(visit) = timeline.visit() else { return String::new() };
    let column = timeline.column();
    let at = |seconds: f64| format!("{}{SPACE}ms", column.duration(seconds));
    let back = visit.answer_times.map_or_else(
        || "no answer came back".to_owned(),
        |(_, back)| format!("the answer is back at {}", at(back)),
    );
    format!(
        "The sample leaves {edge} at {}, reaches {cloud} at {}, {back}",
        at(visit.sent_at),
        at(visit.arrival)
    )
}

/// Returns the effect of the clocks' uncertainty on the picture, in a sentence.
pub(crate) fn footnote(timeline: &Timeline, cloud: &str) -> Option<String> {
    let visit = timeline.visit()?;
    let (earlier, later) = visit.shift;
    if later - earlier <= 0.0 {
        return None;
    }
    let shift = shift_ms(earlier, later);
    let sum = visit.network.map_or_else(String::new, |network| {
        format!(", and so is upload + download = {}{SPACE}ms. Only its split between the two directions carries the bound", timeline.column().duration(network))
    });
    Some(format!("The bars on {cloud} may shift together by {shift}{SPACE}ms; their lengths are exact{sum}."))
}

#[cfg(test)]
mod tests {
    use peernet_analysis::slowness::Cause;
    use peernet_clock::{DelaySource, OneWayDelay, Span, WallTime};
    use peernet_logger::{Measure, Name, NodeId, Transit, stage};

    use super::*;
    use crate::tests::samples;

    /// Returns an answered iteration of 1.2 s whose two directions were judged `stepped`.
    fn stepped() -> IterationDetail {
        let mut detail = samples::iteration();
        let at = |seconds: i64| WallTime::from_unix_nanos(seconds * 1_000_000_000);
        for name in [stage::UPLOAD, stage::DOWNLOAD] {
            let delay = OneWayDelay::stepped(Span::from_seconds(-2), DelaySource::None);
            let transit =
                Transit { sent: at(9), received: Some(at(7)), delay: Some(delay), raw_stamps: None };
            detail.tree.add(NodeId::ROOT, name.clone(), Span::ZERO, Measure::Transit(Box::new(transit)));
            detail.row.delays.push(peernet_store::DelayRow {
                stage: name,
                value: None,
                bounds: None,
                raw: -2.0,
                source: DelaySource::None,
                verdict: peernet_clock::Verdict::Stepped,
                assumptions: None,
            });
        }
        let row = &mut detail.row;
        row.total = Some(1.2);
        row.stages = vec![(stage::SENSING, 0.0022)];
        (row.unattributed, row.both_ways) = (Some(0.0118), Some(1.186));
        detail
    }

    fn shown(detail: &IterationDetail) -> Vec<(String, String)> {
        let timeline = Timeline::of(detail);
        let rows = rows(detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(1_200.0, 6));
        rows.into_iter().map(|row| (row.name, row.value)).collect()
    }

    #[test]
    fn table_of_stepped_iteration_agrees_with_api() {
        let rows = shown(&stepped());
        let of = |stage_name: &str| {
            rows.iter().find(|(name, _)| name == stage_name).map(|(_, value)| value.as_str())
        };
        assert_eq!((of("upload"), of("download")), (Some("—"), Some("—")));
        assert_eq!((of("upload + download"), of("unattributed")), (Some("1,186.00"), Some("11.80")));
    }

    #[test]
    fn inseparable_times_have_one_common_row() {
        let mut detail = stepped();
        (detail.row.unattributed, detail.row.both_ways) = (None, None);
        let rows = shown(&detail);
        assert!(rows.contains(&(NETWORK_AND_REST.to_owned(), "1,197.80".to_owned())), "{rows:?}");
        assert!(rows.iter().all(|(name, _)| name != "unattributed"), "{rows:?}");
    }

    #[test]
    fn lateness_row_follows_unattributed_time() {
        let mut detail = samples::iteration();
        let late = Measure::Timer(Some(Span::from_micros(500)));
        detail.tree.add(NodeId::ROOT, Name::from(look::LATENESS), Span::ZERO, late);
        let timeline = Timeline::of(&detail);
        let rows = rows(&detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(100.0, 6));
        let end: Vec<(&str, u8)> =
            rows[rows.len() - 3..].iter().map(|row| (row.name.as_str(), row.depth)).collect();
        assert_eq!(end, [("unattributed", 0), ("lateness", 1), ("total", 0)]);
        assert_eq!(rows.iter().filter(|row| row.name == look::LATENESS).count(), 1);
    }

    #[test]
    fn only_nodes_that_statistics_count_are_compared() {
        let mut detail = samples::iteration();
        let tree = &mut detail.tree;
        let mut add = |parent, name: Name, millis| {
            tree.add(parent, name, Span::ZERO, Measure::Timer(Some(Span::from_millis(millis))))
        };
        let inference = add(NodeId::ROOT, stage::INFERENCE, 40);
        let inner = add(inference, Name::from_static("inner-model"), 12);
        add(inner, stage::INFERENCE, 10);
        add(NodeId::ROOT, stage::SEND_QUEUE, 3);
        add(NodeId::ROOT, stage::SEND_QUEUE, 2);
        // In a run whose iterations are all like this one, each median is the value in `data.csv`.
        let iteration = peernet_stream::Iteration {
            run: peernet_logger::RunId::random(),
            number: 1,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: peernet_stream::Outcome::Ok,
            tree: detail.tree.clone(),
        };
        let file_row = peernet_analysis::rows::Row::from_iteration(&iteration);
        let median_in_file = |name: &Name| file_row.value(name.as_str()).expect("a column");
        assert_eq!([stage::INFERENCE, stage::SEND_QUEUE].map(|name| median_in_file(&name)), [0.04, 0.005]);
        detail.run_figures.retain(|(name, _)| *name != stage::INFERENCE && *name != stage::SEND_QUEUE);
        for name in [stage::INFERENCE, stage::SEND_QUEUE] {
            let median = samples::figures(median_in_file(&name), 100);
            detail.run_figures.push((name, median));
        }
        detail.row.causes = vec![Cause { name: stage::INFERENCE, value: 0.04, median: 0.03 }];
        let timeline = Timeline::of(&detail);
        let rows = rows(&detail, &timeline, &["cam-1".to_owned()], &Scale::up_to(100.0, 6));
        let compared = |name: &str| {
            let rows = rows.iter().filter(|row| row.name == name);
            rows.map(|row| (row.value.clone(), row.median.clone(), row.strong)).collect::<Vec<_>>()
        };
        let row = |value: &str, median: &str, strong| (value.to_owned(), median.to_owned(), strong);
        assert_eq!(compared("inference"), [row("40.00", "40.00", true), row("10.00", NONE, false)]);
        assert_eq!(compared("send-queue"), [row("3.00", NONE, false), row("2.00", NONE, false)]);
    }

    #[test]
    fn delay_has_digits_of_its_bounds() {
        let mut detail = samples::iteration();
        let micros = Span::from_micros;
        let delay = OneWayDelay {
            raw: micros(1_204_043),
            value: Some(micros(43)),
            bounds: Some(peernet_clock::Interval { lo: micros(39), hi: micros(48) }),
            source: DelaySource::InBand,
            verdict: peernet_clock::Verdict::Ok,
        };
        let at = WallTime::from_unix_nanos(0);
        let transit =
            Transit { sent: at, received: Some(at + delay.raw), delay: Some(delay), raw_stamps: None };
        detail.tree.add(NodeId::ROOT, stage::UPLOAD, Span::ZERO, Measure::Transit(Box::new(transit)));
        detail.row.delays = vec![peernet_store::DelayRow {
            stage: stage::UPLOAD,
            value: Some(43e-6),
            bounds: Some((39e-6, 48e-6)),
            raw: 1.204_043,
            source: DelaySource::Chrony,
            verdict: peernet_clock::Verdict::Ok,
            assumptions: Some(peernet_store::DelayAssumptions {
                clocks: peernet_clock::RelatedClocks::Raw,
                max_drift_ppm: Some(200.0),
                max_drift_change_ppm_per_s: None,
                claims_trusted: Some(true),
                probes_authenticated: Some(false),
            }),
        }];
        let row = &delays(&Timeline::of(&detail), &detail.row.delays)[0];
        let basis = format!("by free-running clocks, ρ 200{SPACE}ppm, probes not authenticated");
        assert_eq!((row.source, row.basis.as_str()), ("in-band", basis.as_str()));
        let texts = [&row.raw, &row.offset, &row.value, &row.lo, &row.hi].map(String::as_str);
        assert_eq!(texts, ["1,204.043", "\u{2212}1,204.000", "0.043", "0.039", "0.048"]);
    }
}
