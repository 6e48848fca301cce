//! Choice of the differing facts that become columns, and sentences about the other differing facts.

use super::labels::{EMPTY_CELL, differ, readable_name};

/// Maximum number of values that a sentence lists for a fact without a column. Also the maximum number of
/// configurations that the sentence lists for a value.
const MAX_LISTED: usize = 4;
/// A word of at least this many characters, all of them hexadecimal digits, counts as a hash.
const MIN_HASH_DIGITS: usize = 32;
/// A label of at least this many bytes, for example a list of libraries, is too long for a table.
const MIN_LIST_BYTES: usize = 120;

/// Column of a table: a fact, such as the network, and its label for each configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name of the fact.
    pub axis: String,
    /// Label of each configuration.
    pub labels: Vec<String>,
}

/// Candidates for columns, divided into those that were chosen and the rest.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChosenColumns {
    /// Columns that distinguish the configurations.
    pub columns: Vec<Column>,
    /// Candidates that were not chosen.
    pub rest: Vec<Column>,
}

/// Chooses a column in two cases: if it distinguishes configurations that the columns chosen before do not distinguish,
/// or if it has a label for a configuration that has no label in the other chosen columns. Columns of hashes, paths or
/// long lists are never chosen: if no other column distinguishes the runs, the names of their folders, which people
/// gave, are easier to read.
pub fn choose_columns(candidates: Vec<Column>) -> ChosenColumns {
    choose_further_columns(Vec::new(), candidates)
}

/// Chooses columns as [`choose_columns`] does, after columns that are chosen already.
pub fn choose_further_columns(already_chosen: Vec<Column>, candidates: Vec<Column>) -> ChosenColumns {
    let Some(configurations) = candidates.first().map(|column| column.labels.len()) else {
        return ChosenColumns { columns: already_chosen, rest: Vec::new() };
    };
    let mut is_chosen = vec![false; candidates.len()];
    let chosen_columns = |is_chosen: &[bool]| -> Vec<Column> {
        let newly_chosen = candidates.iter().zip(is_chosen).filter(|(_, is_chosen)| **is_chosen);
        already_chosen.iter().chain(newly_chosen.map(|(column, _)| column)).cloned().collect()
    };
    for index in 0..candidates.len() {
        // The column is chosen for a trial. It stays chosen if the columns have more different rows with it than
        // without it.
        let distinct_rows_without_column = distinct_rows(&chosen_columns(&is_chosen), configurations);
        is_chosen[index] = !candidates[index].is_opaque();
        is_chosen[index] = is_chosen[index]
            && distinct_rows(&chosen_columns(&is_chosen), configurations) > distinct_rows_without_column;
    }
    for configuration in 0..configurations {
        let has_label = |column: &Column| column.labels[configuration] != EMPTY_CELL;
        if !chosen_columns(&is_chosen).iter().any(has_label) {
            let first = candidates.iter().position(|column| !column.is_opaque() && has_label(column));
            first.into_iter().for_each(|index| is_chosen[index] = true);
        }
    }
    let columns = chosen_columns(&is_chosen);
    let rest = candidates
        .into_iter()
        .zip(is_chosen)
        .filter(|(_, is_chosen)| !is_chosen)
        .map(|(column, _)| column)
        .collect();
    ChosenColumns { columns, rest }
}

/// Returns whether some of the labels of one column are hashes or paths, which mean nothing to people, or lists that
/// are too long for a table.
fn is_opaque<'a>(mut labels: impl Iterator<Item = &'a str>) -> bool {
    let is_hash =
        |word: &str| word.len() >= MIN_HASH_DIGITS && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    labels.any(|label| {
        label.len() >= MIN_LIST_BYTES || label.split(' ').any(|word| word.starts_with('/') || is_hash(word))
    })
}

/// Returns whether no two configurations have the same labels in these columns.
pub(super) fn distinguish_all_configurations(columns: &[Column], configurations: usize) -> bool {
    distinct_rows(columns, configurations) == configurations
}

/// Returns the number of different rows of labels.
fn distinct_rows(columns: &[Column], configurations: usize) -> usize {
    let row = |configuration: usize| {
        columns.iter().map(|column| column.labels[configuration].as_str()).collect::<Vec<_>>()
    };
    let mut rows: Vec<Vec<&str>> = (0..configurations).map(row).collect();
    rows.sort_unstable();
    rows.dedup();
    rows.len()
}

/// Returns the name of a configuration from its labels in these columns; empty without a label.
fn configuration_name(columns: &[Column], index: usize) -> String {
    let pair = |column: &Column| (column.axis.clone(), column.labels[index].clone());
    let (axes, labels): (Vec<String>, Vec<String>) = columns.iter().map(pair).unzip();
    readable_name(&axes, &labels)
}

/// Returns sentences about the facts that differ but have no column.
pub(super) fn sentences(columns: &[Column], rest: &[Column]) -> Vec<String> {
    // Texts of the facts whose values are listed, and names of the facts whose values are not listed.
    let (mut value_texts, mut names): (Vec<String>, Vec<&str>) = (Vec::new(), Vec::new());
    for column in rest {
        match column.values_with_configurations(columns) {
            Some(text) if !column.is_opaque() => value_texts.push(text),
            _ => names.push(&column.axis),
        }
    }
    let mut sentences = Vec::new();
    if !value_texts.is_empty() {
        sentences.push(format!("The runs also differ in {}.", value_texts.join("; ")));
    }
    if !names.is_empty() {
        sentences.push(format!(
            "Further differences, recorded in the run.json of each run: {}.",
            names.join(", ")
        ));
    }
    sentences
}

impl Column {
    /// Returns whether at least two labels differ.
    pub fn differs(&self) -> bool {
        differ(&self.labels)
    }

    /// Returns whether some of the labels are hashes, paths or long lists.
    pub fn is_opaque(&self) -> bool {
        is_opaque(self.labels.iter().map(String::as_str))
    }

    /// Returns a text that lists each label and, after the label, the names of the configurations that have it. The
    /// labels in `columns` give these names. `None` if the text would be long.
    fn values_with_configurations(&self, columns: &[Column]) -> Option<String> {
        // Each value with the names of the configurations that have it.
        let mut values: Vec<(&str, Vec<String>)> = Vec::new();
        // The configurations are named by a single column if it determines the labels of this column, otherwise by all
        // columns.
        let naming_column = columns.iter().find(|column| column.determines(self));
        for (index, label) in self.labels.iter().enumerate().filter(|(_, label)| *label != EMPTY_CELL) {
            let name = match naming_column {
                Some(column) => configuration_name(std::slice::from_ref(column), index),
                None => configuration_name(columns, index),
            };
            let name = if name.is_empty() { self.name_without_label(columns, index) } else { name };
            match values.iter_mut().find(|(value, _)| value == label) {
                Some((_, names)) if names.contains(&name) => {}
                Some((_, names)) => names.push(name),
                None => values.push((label, vec![name])),
            }
        }
        (values.len() <= MAX_LISTED && values.iter().all(|(_, names)| names.len() <= MAX_LISTED)).then(|| {
            let texts = values.iter().map(|(value, names)| format!("{value} ({})", names.join("; ")));
            format!("{}: {}", self.axis, texts.collect::<Vec<_>>().join(", "))
        })
    }

    /// Returns the name of a configuration for which the naming column has no label. If no other configuration lacks
    /// this label, the name consists of the configuration's labels in all columns, else it is `the others`.
    fn name_without_label(&self, columns: &[Self], index: usize) -> String {
        let naming_column = columns.iter().find(|column| column.determines(self));
        let is_only_unlabelled = naming_column
            .is_some_and(|column| column.labels.iter().filter(|label| *label == EMPTY_CELL).count() == 1);
        let name = configuration_name(columns, index);
        if is_only_unlabelled && !name.is_empty() { name } else { "the others".to_owned() }
    }

    /// Returns whether the labels of this column determine the labels of another column: equal labels here mean equal
    /// labels there.
    fn determines(&self, other: &Self) -> bool {
        let pairs = || self.labels.iter().zip(&other.labels);
        pairs().all(|(own_a, other_a)| pairs().all(|(own_b, other_b)| own_a != own_b || other_a == other_b))
    }
}
