//! Figures per configuration, and the difference of two.

use peernet_logger::{Name, stage};
use peernet_report::batches::{Difference, FEWEST};
use peernet_report::trust::batch_means;
use peernet_statistics::number::{Estimate, NONE, SPACE, bytes, count, duration, mean_std_ms, share, times};
use peernet_store::{Figures, StageMeans};

use super::{Comparison, Configuration};
use crate::look;
use crate::view::accuracy;

/// The columns of the paper's table, and both totals.
const COLUMNS: [(&str, &str); 6] = [
    ("sensing", "sensing"),
    ("upload", "upload"),
    ("inference", "inference"),
    ("download", "download"),
    ("stages-total", "sum of stages"),
    ("total", "total"),
];

/// A mean that is less than this times the smallest is about as large.
const ALIKE: f64 = 1.05;

/// Figures per configuration.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    pub header: Header,
    pub rows: Vec<Row>,
}

/// The names of the columns.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    pub axes: Vec<String>,
    pub columns: Vec<&'static str>,
    pub accuracies: Vec<&'static str>,
    /// Whether something was sent.
    pub sent: bool,
}

/// One configuration. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    pub letter: String,
    pub values: Vec<String>,
    /// Numbers of its runs.
    pub runs: Vec<i64>,
    pub iterations: String,
    /// Mean and standard deviation.
    pub cells: Vec<(String, Option<String>)>,
    /// Share of right answers and its interval, percent.
    pub accuracies: Vec<(String, Option<String>)>,
    /// Payload sent up on average, with unit.
    pub sent: String,
    pub best: bool,
}

impl Table {
    pub(crate) fn of(comparison: &Comparison) -> Self {
        let known = |name: &str| comparison.configurations.iter().any(|one| one.figures(name).is_some());
        let columns: Vec<_> = COLUMNS.into_iter().filter(|(name, _)| known(name)).collect();
        let accuracies: Vec<_> = look::ACCURACIES.into_iter().filter(|(name, _)| known(name)).collect();
        let best = comparison.best();
        let row = |(at, one): (usize, &Configuration)| Row {
            letter: one.letter.clone(),
            values: one.values.clone(),
            runs: one.runs.iter().map(|run| run.number).collect(),
            iterations: count(one.total().map_or(0, |total| total.count)),
            cells: columns
                .iter()
                .map(|(name, _)| match one.figures(name) {
                    Some(figures) => mean_std_ms(figures.mean, figures.std),
                    None => (NONE.to_owned(), None),
                })
                .collect(),
            accuracies: accuracies
                .iter()
                .map(|(name, _)| {
                    let shown = |figures: &Figures| (share(figures.mean), accuracy::interval(figures));
                    one.figures(name).map_or_else(|| (NONE.to_owned(), None), shown)
                })
                .collect(),
            sent: one
                .figures(&stage::UPLOAD_BYTES)
                .map_or_else(|| NONE.to_owned(), |sent| bytes(sent.mean).to_string()),
            best: best == Some(at),
        };
        Self {
            rows: comparison.configurations.iter().enumerate().map(row).collect(),
            header: Header {
                axes: comparison.axes.clone(),
                columns: columns.into_iter().map(|(_, shown)| shown).collect(),
                accuracies: accuracies.into_iter().map(|(_, shown)| shown).collect(),
                sent: known(&stage::UPLOAD_BYTES),
            },
        }
    }
}

/// A row of the difference of two configurations. Times in ms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Changed {
    pub name: String,
    pub look: &'static str,
    pub first: String,
    pub second: String,
    /// The second less the first, with its interval where there are enough batches. Nothing where only one has it.
    pub difference: String,
    pub interval: Option<String>,
    /// Whether it is more than chance; `None` where that cannot be told.
    pub certain: Option<bool>,
}

impl Changed {
    /// Of a stage that one of both lacks.
    fn of_one(name: &Name, first: Option<&Figures>, second: Option<&Figures>) -> Self {
        let mean = |side: Option<&Figures>| {
            side.map_or_else(|| NONE.to_owned(), |figures| mean_std_ms(figures.mean, None).0)
        };
        Self {
            look: look::class(name),
            first: mean(first),
            second: mean(second),
            difference: NONE.to_owned(),
            interval: None,
            certain: None,
            name: name.to_string(),
        }
    }
}

/// The second configuration less the first, stage by stage; courses are those of their runs in order.
pub(crate) fn difference(
    first: (&Configuration, &[Vec<StageMeans>]),
    second: (&Configuration, &[Vec<StageMeans>]),
) -> Vec<(Name, Option<Difference>, Changed)> {
    let names = [stage::TOTAL, stage::STAGES_TOTAL].into_iter().chain(stage::ORDER);
    let rows = names.filter_map(|name| {
        let shown = COLUMNS.iter().find(|(known, _)| name == **known).map_or(&*name, |(_, shown)| shown);
        let (a, b) = match (first.0.figures(&name), second.0.figures(&name)) {
            (Some(a), Some(b)) => (a, b),
            (None, None) => return None,
            (a, b) => return Some((name.clone(), None, Changed::of_one(&name, a, b))),
        };
        let found = Difference::of_batches(&batches(first.1, &name), &batches(second.1, &name));
        let found = found.map(|found| found.about(b.mean - a.mean));
        let value = found.map_or(b.mean - a.mean, |found| found.value);
        let shown_as = Estimate::new(value, found.map_or((value, value), |found| found.interval));
        let changed = Changed {
            look: look::class(&name),
            first: mean_std_ms(a.mean, None).0,
            second: mean_std_ms(b.mean, None).0,
            difference: shown_as.signed(),
            interval: found.map(|_| shown_as.shift()),
            certain: found.map(|found| found.is_certain()),
            name: shown.to_owned(),
        };
        Some((name, found, changed))
    });
    rows.collect()
}

/// Means of the batches of all runs of a configuration.
fn batches(runs: &[Vec<StageMeans>], name: &Name) -> Vec<f64> {
    let courses = runs.iter().flatten().filter(|course| course.stage == *name);
    let buckets =
        |course: &StageMeans| course.buckets.iter().map(|one| (one.count, one.mean)).collect::<Vec<_>>();
    courses.flat_map(|course| batch_means(&buckets(course))).collect()
}

/// Why a difference has no interval: who has how little. `None` where all have one.
pub(crate) fn too_short(
    first: (&Configuration, &[Vec<StageMeans>]),
    second: (&Configuration, &[Vec<StageMeans>]),
    found: &[(Name, Option<Difference>, Changed)],
) -> Option<String> {
    let (name, ..) =
        found.iter().find(|(_, found, changed)| found.is_none() && changed.difference != NONE)?;
    let side = |(one, courses): (&Configuration, &[Vec<StageMeans>])| {
        (batches(courses, name).len(), one.letter.clone())
    };
    let ((a, first), (b, second)) = (side(first), side(second));
    let rest = match (a < FEWEST, b < FEWEST) {
        (true, true) => "both runs are too short".to_owned(),
        (true, false) => format!("{first} is too short"),
        _ => format!("{second} is too short"),
    };
    Some(format!(
        "needs {FEWEST} stretches on each side, each of whole seconds and of at least 10 iterations, because neighbouring \
         iterations resemble each other; of {name}, {first} has {a} and {second} has {b}: {rest} to tell"
    ))
}

/// What the comparison found, in a sentence.
pub(crate) fn title(comparison: &Comparison, total: Option<&Difference>) -> String {
    let all = &comparison.configurations;
    let measured: Vec<&Configuration> = all.iter().filter(|one| one.total().is_some()).collect();
    let Some(best) = comparison.best().map(|at| &all[at]) else {
        return match (all.len(), measured.as_slice()) {
            (0, _) => "No run of this experiment was finished yet".to_owned(),
            (1, _) => "One configuration: there is nothing to compare it with yet".to_owned(),
            (_, [only]) => {
                format!("Only {} has measured anything: there is nothing to compare it with", only.letter)
            }
            _ => "No successful iteration of these runs is stored yet".to_owned(),
        };
    };
    let mean = |one: &Configuration| one.total().map(|total| total.mean);
    let fastest = mean(best).unwrap_or_default();
    if let ([first, second], Some(found)) = (all.as_slice(), total) {
        if !found.is_certain() {
            return format!("{} and {} do not differ by more than chance", first.letter, second.letter);
        }
        let (slow, less) = if found.value > 0.0 { (second, -found.value) } else { (first, found.value) };
        let least = found.interval.0.abs().min(found.interval.1.abs());
        let most = found.interval.0.abs().max(found.interval.1.abs());
        let less = Estimate::new(less.abs(), (least, most));
        return format!(
            "{} takes {}{SPACE}ms less than {} (95{SPACE}%: {}{SPACE}ms)",
            best.letter,
            less.value(),
            slow.letter,
            less.between()
        );
    }
    if all.len() == 2 {
        return format!("{} has the smaller mean, {}", best.letter, duration(fastest));
    }
    let others = all.iter().filter(|one| one.letter != best.letter).filter_map(|one| Some((one, mean(one)?)));
    let slowest = others.max_by(|a, b| a.1.total_cmp(&b.1));
    let ratio =
        slowest.filter(|(_, mean)| *mean >= fastest * ALIKE).map_or_else(String::new, |(slow, mean)| {
            format!("; that of {} is {} as large", slow.letter, times(mean / fastest))
        });
    let among = if measured.len() < all.len() { " measured ones" } else { "" };
    format!(
        "{} has the smallest mean of {}{among}, {}{ratio}",
        best.letter,
        measured.len(),
        duration(fastest)
    )
}

/// What the title leaves open: means alone do not tell who is fastest. `None` where it is told, or there is nothing to tell.
pub(crate) fn open(comparison: &Comparison, total: Option<&Difference>) -> Option<String> {
    let best = &comparison.configurations[comparison.best()?].letter;
    match comparison.configurations.len() {
        2 if total.is_some() => None,
        2 => Some(format!("whether {best} is the faster cannot be told from so little")),
        _ => {
            let whom =
                if comparison.experiment.is_some() { "about the folder of results" } else { "as below" };
            Some(format!(
                "whether {best} is the fastest cannot be told from means alone: ask peernet compare {whom}"
            ))
        }
    }
}

#[cfg(test)]
mod tests;
