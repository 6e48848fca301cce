//! Tables of configuration files that were renamed. The former name of a table is read for one release.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use toml::Table;

use crate::output::print_to_stderr;

/// A table of a configuration file that was renamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenamedTable {
    /// Name in earlier versions.
    pub former: &'static str,
    /// Name in this version.
    pub current: &'static str,
    /// Version that no longer reads the former name.
    removed_in: &'static str,
}

/// The renamed tables whose former names are still read.
pub const RENAMED_TABLES: [RenamedTable; 1] =
    [RenamedTable { former: "rehearsal", current: "clock_fault", removed_in: "0.4.0" }];

/// A document that contains the same table twice: under its former name and under its present name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{former}: the file also has this table under its present name, [{current}]: remove [{former}]", former = .0.former, current = .0.current)]
pub struct BothNames(RenamedTable);

impl RenamedTable {
    /// Returns the text of the deprecation, in one line.
    #[must_use]
    pub fn deprecation(&self) -> String {
        let Self { former, current, removed_in } = self;
        format!(
            "the table [{former}] is now called [{current}]: rename it; version {removed_in} will not read the former name"
        )
    }

    /// Records that this process has read the former name. Returns whether it was the first time.
    fn record_use(&self) -> bool {
        static USED_FORMER_NAMES: Mutex<BTreeSet<&str>> = Mutex::new(BTreeSet::new());
        USED_FORMER_NAMES.lock().unwrap_or_else(PoisonError::into_inner).insert(self.former)
    }
}

/// Replaces the former name of a table by its present name. Other names stay. Prints a deprecation
/// line when this process reads the former name of the table for the first time.
pub(crate) fn replace_former_name(table: &str) -> &str {
    let Some(renamed) = RENAMED_TABLES.iter().find(|renamed| renamed.former == table) else { return table };
    if renamed.record_use() {
        print_to_stderr(format_args!("deprecated: {}", renamed.deprecation()));
    }
    renamed.current
}

/// Gives the tables of a document their present names.
///
/// # Errors
/// If the document contains a table under both names.
pub(crate) fn rename_tables(document: &mut Table) -> Result<(), BothNames> {
    for renamed in RENAMED_TABLES {
        let Some(table) = document.remove(renamed.former) else { continue };
        if document.contains_key(renamed.current) {
            return Err(BothNames(renamed));
        }
        document.insert(replace_former_name(renamed.former).to_owned(), table);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn former_table_is_read_under_its_present_name() {
        let mut document: Table = "[rehearsal]\noffset_ms = 5\n[clock]\n".parse().expect("toml");
        assert_eq!(rename_tables(&mut document), Ok(()));
        assert_eq!(document.keys().collect::<Vec<_>>(), ["clock", "clock_fault"]);
        let names = ["rehearsal", "clock"].map(replace_former_name);
        assert_eq!(names, ["clock_fault", "clock"]);
    }

    #[test]
    fn document_with_former_and_present_name_is_refused() {
        let mut both: Table = "[rehearsal]\n[clock_fault]\n".parse().expect("toml");
        let error = rename_tables(&mut both).expect_err("the document contains the table twice");
        assert!(error.to_string().starts_with("rehearsal: the file also has this table"), "{error}");
    }

    #[test]
    fn each_former_name_is_new_once() {
        let [first, second] =
            ["first", "second"].map(|former| RenamedTable { former, current: "table", removed_in: "9.0.0" });
        assert_eq!([&first, &second, &first].map(RenamedTable::record_use), [true, true, false]);
    }
}
