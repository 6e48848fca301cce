//! Histogram of one quantity.

mod bins;
mod distribution;

pub use bins::Bins;
pub use distribution::{CountNoun, Distribution, View};

pub(super) use bins::shown_range_of;
pub(super) use distribution::beyond_remark;

use peernet_statistics::number::count;

use crate::look::stage;
use crate::plot::{Figure, Unit};
use peernet_analysis::order::SortedValues;

/// Width of a plot in a file, as a multiple of the type size of its labels.
const WIDTH_EM: f64 = 31.0;

/// Histogram with its median and its 95th and 99th percentiles.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Title of the figure.
    pub title: String,
    /// Unit of the horizontal axis.
    pub unit: Unit,
    /// Stage that determines the colour of the bars.
    pub stage: String,
    /// The values, SI units.
    pub values: SortedValues,
    /// Notes below the figure, such as the number of values and what is left out.
    pub notes: Vec<String>,
}

impl Histogram {
    /// Lays the figure out.
    pub fn figure(&self) -> Figure {
        let (title, notes) = (self.title.clone(), self.notes.clone());
        let plots = Bins::of(&self.values).map(|bins| self.distribution(bins).plot());
        Figure { title, notes, plots: plots.into_iter().collect(), ..Figure::default() }
    }

    fn distribution(&self, bins: Bins) -> Distribution {
        let quantiles =
            [("median", self.values.median()), ("p95", self.values.p95()), ("p99", self.values.p99())];
        Distribution {
            edges: bins.edges,
            counts: bins.counts,
            // A column has at most one value in each iteration.
            count_noun: CountNoun::Iterations,
            beyond: bins.beyond,
            quantiles: quantiles.into_iter().filter_map(|(name, value)| Some((name, value?))).collect(),
            unit: self.unit.clone(),
            // A throughput has the colour of the stage that it belongs to.
            stage: stage(self.stage.trim_end_matches("-throughput")),
            view: View::Counts,
            is_logarithmic: false,
            min_width_em: WIDTH_EM,
        }
    }
}
