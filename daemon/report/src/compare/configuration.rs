//! What distinguishes runs: the first columns of a comparison.

use crate::results::{Loaded, RunRecord};

/// What stands where a run has nothing of the kind.
pub(super) const NOTHING: &str = "—";
/// Facts that follow from a run's model or data set, which stand there already.
const IMPLIED: [&str; 5] = ["model", "device", "task", "input", "labels"];

/// The configurations of some runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Configurations {
    /// What distinguishes them, the columns' names.
    pub(crate) axes: Vec<String>,
    /// One for each run: as many labels as there are axes.
    pub(crate) labels: Vec<Vec<String>>,
}

impl Configurations {
    /// Runs of one experiment are told apart by its fields, all of them, as the experiment's author declared them. Of other
    /// runs the columns are whatever differs among them: model, device, where, network, hosts, facts. Runs that are alike
    /// in all of that, and no declared repeats, are told apart by their folders.
    pub(crate) fn of(runs: &[Loaded]) -> Self {
        let records = || runs.iter().map(|run| &run.record);
        let places: Vec<Vec<(String, String)>> = records().map(place).collect();
        let same_axes = |places: &[Vec<(String, String)>]| {
            let names = |place: &Vec<(String, String)>| {
                place.iter().map(|(axis, _)| axis.clone()).collect::<Vec<_>>()
            };
            places.windows(2).all(|pair| names(&pair[0]) == names(&pair[1]))
        };
        let declared = records().all(|record| record.experiment.is_some()) && same_axes(&places);
        let pairs: Vec<Vec<(String, String)>> = if declared {
            places
        } else {
            records().zip(places).map(|(record, place)| [place, found(record)].concat()).collect()
        };
        let mut this = Self::tabulate(&pairs);
        if !declared {
            this.keep_what_differs();
        }
        let executions = executions(runs);
        if differ(&executions) {
            this.add("execution", executions);
        }
        if this.has_strangers_alike(runs) {
            this.add("run", folders(runs));
        } else if this.axes.is_empty() {
            this.add("run", records().map(|record| record.name.clone()).collect());
        }
        this
    }

    /// All names in the order of their first appearance, each run's label below.
    fn tabulate(pairs: &[Vec<(String, String)>]) -> Self {
        let mut axes: Vec<String> = Vec::new();
        for (axis, _) in pairs.iter().flatten() {
            if !axes.contains(axis) {
                axes.push(axis.clone());
            }
        }
        let label = |pairs: &Vec<(String, String)>, axis: &String| {
            let found = pairs.iter().find(|(name, _)| name == axis).map(|(_, label)| label.clone());
            found.filter(|label| !label.is_empty()).unwrap_or_else(|| NOTHING.to_owned())
        };
        let labels = pairs.iter().map(|pairs| axes.iter().map(|axis| label(pairs, axis)).collect()).collect();
        Self { axes, labels }
    }

    fn keep_what_differs(&mut self) {
        let column = |at: usize| self.labels.iter().map(|labels| labels[at].clone()).collect::<Vec<_>>();
        let kept: Vec<usize> = (0..self.axes.len()).filter(|at| differ(&column(*at))).collect();
        self.axes = kept.iter().map(|at| self.axes[*at].clone()).collect();
        self.labels =
            self.labels.iter().map(|labels| kept.iter().map(|at| labels[*at].clone()).collect()).collect();
    }

    fn add(&mut self, axis: &str, labels: Vec<String>) {
        self.axes.push(axis.to_owned());
        self.labels.iter_mut().zip(labels).for_each(|(all, label)| all.push(label));
    }

    /// Tells repeats apart.
    pub(super) fn add_repeats(&mut self, runs: &[Loaded]) {
        let repeat = |run: &Loaded| match &run.record.experiment {
            // For people, from 1.
            Some(place) => (place.repeat + 1).to_string(),
            None => NOTHING.to_owned(),
        };
        let repeats: Vec<String> = runs.iter().map(repeat).collect();
        if differ(&repeats) {
            self.add("repeat", repeats);
        }
    }

    /// Whether two runs have the same labels without being declared repeats of one another.
    fn has_strangers_alike(&self, runs: &[Loaded]) -> bool {
        let pairs = (0..runs.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        let mut alike = pairs.filter(|(a, b)| self.labels[*a] == self.labels[*b]);
        alike.any(|(a, b)| !are_repeats(&runs[a].record, &runs[b].record))
    }
}

/// Whether two runs are repeats of one configuration of one execution of an experiment, or two edges that were measured
/// at once, as users of one cloud.
fn are_repeats(a: &RunRecord, b: &RunRecord) -> bool {
    let edges = a.edge.name != b.edge.name;
    let (Some(a), Some(b)) = (&a.experiment, &b.experiment) else { return false };
    (&a.name, &a.id, &a.configuration) == (&b.name, &b.id, &b.configuration)
        && (a.repeat != b.repeat || edges)
}

/// The fields of a run's experiment.
fn place(record: &RunRecord) -> Vec<(String, String)> {
    record.experiment.as_ref().map(|place| place.configuration.clone()).unwrap_or_default()
}

/// What a run's record says of its configuration, the paper's columns first.
fn found(record: &RunRecord) -> Vec<(String, String)> {
    let pair = |axis: &str, label: Option<&str>| (axis.to_owned(), label.unwrap_or_default().to_owned());
    let model = record.model.as_ref();
    let mut pairs = vec![
        pair("model", model.map(|model| model.name.as_str())),
        pair("device", model.and_then(|model| model.device.as_deref())),
        pair("where", Some(&record.placement.kind)),
        pair("network", record.placement.network.as_deref()),
        pair("edge", Some(&record.edge.name)),
        pair("cloud", record.cloud.as_ref().map(|cloud| cloud.name.as_str())),
    ];
    let implied = |fact: &str| IMPLIED.iter().any(|name| name.eq_ignore_ascii_case(fact));
    pairs.extend(record.facts.iter().filter(|(fact, _)| !implied(fact)).cloned());
    pairs
}

/// Which execution of which experiment each run belongs to.
fn executions(runs: &[Loaded]) -> Vec<String> {
    let experiments = || runs.iter().map(|run| run.record.experiment.as_ref());
    let names: Vec<String> =
        experiments().map(|place| place.map_or(NOTHING, |place| &place.name).to_owned()).collect();
    if differ(&names) {
        return names;
    }
    let short = |id: &str| id.chars().take(8).collect::<String>();
    experiments().map(|place| place.map_or_else(|| NOTHING.to_owned(), |place| short(&place.id))).collect()
}

/// The runs' folders without what all of them have in front.
fn folders(runs: &[Loaded]) -> Vec<String> {
    let parts = |run: &Loaded| -> Vec<String> {
        run.folder.components().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
    };
    let all: Vec<Vec<String>> = runs.iter().map(parts).collect();
    let shortest = all.iter().map(Vec::len).min().unwrap_or_default();
    let common = (0..shortest).take_while(|at| all.iter().all(|parts| parts[*at] == all[0][*at])).count();
    // The last part always stands there.
    let common = common.min(shortest.saturating_sub(1));
    all.iter().map(|parts| parts[common..].join("/")).collect()
}

fn differ(labels: &[String]) -> bool {
    labels.windows(2).any(|pair| pair[0] != pair[1])
}
