//! Choice of the differing facts that become columns, and sentences about the other differing facts.

use super::configuration::EMPTY_CELL;

/// Maximum number of listed values of a fact without a column.
const MAX_LISTED: usize = 4;
/// Minimum number of hexadecimal digits of a label that counts as a hash.
const MIN_HASH_DIGITS: usize = 32;
/// Minimum size of a label that is too long for a table, such as a list of libraries, bytes.
const MIN_LIST_BYTES: usize = 120;

/// Something that differs: its name and the label of each configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name of the fact.
    pub axis: String,
    /// Label of each configuration.
    pub labels: Vec<String>,
}

/// Columns that distinguish configurations.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ChosenColumns {
    /// Columns that distinguish the configurations.
    pub columns: Vec<Column>,
    /// Columns that differ and were not chosen.
    pub rest: Vec<Column>,
}

/// Chooses a column if it distinguishes configurations that the columns before it do not, or names some that they have no label for.
/// Columns of hashes or paths are never chosen, because the names of folders, which people gave, are easier to read.
pub fn choose_columns(all: Vec<Column>) -> ChosenColumns {
    let Some(configurations) = all.first().map(|column| column.labels.len()) else {
        return ChosenColumns { columns: all, rest: Vec::new() };
    };
    let mut is_chosen = vec![false; all.len()];
    let chosen = |is_chosen: &[bool]| -> Vec<Column> {
        all.iter()
            .zip(is_chosen)
            .filter(|(_, is_chosen)| **is_chosen)
            .map(|(column, _)| column.clone())
            .collect()
    };
    for at in 0..all.len() {
        let before = distinct_rows(&chosen(&is_chosen), configurations);
        is_chosen[at] = !all[at].is_opaque();
        is_chosen[at] = is_chosen[at] && distinct_rows(&chosen(&is_chosen), configurations) > before;
    }
    for configuration in 0..configurations {
        let names = |column: &Column| column.labels[configuration] != EMPTY_CELL;
        if !chosen(&is_chosen).iter().any(names) {
            let first = all.iter().position(|column| !column.is_opaque() && names(column));
            first.into_iter().for_each(|at| is_chosen[at] = true);
        }
    }
    let columns = chosen(&is_chosen);
    let rest = all
        .into_iter()
        .zip(is_chosen)
        .filter(|(_, is_chosen)| !is_chosen)
        .map(|(column, _)| column)
        .collect();
    ChosenColumns { columns, rest }
}

/// Returns whether some of the labels of one column are hashes or paths, which mean nothing to people, or lists that are too long for a
/// table.
fn is_opaque<'a>(mut labels: impl Iterator<Item = &'a str>) -> bool {
    let is_hash =
        |word: &str| word.len() >= MIN_HASH_DIGITS && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    labels.any(|label| {
        label.len() >= MIN_LIST_BYTES || label.split(' ').any(|word| word.starts_with('/') || is_hash(word))
    })
}

/// Returns whether no two configurations have the same labels.
pub(super) fn are_distinct(columns: &[Column], configurations: usize) -> bool {
    distinct_rows(columns, configurations) == configurations
}

/// Returns the number of different rows of labels.
fn distinct_rows(columns: &[Column], configurations: usize) -> usize {
    let row = |at: usize| columns.iter().map(|column| column.labels[at].as_str()).collect::<Vec<_>>();
    let mut rows: Vec<Vec<&str>> = (0..configurations).map(row).collect();
    rows.sort_unstable();
    rows.dedup();
    rows.len()
}

/// Returns sentences about the facts that differ but have no column.
pub(super) fn sentences(columns: &[Column], rest: &[Column]) -> Vec<String> {
    let (mut told, mut named): (Vec<String>, Vec<&str>) = (Vec::new(), Vec::new());
    for column in rest {
        match column.values_with_configurations(columns) {
            Some(text) if !column.is_opaque() => told.push(text),
            _ => named.push(&column.axis),
        }
    }
    let mut sentences = Vec::new();
    if !told.is_empty() {
        sentences.push(format!("They also differ in {}.", told.join("; ")));
    }
    if !named.is_empty() {
        sentences.push(format!("Further differences, recorded in their run.json: {}.", named.join(", ")));
    }
    sentences
}

impl Column {
    /// Returns whether not all labels are the same.
    pub fn differs(&self) -> bool {
        self.labels.windows(2).any(|pair| pair[0] != pair[1])
    }

    /// Returns whether the labels are hashes, paths or lists.
    pub fn is_opaque(&self) -> bool {
        is_opaque(self.labels.iter().map(String::as_str))
    }

    /// Returns each label, followed by the configurations that have it; `None` if the text would be long.
    fn values_with_configurations(&self, columns: &[Column]) -> Option<String> {
        let mut values: Vec<(&str, Vec<String>)> = Vec::new();
        // The configurations are named by a single column if it determines the labels of this column, otherwise by all columns.
        let by = columns.iter().find(|column| column.determines(self));
        for (at, label) in self.labels.iter().enumerate().filter(|(_, label)| *label != EMPTY_CELL) {
            let who = match by {
                Some(column) => column.labels[at].clone(),
                None => {
                    let labels = columns.iter().map(|column| column.labels[at].as_str());
                    labels.filter(|label| *label != EMPTY_CELL).collect::<Vec<_>>().join(", ")
                }
            };
            let who = if who == EMPTY_CELL { "the others".to_owned() } else { who };
            match values.iter_mut().find(|(value, _)| value == label) {
                Some((_, all)) if all.contains(&who) => {}
                Some((_, all)) => all.push(who),
                None => values.push((label, vec![who])),
            }
        }
        (values.len() <= MAX_LISTED && values.iter().all(|(_, who)| who.len() <= MAX_LISTED)).then(|| {
            let told = values.iter().map(|(value, who)| format!("{value} ({})", who.join("; ")));
            format!("{}: {}", self.axis, told.collect::<Vec<_>>().join(", "))
        })
    }

    /// Returns whether this column's labels determine the labels of another column.
    fn determines(&self, other: &Self) -> bool {
        let pairs = || self.labels.iter().zip(&other.labels);
        pairs().all(|(label, of)| pairs().all(|(same, other)| same != label || other == of))
    }
}
