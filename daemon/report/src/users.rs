//! Many users of one cloud at once: latency against their number, and how evenly they are served.

use crate::number::{fixed, milliseconds, significant};
use crate::order::Ordered;
use crate::results::{Loaded, Row};
use crate::table::{Table, csv_text};

/// Fewest values that a percentile is given of, as everywhere in PEERNet.
const ENOUGH_FOR_P95: usize = 60;
const ENOUGH_FOR_P99: usize = 300;
const NOTHING: &str = "—";
const NOTE: &str = "Counted while all edges of a run were measuring. Fairness is Jain's index of the edges' rates: 1 when all \
                    are served alike, 1/n when one of n gets everything.";

/// Jain's index of fairness, (Σx)² / (n Σx²): from 1/n, where one gets everything, to 1, where all get the same (Jain,
/// Chiu and Hawe 1984, *A Quantitative Measure of Fairness and Discrimination for Resource Allocation in Shared Computer
/// Systems*, DEC-TR-301). `None` where nobody gets anything.
pub fn jain(shares: &[f64]) -> Option<f64> {
    let (sum, squares) = shares.iter().fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
    (squares > 0.0).then(|| sum * sum / (shares.len() as f64 * squares))
}

/// How configurations with one or many users fared.
#[derive(Clone, Debug, PartialEq)]
pub struct Users {
    /// Names of the columns that tell the lines apart.
    pub axes: Vec<String>,
    /// One for each configuration, in the order in which they came.
    pub lines: Vec<UsersLine>,
}

/// One configuration. Seconds, iterations per second.
#[derive(Clone, Debug, PartialEq)]
pub struct UsersLine {
    /// What distinguishes it: as many labels as there are axes.
    pub labels: Vec<String>,
    /// Edges at once.
    pub edges: usize,
    /// Answers per second of all edges together, on average over the repeats; `None` where they never measured at the
    /// same time.
    pub rate: Option<f64>,
    /// Those of the edge that got the fewest, over all repeats.
    pub least: Option<f64>,
    /// Those of the edge that got the most.
    pub most: Option<f64>,
    /// [`jain`] of the edges' rates, on average over the repeats.
    pub fairness: Option<f64>,
    /// The totals of all edges.
    pub totals: Ordered,
}

impl Users {
    /// What runs show, each as the results of its users; `None` where all have a single one.
    pub fn of(runs: &[Vec<Loaded>]) -> Option<Self> {
        runs.iter().any(|users| users.len() > 1).then_some(())?;
        let place = |users: &[Loaded]| -> Vec<(String, String)> {
            let experiment = users.first().and_then(|user| user.record.experiment.as_ref());
            experiment.map(|place| place.configuration.clone()).unwrap_or_default()
        };
        let axes = runs.first().map(|users| place(users)).unwrap_or_default();
        let axes = axes.into_iter().map(|(axis, _)| axis).collect();
        let mut groups: Vec<(Vec<String>, Vec<&[Loaded]>)> = Vec::new();
        for users in runs {
            let labels: Vec<String> = place(users).into_iter().map(|(_, label)| label).collect();
            match groups.iter_mut().find(|(other, group)| *other == labels && group[0].len() == users.len()) {
                Some((_, group)) => group.push(users),
                None => groups.push((labels, vec![users])),
            }
        }
        Some(Self {
            axes,
            lines: groups.into_iter().map(|(labels, group)| UsersLine::new(labels, &group)).collect(),
        })
    }

    /// For the terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{NOTE}", self.table().text())
    }

    /// For documents.
    pub fn markdown(&self) -> String {
        format!("{}\n{NOTE}\n", self.table().markdown())
    }

    /// For papers, with booktabs.
    pub fn latex(&self) -> String {
        self.table().latex(NOTE)
    }

    /// For programs: seconds and iterations per second, every digit.
    pub fn csv(&self) -> String {
        let mut header: Vec<&str> = self.axes.iter().map(String::as_str).collect();
        header.extend(["edges", "rate", "rate-least", "rate-most", "fairness", "count"]);
        header.extend(["total-mean", "total-p50", "total-p95", "total-p99"]);
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let row = |line: &UsersLine| {
            let mut cells = line.labels.clone();
            cells.push(line.edges.to_string());
            cells.extend([line.rate, line.least, line.most, line.fairness].map(number));
            cells.push(line.totals.len().to_string());
            cells.extend(line.latencies().map(number));
            cells
        };
        csv_text(&header, &self.lines.iter().map(row).collect::<Vec<_>>())
    }

    fn table(&self) -> Table {
        let mut header = self.axes.clone();
        let labels = header.len();
        header.extend(["edges", "iterations/s", "per edge", "fairness"].map(str::to_owned));
        header.extend(["mean ms", "p50 ms", "p95 ms", "p99 ms"].map(|name| format!("total {name}")));
        let told =
            |value: Option<f64>, form: fn(f64) -> String| value.map_or_else(|| NOTHING.to_owned(), form);
        let row = |line: &UsersLine| {
            let mut cells = line.labels.clone();
            let range = line.least.zip(line.most);
            cells.push(line.edges.to_string());
            cells.push(told(line.rate, significant));
            cells.push(range.map_or_else(
                || NOTHING.to_owned(),
                |(least, most)| format!("{} – {}", significant(least), significant(most)),
            ));
            cells.push(told(line.fairness, |value| fixed(value, 3)));
            cells.extend(line.latencies().map(|value| told(value, milliseconds)));
            cells
        };
        Table { header, labels, rows: self.lines.iter().map(row).collect(), marked: Vec::new() }
    }
}

impl UsersLine {
    fn new(labels: Vec<String>, repeats: &[&[Loaded]]) -> Self {
        let shared: Vec<(Vec<f64>, Vec<f64>)> = repeats.iter().filter_map(|users| at_once(users)).collect();
        let rates = || shared.iter().map(|(rates, _)| rates);
        let each = || rates().flatten().copied();
        Self {
            labels,
            edges: repeats.first().map_or(0, |users| users.len()),
            rate: mean(rates().map(|rates| rates.iter().sum())),
            least: each().reduce(f64::min),
            most: each().reduce(f64::max),
            fairness: mean(rates().filter_map(|rates| jain(rates))),
            totals: shared.iter().flat_map(|(_, totals)| totals).copied().collect(),
        }
    }

    /// Mean, median, 95th and 99th percentile of the totals; `None` where there are too few.
    fn latencies(&self) -> [Option<f64>; 4] {
        let enough = |least, p| self.totals.quantile(p).filter(|_| self.totals.len() >= least);
        [
            mean(self.totals.values().iter().copied()),
            self.totals.median(),
            enough(ENOUGH_FOR_P95, 0.95),
            enough(ENOUGH_FOR_P99, 0.99),
        ]
    }
}

/// Each user's answers per second and all totals, of the time in which all were measuring; `None` where there is none.
fn at_once(users: &[Loaded]) -> Option<(Vec<f64>, Vec<f64>)> {
    let rows: Vec<Vec<&Row>> =
        users.iter().map(|user| user.rows.iter().filter(|row| row.counts()).collect()).collect();
    let first = |rows: &Vec<&Row>| rows.iter().map(|row| row.at).reduce(f64::min);
    let last = |rows: &Vec<&Row>| rows.iter().map(|row| row.at).reduce(f64::max);
    let from = rows.iter().map(first).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)?;
    let to = rows.iter().map(last).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::min)?;
    (to > from).then_some(())?;
    // One interval fewer than there are starts: the window begins with one and ends with one.
    let within: Vec<Vec<&Row>> = rows
        .into_iter()
        .map(|rows| rows.into_iter().filter(|row| (from..to).contains(&row.at)).collect())
        .collect();
    let rates = within.iter().map(|rows| rows.len() as f64 / (to - from)).collect();
    let totals = within.iter().flatten().filter_map(|row| row.value("total")).collect();
    Some((rates, totals))
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use peernet_logger::stream::ExperimentPlace;

    use super::*;
    use crate::results::{Outcome, RunRecord};

    #[test]
    fn the_index_goes_from_one_nth_to_one() {
        assert_eq!(jain(&[5.0, 5.0, 5.0]), Some(1.0));
        assert_eq!(jain(&[0.0, 7.0, 0.0, 0.0]), Some(0.25));
        // The paper's own example: 5, 3, 1, …: (1+1+1+1+0)² / (5 · 4).
        assert_eq!(jain(&[1.0, 1.0, 1.0, 1.0, 0.0]), Some(0.8));
        assert_eq!((jain(&[]), jain(&[0.0])), (None, None));
    }

    /// A user who asks `count` times from `from` on, every `each` seconds.
    fn user(labels: &[(&str, &str)], from: f64, each: f64, count: u32, total: f64) -> Loaded {
        let row = |at: u32| Row {
            iteration: u64::from(at) + 1,
            at: from + f64::from(at) * each,
            episode: 0,
            step: 0,
            warm_up: false,
            outcome: Outcome::Ok,
            reason: None,
            values: vec![("total".into(), total)],
            upload: None,
            download: None,
        };
        let configuration = labels.iter().map(|(axis, label)| ((*axis).to_owned(), (*label).to_owned()));
        let place = ExperimentPlace {
            name: "e".to_owned(),
            id: "1".to_owned(),
            configuration: configuration.collect(),
            repeat: 0,
        };
        let record = RunRecord { experiment: Some(place), ..RunRecord::default() };
        Loaded { folder: "x".into(), record, rows: (0..count).map(row).collect() }
    }

    #[test]
    fn only_the_time_in_which_all_measure_counts() {
        let one = vec![user(&[("N", "1")], 0.0, 0.5, 21, 0.25)];
        // The second begins 2 s late and ends with the first; it gets half as much.
        let two = vec![user(&[("N", "2")], 0.0, 0.5, 21, 0.5), user(&[("N", "2")], 2.0, 1.0, 9, 1.0)];
        let users = Users::of(&[one.clone(), two]).expect("several users");
        assert_eq!((users.axes.as_slice(), users.lines.len()), (["N".to_owned()].as_slice(), 2));
        let [alone, both] = users.lines.as_slice() else { panic!("two lines") };
        assert_eq!((alone.edges, alone.rate, alone.fairness), (1, Some(2.0), Some(1.0)));
        assert_eq!((both.edges, both.rate, both.least, both.most), (2, Some(3.0), Some(1.0), Some(2.0)));
        assert_eq!(both.fairness, Some(0.9));
        // 16 of the first and 8 of the second.
        assert_eq!((both.totals.len(), both.totals.median()), (24, Some(0.5)));
        assert!(users.text().contains("0.900"), "{}", users.text());
        assert!(users.csv().starts_with("N,edges,rate,"), "{}", users.csv());
        assert_eq!(Users::of(&[one]), None);
    }

    #[test]
    fn users_who_never_met_have_no_rates() {
        let apart = vec![user(&[], 0.0, 0.5, 5, 0.1), user(&[], 100.0, 0.5, 5, 0.1)];
        let users = Users::of(&[apart]).expect("several users");
        assert_eq!((users.lines[0].rate, users.lines[0].fairness), (None, None));
        assert!(users.text().contains('—'), "{}", users.text());
    }
}
