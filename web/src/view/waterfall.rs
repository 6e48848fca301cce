//! The rows and sentences of an iteration's page.

use peernet_aggregator::IterationDetail;

use super::cause::Cause;
use super::chip::Chip;
use super::timeline::{Placed, Timeline, Where};
use crate::look;
use crate::numbers::{NONE, SPACE, difference_ms, fixed, interval_ms, stage_ms};
use crate::svg::{Scale, WaterfallRow};

/// One node in the waterfall and in its table. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// The host, in the first row of a group of rows of one host.
    pub group: Option<String>,
    /// Rows in that group.
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
    pub bar: WaterfallRow,
    pub start: String,
    pub lo: String,
    pub hi: String,
    pub median: String,
}

/// How a one-way delay came about. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DelayRow {
    pub name: String,
    pub raw: String,
    pub offset: String,
    pub value: String,
    pub lo: String,
    pub hi: String,
    pub source: &'static str,
    pub chip: Chip,
}

fn dash(text: Option<String>) -> String {
    text.unwrap_or_else(|| NONE.to_owned())
}

/// All rows: the nodes in order, what they leave over, the total.
pub(crate) fn rows(
    detail: &IterationDetail,
    timeline: &Timeline,
    hosts: &[String],
    cause: Option<&Cause>,
    scale: &Scale,
) -> Vec<Row> {
    // Of an iteration that took as long as usual nothing stands out.
    let unusual = detail.row.factor.is_some_and(|factor| factor >= 1.05);
    let blamed = cause.filter(|_| unusual).map(|cause| cause.name.as_str());
    let mut rows: Vec<Row> = timeline
        .nodes
        .iter()
        .map(|node| {
            let strong = blamed == Some(node.name.as_str());
            Row::of(node, hosts, strong, WaterfallRow::new(node, timeline, scale, strong))
        })
        .collect();

    let figures = |name: &str| {
        detail.run_figures.iter().find(|(known, _)| known == name).map(|(_, figures)| figures.p50)
    };
    let edge = hosts.first().cloned().unwrap_or_default();
    if let Some(total) = detail.row.total {
        let known: f64 = detail.row.stages.iter().map(|(_, seconds)| seconds).sum();
        let unknown = timeline.visit().and_then(|visit| visit.network);
        let network_counted =
            timeline.nodes.iter().any(|node| node.at == Where::Network && node.length.is_some());
        let network = unknown.filter(|_| !network_counted);
        if let Some(network) = network {
            let after = rows.iter().rposition(|row| row.class == "net").map_or(rows.len(), |last| last + 1);
            rows.insert(
                after,
                Row::sum(look::NETWORK, "network".to_owned(), network, None, WaterfallRow::blank(scale)),
            );
        }
        let rest = total - known - network.unwrap_or(0.0);
        if rest > 0.0 {
            let median = figures("unattributed").filter(|_| network.is_none());
            rows.push(Row::sum("unattributed", edge.clone(), rest, median, WaterfallRow::blank(scale)));
        }
        let mut whole = Row::sum("total", edge, total, figures("total"), WaterfallRow::total(total, scale));
        whole.class = "total";
        rows.push(whole);
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
    fn of(node: &Placed, hosts: &[String], strong: bool, bar: WaterfallRow) -> Self {
        let (host, class) = match node.at {
            Where::Network => ("network".to_owned(), "net"),
            Where::Host(0) => (hosts.first().cloned().unwrap_or_default(), ""),
            Where::Host(index) => (dash(hosts.get(usize::from(index)).cloned()), "cloud"),
        };
        let bounds = node.delay.and_then(|delay| delay.bounds).map(|(lo, hi)| (lo.max(0.0), hi));
        let difference = node.length.zip(node.median).map(|(length, median)| difference_ms(length - median));
        Self {
            group: None,
            span: 1,
            class,
            name: node.name.to_string(),
            look: look::class(&node.name),
            depth: node.depth,
            host,
            value: dash(node.length.map(stage_ms)),
            bound: bounds.map(|(lo, hi)| if lo == hi { "exact".to_owned() } else { interval_ms(lo, hi) }),
            chip: node.delay.map(|delay| Chip::verdict(delay.verdict)),
            difference: dash(difference),
            strong,
            bar,
            start: dash(node.start.map(|start| fixed(start * 1e3, 2))),
            lo: dash(bounds.map(|(lo, _)| stage_ms(lo))),
            hi: dash(bounds.map(|(_, hi)| stage_ms(hi))),
            median: dash(node.median.map(stage_ms)),
        }
    }

    fn sum(name: &str, host: String, seconds: f64, median: Option<f64>, bar: WaterfallRow) -> Self {
        Self {
            group: None,
            span: 1,
            class: if host == "network" { "net" } else { "" },
            name: name.to_owned(),
            look: look::class(name),
            depth: 0,
            host,
            value: stage_ms(seconds),
            bound: (name == look::NETWORK).then(|| "exact".to_owned()),
            chip: None,
            difference: dash(median.map(|median| difference_ms(seconds - median))),
            strong: false,
            bar,
            start: NONE.to_owned(),
            lo: NONE.to_owned(),
            hi: NONE.to_owned(),
            median: dash(median.map(stage_ms)),
        }
    }
}

/// Where the delays came from.
pub(crate) fn delays(timeline: &Timeline) -> Vec<DelayRow> {
    let known = timeline.nodes.iter().filter_map(|node| Some((node, node.delay?)));
    let shown = known.map(|(node, delay)| DelayRow {
        name: node.name.to_string(),
        raw: fixed(delay.raw * 1e3, 2),
        offset: dash(delay.value.map(|value| difference_ms(value - delay.raw))),
        value: dash(delay.value.map(stage_ms)),
        lo: dash(delay.bounds.map(|(lo, _)| stage_ms(lo.max(0.0)))),
        hi: dash(delay.bounds.map(|(_, hi)| stage_ms(hi))),
        source: delay.source.name(),
        chip: Chip::verdict(delay.verdict),
    });
    shown.collect()
}

/// The journey in a sentence, for those who do not see the rails.
pub(crate) fn journey(timeline: &Timeline, edge: &str, cloud: &str) -> String {
    let Some(visit) = timeline.visit() else { return String::new() };
    let at = |seconds: f64| format!("{}{SPACE}ms", stage_ms(seconds));
    let back = visit.answered.map_or_else(
        || "no answer came back".to_owned(),
        |(_, back)| format!("the answer is back at {}", at(back)),
    );
    format!(
        "The sample leaves {edge} at {}, reaches {cloud} at {}, {back}",
        at(visit.left),
        at(visit.arrived)
    )
}

/// What the uncertainty of the clocks means for the picture.
pub(crate) fn footnote(timeline: &Timeline, cloud: &str) -> Option<String> {
    let visit = timeline.visit()?;
    let (earlier, later) = visit.shift;
    if later - earlier <= 0.0 {
        return None;
    }
    let shift = format!("{} to {}", difference_ms(earlier), difference_ms(later));
    let sum = visit.network.map_or_else(String::new, |network| {
        format!(", and so is upload + download = {}{SPACE}ms. Only its split between the two directions carries the bound", stage_ms(network))
    });
    Some(format!("The bars on {cloud} may shift together by {shift}{SPACE}ms; their lengths are exact{sum}."))
}
