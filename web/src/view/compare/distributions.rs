//! Distributions of single runs. All distributions of a quantity have the same axis. The quantities are the total and
//! the six that the paper's program draws.

use peernet_analysis::figure_files::HISTOGRAMS;
use peernet_figures::drawing::BinnedAxis;
use peernet_figures::look;
use peernet_figures::plot::Unit;
use peernet_logger::{IterationValues, Name, stage};
use peernet_statistics::Summary;
use peernet_statistics::number::{self, count};

use super::Comparison;
use super::choice::{choose_runs, unsuccessful_runs_sentence};
use super::median::{Median, delay_of_quantity};
use crate::error::WebError;
use crate::picture::Picture;
use crate::view::chip::Chip;
use crate::view::units::display_unit;

/// Maximum number of pictures with which the distributions of all quantities are drawn together.
const MAX_PICTURES: usize = 24;

/// Distributions that are drawn, and hyperlinks to others.
pub(crate) struct Distributions {
    pub groups: Vec<Group>,
    /// Quantities that can be selected; empty where there is no choice.
    pub choices: Vec<Choice>,
    /// Part of the page's address that names the compared runs.
    pub address: Address,
    /// A sentence about runs without a successful iteration.
    pub missing: Option<String>,
}

/// One quantity of several runs, on one axis.
pub(crate) struct Group {
    pub title: String,
    pub unit: String,
    pub runs: Vec<RunHistogram>,
    /// Sentences about runs that are not drawn.
    pub missing: Vec<String>,
    /// Name of the node in hyperlinks to pages of runs; `None` for the total, which these pages show by default.
    pub stage: Option<String>,
}

/// One quantity of one run.
pub(crate) struct RunHistogram {
    pub run: i64,
    pub name: String,
    pub caption: String,
    /// Verdict on the clock bounds, if it needs attention.
    pub verdict_chip: Option<Chip>,
    pub picture: Picture,
}

/// A hyperlink to other distributions.
pub(crate) struct Choice {
    pub name: String,
    /// Name of the node whose distributions the hyperlink shows; `None` for the distributions of all nodes.
    pub stage: Option<String>,
    /// `true` if the page shows these distributions now.
    pub is_shown: bool,
}

/// Compared runs, as the address of the page names them.
pub(crate) enum Address {
    /// Id of an experiment.
    Experiment(String),
    /// Numbers of runs, separated by commas.
    Runs(String),
}

impl Address {
    pub(crate) fn of(comparison: &Comparison) -> Self {
        let runs = || comparison.runs().map(|run| run.number.to_string()).collect::<Vec<_>>();
        match &comparison.experiment {
            Some((_, id)) => Self::Experiment(id.clone()),
            None => Self::Runs(runs().join(",")),
        }
    }
}

/// A node's name with its title.
struct Quantity {
    name: Name,
    title: String,
}

impl Quantity {
    /// Returns the quantities that a comparison offers if they were measured.
    fn usual() -> Vec<Self> {
        let total = (stage::TOTAL, "Total");
        let published = HISTOGRAMS.map(|(_, column, title)| (Name::from_static(column), title));
        let all = std::iter::once(total).chain(published);
        all.map(|(name, title)| Self { name, title: title.to_owned() }).collect()
    }

    /// Returns the number of runs that have this quantity.
    fn run_count(&self, comparison: &Comparison) -> usize {
        comparison.runs().filter(|run| comparison.summary(run.number, &self.name).is_some()).count()
    }

    fn choice(&self, is_shown: bool) -> Choice {
        Choice { name: self.name.replace('-', " "), stage: Some(self.name.to_string()), is_shown }
    }

    fn group(&self, comparison: &Comparison) -> Option<Group> {
        let name = &self.name;
        let mut stages = comparison.configurations.iter().flat_map(|one| &one.stages);
        let unit = &stages.find(|statistics| statistics.stage == *name)?.unit;
        let (drawn, count_if_not_all) = choose_runs(comparison, |run| comparison.summary(run.number, name));
        let (symbol, per_si) = display_unit(unit);
        let summaries = drawn.iter().map(|(.., summary)| *summary);
        let axis = BinnedAxis::around(summaries, Unit::symbol(&symbol, per_si))?;
        // A throughput has the colour of its direction.
        let look = look::stage(name.trim_end_matches("-throughput"));
        let runs = drawn.iter().filter_map(|(one, run, summary)| {
            let median = Median::of(comparison.statistics_by_run.get(&run.number)?, name, unit)?;
            let (below, above) = axis.beyond(summary);
            let below = (below > 0).then(|| format!(", ←\u{a0}{}\u{a0}below", count(below)));
            let above = (above > 0).then(|| format!(", {}\u{a0}beyond\u{a0}→", count(above)));
            let beyond: String = below.into_iter().chain(above).collect();
            let caption = format!("{}, {}{beyond}", counted_values(name, summary), median.text);
            let label = format!("{} of run {}: {caption}", self.title, run.number);
            let name = one.name.clone();
            let items = axis.histogram(summary, &look, median.clock_interval);
            let picture =
                Picture::of_items(&items, "plot", &label).followed_by(&Picture::axis_below(&axis.scale));
            Some(RunHistogram { run: run.number, name, caption, verdict_chip: median.verdict_chip, picture })
        });
        let runs: Vec<RunHistogram> = runs.collect();
        let selection_note = count_if_not_all.map(|all| {
            format!(
                "{} of {all} runs: the first of each configuration, then the second, as far as there is room.",
                runs.len()
            )
        });
        Some(Group {
            title: self.title.clone(),
            unit: axis.axis().page_title(),
            missing: selection_note.into_iter().chain(self.undetermined_runs(comparison)).collect(),
            stage: (*name != stage::TOTAL).then(|| name.to_string()),
            runs,
        })
    }

    /// Returns a sentence about runs in which the clocks give no value of this quantity.
    fn undetermined_runs(&self, comparison: &Comparison) -> Option<String> {
        let delay = delay_of_quantity(&self.name)?;
        let runs = comparison.runs().filter(|run| {
            let statistics = comparison.statistics_by_run.get(&run.number);
            let has_delays = statistics.is_some_and(|statistics| statistics.bound(delay).is_some());
            has_delays && comparison.summary(run.number, &self.name).is_none()
        });
        let runs = runs.count();
        (runs > 0).then(|| {
            format!("The clocks do not determine this quantity for {}.", number::counted(runs as u64, "run"))
        })
    }
}

/// Returns the number of values of a quantity in words. If an iteration has at most one value, the word is
/// `iterations`, else `values`.
fn counted_values(name: &Name, values: &Summary) -> String {
    number::counted(values.count(), if IterationValues::has_one_value(name) { "iteration" } else { "value" })
}

/// Returns the distributions of the selected quantity. Without a selection, returns the
/// distributions of all quantities if there are at most [`MAX_PICTURES`] distributions, else only
/// those of the first measured quantity. `None` if nothing was measured and nothing is selected.
///
/// # Errors
/// Returns an error when the name of the quantity is not one of the usual names and no run has such a quantity.
pub(crate) fn distributions(
    comparison: &Comparison,
    selected: Option<&str>,
) -> Result<Option<Distributions>, WebError> {
    let mut offered = Quantity::usual();
    if let Some(name) = selected.filter(|name| offered.iter().all(|quantity| quantity.name != **name)) {
        let quantity = Quantity { name: Name::from(name), title: name.to_owned() };
        if quantity.run_count(comparison) == 0 {
            let usual: Vec<String> =
                Quantity::usual().iter().map(|quantity| quantity.name.to_string()).collect();
            let usual = usual.join(", ");
            return Err(WebError::BadRequest(format!(
                "query parameter stage: none of the compared runs has {name:?}; ask for a stage that they have, such as {usual}"
            )));
        }
        offered.push(quantity);
    }
    offered.retain(|quantity| quantity.run_count(comparison) > 0);
    let all_fit =
        offered.iter().map(|quantity| quantity.run_count(comparison)).sum::<usize>() <= MAX_PICTURES;
    let single_name: Option<Name> = match selected {
        Some(name) => Some(Name::from(name)),
        None if all_fit => None,
        None => offered.first().map(|quantity| quantity.name.clone()),
    };
    let is_shown = |quantity: &&Quantity| single_name.as_ref().is_none_or(|name| *name == quantity.name);
    let groups: Vec<Group> =
        offered.iter().filter(is_shown).filter_map(|quantity| quantity.group(comparison)).collect();
    let all =
        all_fit.then(|| Choice { name: "all".to_owned(), stage: None, is_shown: single_name.is_none() });
    let each = offered.iter().map(|quantity| quantity.choice(single_name.as_ref() == Some(&quantity.name)));
    let mut choices: Vec<Choice> = all.into_iter().chain(each).collect();
    // With one quantity, which is drawn, there is nothing to choose.
    if offered.len() < 2 && !groups.is_empty() {
        choices.clear();
    }
    let is_empty = offered.is_empty() && selected.is_none();
    Ok((!is_empty).then(|| Distributions {
        groups,
        choices,
        address: Address::of(comparison),
        missing: unsuccessful_runs_sentence(comparison),
    }))
}
