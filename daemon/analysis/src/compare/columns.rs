//! Choice of the facts that become columns among those that differ among runs, and sentences about the rest.

use super::configuration::NOTHING;

/// Maximum number of values that are listed of a fact that has no column.
const MOST_LISTED: usize = 4;
/// Number of hexadecimal digits from which on a label counts as a hash.
const HASH: usize = 32;
/// Bytes from which on a label has no place in a table: it is a list, of libraries for instance.
const LONG: usize = 120;

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
    let mut taken = vec![false; all.len()];
    let chosen = |taken: &[bool]| -> Vec<Column> {
        all.iter().zip(taken).filter(|(_, taken)| **taken).map(|(column, _)| column.clone()).collect()
    };
    for at in 0..all.len() {
        let before = classes(&chosen(&taken), configurations);
        taken[at] = !all[at].is_opaque();
        taken[at] = taken[at] && classes(&chosen(&taken), configurations) > before;
    }
    for configuration in 0..configurations {
        let names = |column: &Column| column.labels[configuration] != NOTHING;
        if !chosen(&taken).iter().any(names) {
            let first = all.iter().position(|column| !column.is_opaque() && names(column));
            first.into_iter().for_each(|at| taken[at] = true);
        }
    }
    let columns = chosen(&taken);
    let rest = all.into_iter().zip(taken).filter(|(_, taken)| !taken).map(|(column, _)| column).collect();
    ChosenColumns { columns, rest }
}

/// Returns whether some of the labels of one column are hashes or paths, which mean nothing to people, or lists that are too long for a
/// table.
fn is_opaque<'a>(mut labels: impl Iterator<Item = &'a str>) -> bool {
    let is_hash = |word: &str| word.len() >= HASH && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    labels.any(|label| {
        label.len() >= LONG || label.split(' ').any(|word| word.starts_with('/') || is_hash(word))
    })
}

/// Returns whether no two configurations have the same labels.
pub(super) fn tell_apart(columns: &[Column], configurations: usize) -> bool {
    classes(columns, configurations) == configurations
}

/// Returns the number of different rows of labels.
fn classes(columns: &[Column], configurations: usize) -> usize {
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
        match column.told(columns) {
            Some(text) if !column.is_opaque() => told.push(text),
            _ => named.push(&column.axis),
        }
    }
    let mut sentences = Vec::new();
    if !told.is_empty() {
        sentences.push(format!("Besides, they differ in {}.", told.join("; ")));
    }
    if !named.is_empty() {
        sentences.push(format!("Their run.json tells what else differs: {}.", named.join(", ")));
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

    /// Returns each of its labels, followed by the configurations that have it; `None` when that would be long.
    fn told(&self, columns: &[Column]) -> Option<String> {
        let mut values: Vec<(&str, Vec<String>)> = Vec::new();
        // The configurations are named by one column that determines this one, or by all columns.
        let by = columns.iter().find(|column| column.decides(self));
        for (at, label) in self.labels.iter().enumerate().filter(|(_, label)| *label != NOTHING) {
            let who = match by {
                Some(column) => column.labels[at].clone(),
                None => {
                    let labels = columns.iter().map(|column| column.labels[at].as_str());
                    labels.filter(|label| *label != NOTHING).collect::<Vec<_>>().join(", ")
                }
            };
            let who = if who == NOTHING { "the others".to_owned() } else { who };
            match values.iter_mut().find(|(value, _)| value == label) {
                Some((_, all)) if all.contains(&who) => {}
                Some((_, all)) => all.push(who),
                None => values.push((label, vec![who])),
            }
        }
        (values.len() <= MOST_LISTED && values.iter().all(|(_, who)| who.len() <= MOST_LISTED)).then(|| {
            let told = values.iter().map(|(value, who)| format!("{value} ({})", who.join("; ")));
            format!("{}: {}", self.axis, told.collect::<Vec<_>>().join(", "))
        })
    }

    /// Returns whether another column's labels follow from this one's.
    fn decides(&self, other: &Self) -> bool {
        let pairs = || self.labels.iter().zip(&other.labels);
        pairs().all(|(label, of)| pairs().all(|(same, other)| same != label || other == of))
    }
}
