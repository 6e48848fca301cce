//! How the runs of a comparison spread, from what is kept of each over its whole length: no iteration is read.

use std::collections::HashMap;

use peernet_aggregator::{RunSummary, Store};
use peernet_logger::stage;
use peernet_statistics::Summary;

use super::pictures::named;
use super::{Axes, Comparison, Configuration};
use crate::error::WebError;
use crate::numbers::{SPACE, count, figure};
use crate::svg::{BoxPlot, Five, Scale, SmallAxis, SmallHistogram};

/// Most runs whose distributions are drawn.
const MOST_SMALL: usize = 24;

/// Totals and inferences, seconds, by run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spreads {
    pub total: HashMap<i64, Summary>,
    pub inference: HashMap<i64, Summary>,
}

impl Spreads {
    /// Of all runs that are compared.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub(crate) async fn read(store: &Store, comparison: &Comparison) -> Result<Self, WebError> {
        let runs: Vec<i64> = comparison.runs().map(|run| run.number).collect();
        Ok(Self {
            total: store.summaries(&runs, &stage::TOTAL).await?,
            inference: store.summaries(&runs, &stage::INFERENCE).await?,
        })
    }
}

/// All runs of a configuration together.
pub(super) fn together(known: &HashMap<i64, Summary>, one: &Configuration) -> Option<Five> {
    let mut all = Summary::default();
    one.runs.iter().filter_map(|run| known.get(&run.number)).for_each(|run| all.merge(run));
    Five::of(&all)
}

/// A configuration's total as a box.
pub(crate) struct BoxRow {
    pub letter: String,
    pub name: String,
    pub median: String,
    pub quartiles: String,
    pub picture: BoxPlot,
}

/// The total of each configuration, its runs together, all on one scale.
pub(crate) fn boxes(comparison: &Comparison, spreads: &Spreads) -> (Vec<BoxRow>, Axes) {
    let known = comparison.configurations.iter();
    let known: Vec<_> = known.filter_map(|one| Some((one, together(&spreads.total, one)?))).collect();
    let scale = Scale::fit(known.iter().map(|(_, five)| five.top()).fold(0.0, f64::max) * 1e3, 6);
    let row = |(one, five): &(&Configuration, Five)| {
        let [p25, p50, p75] = five.middle.map(|seconds| figure(seconds * 1e3));
        BoxRow {
            letter: one.letter.clone(),
            name: named(&comparison.axes, one),
            median: p50,
            quartiles: format!("{p25} – {p75}"),
            picture: BoxPlot::new("total", &format!("{}, total", one.letter), five, &scale),
        }
    };
    (known.iter().map(row).collect(), Axes::of(&scale))
}

/// The total of single runs, side by side.
pub(crate) struct Distributions {
    pub runs: Vec<RunHistogram>,
    pub unit: &'static str,
    /// How many runs there are, where not all are drawn.
    pub of: Option<usize>,
}

/// The total of one run.
pub(crate) struct RunHistogram {
    pub run: i64,
    pub letter: String,
    pub said: String,
    pub picture: SmallHistogram,
}

/// The total of each run on one axis: with too many runs the first of each configuration, then the second.
pub(crate) fn distributions(comparison: &Comparison, spreads: &Spreads) -> Option<Distributions> {
    type Drawn<'a> = (usize, usize, &'a Configuration, &'a RunSummary, &'a Summary);
    let all = comparison.configurations.iter().enumerate().flat_map(|(place, one)| {
        let measured = one.runs.iter().filter_map(|run| Some((run, spreads.total.get(&run.number)?)));
        measured.enumerate().map(move |(repeat, (run, known))| (repeat, place, one, run, known))
    });
    let mut all: Vec<Drawn<'_>> = all.collect();
    let measured = all.len();
    all.sort_by_key(|(repeat, place, ..)| (*repeat, *place));
    all.truncate(MOST_SMALL);
    all.sort_by_key(|(repeat, place, ..)| (*place, *repeat));
    let axis = SmallAxis::of(all.iter().map(|(.., known)| *known))?;
    let runs = all.iter().map(|(_, _, one, run, known)| {
        let beyond = match axis.beyond(known) {
            0 => String::new(),
            beyond => format!(", {} beyond →", count(beyond)),
        };
        let median = known.quantile(0.5).map_or(0.0, |median| median * 1e3);
        RunHistogram {
            run: run.number,
            letter: one.letter.clone(),
            said: format!("median {}{SPACE}ms of {}{beyond}", figure(median), count(known.count())),
            picture: SmallHistogram::new(&format!("Total of run {}", run.number), known, &axis),
        }
    });
    Some(Distributions {
        runs: runs.collect(),
        unit: if axis.is_logarithmic() { "ms, logarithmic" } else { "ms" },
        of: (measured > MOST_SMALL).then_some(measured),
    })
}
