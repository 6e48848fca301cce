//! Labels of runs: facts that distinguish them, as columns and as names.

pub(super) use peernet_statistics::number::NONE as EMPTY_CELL;
use peernet_stream::ExperimentPosition;

use super::columns::Column;
use crate::model_places::place_word;

/// Names of facts that get no column, because they follow from the model or the data set of a run, which have their own
/// columns.
const IMPLIED_FACTS: [&str; 6] = ["model", "device", "task", "input", "labels", "classes"];

/// Returns the name of each configuration. The name has the labels of the columns in which the configurations differ,
/// or all labels if there is no difference. If two configurations with different labels, such as `no` and `none`, would
/// have the same name, their names have each label after the name of its axis.
pub fn readable_names<'a>(
    axes: &[String],
    configurations: impl IntoIterator<Item = &'a [String]>,
) -> Vec<String> {
    let all: Vec<&[String]> = configurations.into_iter().collect();
    let differs = |axis: &usize| all.windows(2).any(|pair| pair[0].get(*axis) != pair[1].get(*axis));
    let mut chosen: Vec<usize> = (0..axes.len()).filter(differs).collect();
    if chosen.is_empty() {
        chosen = (0..axes.len()).collect();
    }
    let axes: Vec<String> = chosen.iter().map(|axis| axes[*axis].clone()).collect();
    let labels_of = |labels: &&[String]| -> Vec<String> {
        chosen
            .iter()
            .map(|axis| labels.get(*axis).cloned().unwrap_or_else(|| EMPTY_CELL.to_owned()))
            .collect()
    };
    let rows: Vec<Vec<String>> = all.iter().map(labels_of).collect();
    let names: Vec<String> = rows.iter().map(|labels| readable_name(&axes, labels)).collect();
    let name = |(name, labels): (&String, &Vec<String>)| {
        let has_namesake = rows
            .iter()
            .zip(&names)
            .any(|(other_labels, other_name)| other_name == name && other_labels != labels);
        if has_namesake { name_with_axes(&axes, labels) } else { name.clone() }
    };
    names.iter().zip(&rows).map(name).collect()
}

/// Returns the labels as cells of a CSV file, in which the cell of a missing label is empty.
pub(crate) fn csv_labels(labels: &[String]) -> Vec<String> {
    let cell = |label: &String| if label == EMPTY_CELL { String::new() } else { label.clone() };
    labels.iter().map(cell).collect()
}

/// Returns the labels, each after the name of its axis. Missing labels are left out.
fn name_with_axes(axes: &[String], labels: &[String]) -> String {
    let present = axes.iter().zip(labels).filter(|(_, label)| *label != EMPTY_CELL);
    present.map(|(axis, label)| format!("{axis} {label}")).collect::<Vec<_>>().join(", ")
}

/// Returns the name of a configuration from its labels. A label that is not clear by itself is combined with the name
/// of its axis: `no resize` instead of `no`, `edges 4` instead of `4`. Missing labels are left out.
pub(super) fn readable_name(axes: &[String], labels: &[String]) -> String {
    let present = axes.iter().zip(labels).filter(|(_, label)| *label != EMPTY_CELL);
    let texts = present.map(|(axis, label)| match label.as_str() {
        "yes" | "true" | "on" => axis.clone(),
        "no" | "none" | "false" | "off" => format!("no {axis}"),
        number if number.parse::<f64>().is_ok() => format!("{axis} {number}"),
        name => name.to_owned(),
    });
    texts.collect::<Vec<_>>().join(", ")
}

/// Facts about a run that distinguish it from other runs, besides the fields that an experiment declares.
#[derive(Clone, Copy, Debug)]
pub struct RunFacts<'a> {
    /// Name of the model; `None` for a run without a model.
    pub model: Option<&'a str>,
    /// Device of the model; `None` if it is not known.
    pub device: Option<&'a str>,
    /// Kind of the placement.
    pub placement: &'a str,
    /// Kind of the network; `None` if it is not known.
    pub network: Option<&'a str>,
    /// Name of the edge.
    pub edge: &'a str,
    /// Name of the cloud; `None` for a run without a cloud.
    pub cloud: Option<&'a str>,
    /// Facts about sensor, transforms, load and so on, as pairs of name and text.
    pub facts: &'a [(String, String)],
    /// Name of the pipeline; `None` if it is not known.
    pub pipeline: Option<&'a str>,
}

/// Returns everything that may distinguish runs: for each run, pairs of name and label. They are the fields that the
/// run's experiment declares, the execution of the experiment, and the facts. [`tabulate`] makes columns of these
/// pairs, and [`choose_columns`](super::choose_columns) chooses among the columns.
pub fn distinguishing_pairs(
    runs: &[(Option<&ExperimentPosition>, RunFacts<'_>)],
) -> Vec<Vec<(String, String)>> {
    let positions: Vec<Option<&ExperimentPosition>> = runs.iter().map(|(position, _)| *position).collect();
    let pairs = runs.iter().zip(executions(&positions)).map(|((position, facts), execution)| {
        let execution = vec![("execution".to_owned(), execution)];
        [declared_labels(*position), execution, facts.pairs()].concat()
    });
    pairs.collect()
}

/// Returns the columns of runs of experiments: the fields that the experiments declare, and the execution of the
/// experiment if the runs belong to several executions. `None` unless every run belongs to an experiment and all
/// experiments declare the same fields.
pub fn experiment_columns(positions: &[Option<&ExperimentPosition>]) -> Option<Vec<Column>> {
    let declared: Vec<Vec<(String, String)>> =
        positions.iter().map(|position| declared_labels(*position)).collect();
    let names = |labels: &[(String, String)]| labels.iter().map(|(axis, _)| axis.clone()).collect::<Vec<_>>();
    let have_same_fields = declared.windows(2).all(|pair| names(&pair[0]) == names(&pair[1]));
    (have_same_fields && positions.iter().all(Option::is_some)).then(|| {
        let execution = Column { axis: "execution".to_owned(), labels: executions(positions) };
        tabulate(&declared).into_iter().chain(Some(execution).filter(Column::differs)).collect()
    })
}

/// Returns the fields that an experiment declares, as pairs of name and label; empty outside of experiments.
fn declared_labels(position: Option<&ExperimentPosition>) -> Vec<(String, String)> {
    position.map(|position| position.configuration.clone()).unwrap_or_default()
}

/// Describes the labels of a run on its axes: `Where = cloud, Model = S, repeat 2`. `repeat` counts from 0; `None`
/// leaves out the repeat.
pub fn describe_labels(labels: &[(String, String)], repeat: Option<u32>) -> String {
    let pairs = labels.iter().map(|(axis, label)| format!("{axis} = {label}"));
    let repeat = repeat.map(|repeat| format!("repeat {}", u64::from(repeat) + 1));
    pairs.chain(repeat).collect::<Vec<_>>().join(", ")
}

/// Returns whether at least two labels differ.
pub(super) fn differ(labels: &[String]) -> bool {
    labels.windows(2).any(|pair| pair[0] != pair[1])
}

/// Returns a label for the experiment of each run: the name of the experiment. If all names are the same, the label is
/// the short id of the execution of the experiment instead.
pub(super) fn executions(positions: &[Option<&ExperimentPosition>]) -> Vec<String> {
    let names: Vec<String> = positions
        .iter()
        .map(|position| position.map_or(EMPTY_CELL, |position| &position.name).to_owned())
        .collect();
    if differ(&names) {
        return names;
    }
    let short_id = |position: &ExperimentPosition| position.id.chars().take(8).collect::<String>();
    positions.iter().map(|position| position.map_or_else(|| EMPTY_CELL.to_owned(), short_id)).collect()
}

impl RunFacts<'_> {
    /// Returns the facts as pairs of name and label; the label of an unknown fact is empty. The
    /// columns of the paper's table come first.
    fn pairs(&self) -> Vec<(String, String)> {
        let pair = |axis: &str, label: Option<&str>| (axis.to_owned(), label.unwrap_or_default().to_owned());
        let mut pairs = vec![
            pair("model", self.model),
            pair("device", self.device),
            pair("where", Some(place_word(self.placement))),
            pair("network", self.network),
            pair("edge", Some(self.edge)),
            pair("cloud", self.cloud),
        ];
        let is_implied = |fact: &str| IMPLIED_FACTS.iter().any(|name| name.eq_ignore_ascii_case(fact));
        pairs.extend(self.facts.iter().filter(|(fact, _)| !is_implied(fact)).cloned());
        pairs.push(pair("pipeline", self.pipeline));
        pairs
    }
}

/// Makes columns of the pairs of name and label of each run. The columns are in the order in which their names first
/// appear. Names that differ only in case are the same column, such as the field `Model` of an experiment and the
/// `model` of a run outside of experiments. Missing and empty labels become `—`.
pub fn tabulate(pairs: &[Vec<(String, String)>]) -> Vec<Column> {
    let mut axes: Vec<&String> = Vec::new();
    for (axis, _) in pairs.iter().flatten() {
        if !axes.iter().any(|other| other.eq_ignore_ascii_case(axis)) {
            axes.push(axis);
        }
    }
    let label = |pairs: &Vec<(String, String)>, axis: &String| {
        let label =
            pairs.iter().find(|(name, _)| name.eq_ignore_ascii_case(axis)).map(|(_, label)| label.clone());
        label.filter(|label| !label.is_empty()).unwrap_or_else(|| EMPTY_CELL.to_owned())
    };
    let column = |axis: &String| Column {
        axis: axis.clone(),
        labels: pairs.iter().map(|pairs| label(pairs, axis)).collect(),
    };
    axes.into_iter().map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_name_is_added_to_unclear_labels_only() {
        let name = |axes: &[&str], labels: &[&str]| {
            let owned = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
            readable_name(&owned(axes), &owned(labels))
        };
        assert_eq!([name(&["resize"], &["no"]), name(&["resize"], &["yes"])], ["no resize", "resize"]);
        assert_eq!(name(&["edges", "where", "network"], &["4", "—", "LAN"]), "edges 4, LAN");
    }

    #[test]
    fn names_have_labels_of_differing_columns_only() {
        let names = |axes: &[&str], rows: &[&[&str]]| {
            let owned = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
            let rows: Vec<Vec<String>> = rows.iter().map(|row| owned(row)).collect();
            readable_names(&owned(axes), rows.iter().map(Vec::as_slice))
        };
        let axes = ["where", "resize", "edges"];
        assert_eq!(names(&axes, &[&["cloud", "yes", "1"], &["cloud", "no", "1"]]), ["resize", "no resize"]);
        assert_eq!(names(&axes, &[&["cloud", "yes", "1"]]), ["cloud, resize, edges 1"], "nothing differs");
        assert_eq!(names(&["sync"], &[&["no"], &["none"], &["yes"]]), ["sync no", "sync none", "sync"]);
    }
}
