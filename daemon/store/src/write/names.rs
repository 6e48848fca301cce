//! Ids of node names. One id stands for a name together with its kind and unit.

use std::collections::HashMap;

use peernet_logger::Name;
use sqlx::SqliteConnection;

use super::Refusal;
use super::prepared::NameKey;

/// Maximum number of distinct names in the store. When it is reached, batches with new names are quarantined. Without a
/// maximum, a program that puts numbers into names would fill the memory and the table.
const MAX_NAMES: usize = 65_536;

/// The writer's copy of the table `name`.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// Entries by name. A name rarely has more than one kind.
    entries: HashMap<Name, Vec<Entry>>,
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
    /// Reads the table `name`.
    pub(super) async fn load(connection: &mut SqliteConnection) -> Result<Self, sqlx::Error> {
        let rows: Vec<(i64, String, String, bool, String)> =
            sqlx::query_as("SELECT id, text, kind, custom, unit FROM name").fetch_all(connection).await?;
        let mut names = Self::default();
        for (id, text, kind, custom, unit) in rows {
            names.remember(text.into(), Entry { id, kind: kind.into(), custom, unit: unit.into() });
        }
        Ok(names)
    }

    /// Returns the id of a name with its kind and unit, and stores the name if it is new.
    pub(super) async fn id(
        &mut self,
        connection: &mut SqliteConnection,
        key: &NameKey,
    ) -> Result<i64, Refusal> {
        let entries = self.entries.get(&key.text).into_iter().flatten();
        for entry in entries {
            if entry.kind == key.kind && entry.custom == key.custom && entry.unit == key.unit.symbol() {
                return Ok(entry.id);
            }
        }
        let NameKey { text, kind, custom, unit } = key;
        if self.count >= MAX_NAMES {
            return Err(Refusal::Batch(format!(
                "the database has {MAX_NAMES} node names, the maximum, and cannot add {text:?}; put numbers into values, not into names"
            )));
        }
        let id = sqlx::query_scalar(
            "INSERT INTO name (text, kind, custom, unit) VALUES (?, ?, ?, ?) RETURNING id",
        )
        .bind(text.as_str())
        .bind(kind.as_str())
        .bind(*custom)
        .bind(unit.symbol())
        .fetch_one(connection)
        .await?;
        let entry = Entry { id, kind: kind.clone(), custom: *custom, unit: unit.symbol().into() };
        self.remember(text.clone(), entry);
        Ok(id)
    }

    /// Adds a stored name.
    fn remember(&mut self, name: Name, entry: Entry) {
        self.entries.entry(name).or_default().push(entry);
        self.count += 1;
    }
}
