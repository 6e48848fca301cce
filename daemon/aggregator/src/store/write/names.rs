//! Names of nodes as small numbers.

use std::collections::HashMap;

use peernet_logger::{Measure, Name};
use sqlx::SqliteConnection;

use super::Refusal;

/// Distinct names the store takes in; beyond, batches that bring new ones are put aside. A program that puts
/// numbers into its names would otherwise fill memory and table.
const MOST: usize = 65_536;

/// The table `name` in memory.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// By text; a text rarely has more than one kind.
    known: HashMap<Name, Vec<Entry>>,
    count: usize,
}

#[derive(Debug)]
struct Entry {
    id: i64,
    kind: Name,
    custom: bool,
    unit: Name,
}

impl Names {
    /// Reads the table.
    pub(super) async fn load(connection: &mut SqliteConnection) -> Result<Self, sqlx::Error> {
        let rows: Vec<(i64, String, String, bool, String)> =
            sqlx::query_as("SELECT id, text, kind, custom, unit FROM name").fetch_all(connection).await?;
        let mut names = Self::default();
        for (id, text, kind, custom, unit) in rows {
            names.remember(text.into(), Entry { id, kind: kind.into(), custom, unit: unit.into() });
        }
        Ok(names)
    }

    /// The number of a name of the given measure's kind and unit.
    pub(super) async fn id(
        &mut self,
        connection: &mut SqliteConnection,
        name: &Name,
        measure: &Measure,
    ) -> Result<i64, Refusal> {
        let unit = measure.unit();
        let custom = matches!(measure, Measure::Custom(..));
        let kind = measure.kind();
        let known = self.known.get(name).into_iter().flatten();
        for entry in known {
            if entry.kind == kind && entry.custom == custom && entry.unit == unit.symbol() {
                return Ok(entry.id);
            }
        }
        if self.count >= MOST {
            return Err(Refusal::Batch(format!(
                "the store knows {MOST} names already, {name:?} is one too many; put numbers into values, not names"
            )));
        }
        let id = sqlx::query_scalar(
            "INSERT INTO name (text, kind, custom, unit) VALUES (?, ?, ?, ?) RETURNING id",
        )
        .bind(name.as_str())
        .bind(kind.as_str())
        .bind(custom)
        .bind(unit.symbol())
        .fetch_one(connection)
        .await?;
        self.remember(name.clone(), Entry { id, kind, custom, unit: unit.symbol().into() });
        Ok(id)
    }

    fn remember(&mut self, name: Name, entry: Entry) {
        self.known.entry(name).or_default().push(entry);
        self.count += 1;
    }
}
