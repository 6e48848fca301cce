//! Decoding of records to values of a table's columns, and copying of the rows to the new database.

use sqlx::error::BoxDynError;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, AssertSqlSafe, SqliteConnection};

use super::tree::{Item, Walk};
use crate::integrity::pages::{PageFile, column_bytes, varint};

/// Maximum number of values in one statement; SQLite's limit is 32,766.
const MAX_VALUES: usize = 16_384;

/// Number of newest rows whose writing is delayed, because later rows may show that the newest rows were overwritten.
const DELAYED_ROWS: usize = 8;

/// One value, in SQLite's order of types.
#[derive(Clone, Debug, PartialEq, PartialOrd)]
pub(super) enum Value {
    Null,
    Integer(i64),
    Real(f64),
    Text(String),
    Blob(Vec<u8>),
}

/// A table that is filled with the contents of an old file.
#[derive(Debug)]
pub(super) struct Table {
    pub(super) name: String,
    columns: Vec<Column>,
    /// Indexes of the columns in the order in which a record has them.
    record_columns: Vec<usize>,
    /// Number of columns at the start of `record_columns` that are the key of a clustered table (`WITHOUT ROWID`); 0 for
    /// a table with row ids.
    key_columns: usize,
    /// Index of the column that is the row id.
    rowid: Option<usize>,
    pub(super) has_rowids: bool,
    /// `true` if the migrations have inserted rows into the table.
    is_seeded: bool,
}

#[derive(Debug)]
struct Column {
    name: String,
    kind: String,
    not_null: bool,
    /// Value for rows that are older than the column.
    default: Value,
}

/// A row in the order of the table's columns.
#[derive(Debug)]
struct Row {
    rowid: Option<i64>,
    values: Vec<Value>,
}

/// A range of rows that could not be read, between two readable rows.
///
/// `before` and `after` are the first three columns of the keys of these two rows. They are `None` at the start and the
/// end of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UnreadableRange {
    pub(super) before: Option<[i64; 3]>,
    pub(super) after: Option<[i64; 3]>,
}

/// Result of copying a table.
#[derive(Debug, Default)]
pub(super) struct CopiedTable {
    pub(super) unreadable_ranges: Vec<UnreadableRange>,
}

#[derive(sqlx::FromRow)]
struct ColumnDescription {
    name: String,
    r#type: String,
    notnull: bool,
    dflt_value: Option<String>,
    pk: i64,
}

impl Table {
    /// Reads the description of a table of the new database.
    pub(super) async fn describe(
        connection: &mut SqliteConnection,
        name: String,
    ) -> Result<Self, sqlx::Error> {
        let clustered: bool =
            sqlx::query_scalar("SELECT wr FROM pragma_table_list(?1) WHERE schema = 'main'")
                .bind(&name)
                .fetch_one(&mut *connection)
                .await?;
        let described: Vec<ColumnDescription> = sqlx::query_as(
            "SELECT name, type, \"notnull\", dflt_value, pk FROM pragma_table_info(?1) ORDER BY cid",
        )
        .bind(&name)
        .fetch_all(&mut *connection)
        .await?;
        let mut keys: Vec<usize> = (0..described.len()).filter(|index| described[*index].pk > 0).collect();
        keys.sort_by_key(|index| described[*index].pk);
        let rowid = match keys.as_slice() {
            [key] if !clustered && described[*key].r#type.eq_ignore_ascii_case("INTEGER") => Some(*key),
            _ => None,
        };
        let key_columns = if clustered { keys.len() } else { 0 };
        // A clustered table's records begin with its key.
        let mut record_columns = if clustered { keys } else { Vec::new() };
        let other_columns: Vec<usize> =
            (0..described.len()).filter(|index| !record_columns.contains(index)).collect();
        record_columns.extend(other_columns);
        let mut columns = Vec::with_capacity(described.len());
        for column in described {
            let default = match &column.dflt_value {
                Some(text) => default_value(connection, text).await?,
                None => Value::Null,
            };
            // The key of a clustered table is never NULL.
            let not_null = column.notnull || (clustered && column.pk > 0);
            columns.push(Column { name: column.name, kind: column.r#type, not_null, default });
        }
        let statement = AssertSqlSafe(format!("SELECT EXISTS (SELECT 1 FROM \"{name}\")"));
        let is_seeded = sqlx::query_scalar(statement).fetch_one(connection).await?;
        Ok(Self { name, columns, record_columns, key_columns, rowid, has_rowids: !clustered, is_seeded })
    }

    /// Copies all readable rows from the tree with this root. If the root is unknown (`None`), all rows count as
    /// unreadable.
    pub(super) async fn copy(
        &self,
        connection: &mut SqliteConnection,
        file: &PageFile,
        root: Option<u32>,
    ) -> Result<CopiedTable, sqlx::Error> {
        let mut copied = CopiedTable::default();
        let Some(root) = root else {
            copied.unreadable_ranges.push(UnreadableRange { before: None, after: None });
            return Ok(copied);
        };
        let max_rows = MAX_VALUES / self.columns.len() - DELAYED_ROWS;
        let mut rows: Vec<Row> = Vec::new();
        let mut last_written = None;
        // `true` if the previous row was unreadable.
        let mut is_in_range = false;
        for item in Walk::start(file, root, self.has_rowids) {
            let row = match item {
                Item::Row(rowid, record) => self.decode(&record, rowid),
                Item::Unreadable => None,
            };
            let last = rows.last().or(last_written.as_ref());
            let is_ordered = row.as_ref().zip(last).is_none_or(|(row, last)| self.precedes(last, row));
            if !is_ordered {
                // The keys of a tree ascend, so one of the two rows was overwritten. It is unknown which row that is, so
                // neither row is copied.
                rows.pop();
            }
            let before = rows.last().or(last_written.as_ref()).map(|row| self.key(row));
            let Some(row) = row.filter(|_| is_ordered) else {
                match copied.unreadable_ranges.last_mut().filter(|_| is_in_range) {
                    // Adjacent unreadable rows and pages are one range. A row that was removed above moves the start of
                    // the range back.
                    Some(range) => range.before = before,
                    None => copied.unreadable_ranges.push(UnreadableRange { before, after: None }),
                }
                is_in_range = true;
                continue;
            };
            if std::mem::take(&mut is_in_range)
                && let Some(range) = copied.unreadable_ranges.last_mut()
            {
                range.after = Some(self.key(&row));
            }
            rows.push(row);
            if rows.len() == max_rows + DELAYED_ROWS {
                self.insert(connection, &rows[..max_rows]).await?;
                last_written = rows.drain(..max_rows).next_back();
            }
        }
        self.insert(connection, &rows).await?;
        Ok(copied)
    }

    async fn insert(&self, connection: &mut SqliteConnection, rows: &[Row]) -> Result<(), sqlx::Error> {
        if rows.is_empty() {
            return Ok(());
        }
        let names: Vec<String> = self.columns.iter().map(|column| format!("\"{}\"", column.name)).collect();
        let placeholders = format!("({})", vec!["?"; self.columns.len()].join(","));
        // A row that is found twice is inserted once. Rows that the migrations inserted are replaced.
        let on_conflict = if self.is_seeded { "REPLACE" } else { "IGNORE" };
        let statement = format!(
            "INSERT OR {on_conflict} INTO \"{}\" ({}) VALUES {}",
            self.name,
            names.join(","),
            vec![placeholders.as_str(); rows.len()].join(",")
        );
        let mut arguments = SqliteArguments::default();
        rows.iter()
            .flat_map(|row| &row.values)
            .try_for_each(|value| value.bind(&mut arguments))
            .map_err(sqlx::Error::Encode)?;
        sqlx::query_with(AssertSqlSafe(statement), arguments).execute(connection).await?;
        Ok(())
    }

    /// Decodes a record; `None` if the record is malformed, or a value does not have the type of its column.
    fn decode(&self, record: &[u8], rowid: Option<i64>) -> Option<Row> {
        let mut row: Vec<Value> = self.columns.iter().map(|column| column.default.clone()).collect();
        let values = decode_values(record)?;
        // A record with fewer values is valid: the row was written before a migration added columns.
        if values.len() > self.record_columns.len() {
            return None;
        }
        for (index, value) in self.record_columns.iter().zip(values) {
            row[*index] = value;
        }
        if let Some(index) = self.rowid {
            // SQLite stores NULL in the record for a column that is the row id.
            row[index] = Value::Integer(rowid?);
        }
        for (column, value) in self.columns.iter().zip(&mut row) {
            column.accept(value)?;
        }
        Some(Row { rowid, values: row })
    }

    /// Returns whether the row `first` comes before the row `second` in the table's tree.
    fn precedes(&self, first: &Row, second: &Row) -> bool {
        if self.has_rowids {
            return first.rowid < second.rowid;
        }
        let keys = &self.record_columns[..self.key_columns];
        keys.iter().map(|index| &first.values[*index]).lt(keys.iter().map(|index| &second.values[*index]))
    }

    /// Returns the first three columns of a row's record, with 0 for a column that is missing or no integer. The record
    /// of a clustered table begins with its key.
    fn key(&self, row: &Row) -> [i64; 3] {
        let column =
            |position: usize| match self.record_columns.get(position).map(|index| &row.values[*index]) {
                Some(Value::Integer(value)) => *value,
                _ => 0,
            };
        [column(0), column(1), column(2)]
    }
}

impl Column {
    /// Returns `Some` if the value has the type of the column. SQLite stores REAL numbers without a fraction as integers.
    /// Such an integer is converted to REAL.
    fn accept(&self, value: &mut Value) -> Option<()> {
        if let (Value::Integer(integer), "REAL") = (&*value, self.kind.as_str()) {
            *value = Value::Real(*integer as f64);
        }
        let fits = match value {
            Value::Null => !self.not_null,
            Value::Integer(_) => matches!(self.kind.as_str(), "INTEGER" | "INT"),
            Value::Real(_) => self.kind == "REAL",
            Value::Text(_) => self.kind == "TEXT",
            Value::Blob(_) => self.kind == "BLOB",
        };
        fits.then_some(())
    }
}

impl Value {
    fn bind(&self, to: &mut SqliteArguments) -> Result<(), BoxDynError> {
        match self {
            Self::Null => to.add(None::<i64>),
            Self::Integer(value) => to.add(*value),
            Self::Real(value) => to.add(*value),
            Self::Text(value) => to.add(value.clone()),
            Self::Blob(value) => to.add(value.clone()),
        }
    }
}

/// Returns the values of a record, or `None` if it is malformed.
pub(super) fn decode_values(record: &[u8]) -> Option<Vec<Value>> {
    let (header_bytes, rest) = varint(record)?;
    let header_bytes = usize::try_from(header_bytes).ok()?;
    let mut types = record.get(record.len() - rest.len()..header_bytes)?;
    let mut body = record.get(header_bytes..)?;
    let mut values = Vec::new();
    while !types.is_empty() {
        let (code, after) = varint(types)?;
        types = after;
        let (bytes, after) = body.split_at_checked(column_bytes(code)?)?;
        body = after;
        values.push(match code {
            0 => Value::Null,
            1..=6 => {
                // Integers are in two's complement with the length of their type, so the sign is extended.
                let negative = bytes.first().is_some_and(|byte| byte & 0x80 != 0);
                let start = if negative { -1 } else { 0 };
                Value::Integer(bytes.iter().fold(start, |value, byte| value << 8 | i64::from(*byte)))
            }
            7 => Value::Real(f64::from_be_bytes(bytes.try_into().ok()?)),
            8 => Value::Integer(0),
            9 => Value::Integer(1),
            code if code % 2 == 0 => Value::Blob(bytes.to_vec()),
            _ => Value::Text(String::from_utf8(bytes.to_vec()).ok()?),
        });
    }
    body.is_empty().then_some(values)
}

/// Returns the value of a `DEFAULT` clause.
async fn default_value(connection: &mut SqliteConnection, text: &str) -> Result<Value, sqlx::Error> {
    let statement = AssertSqlSafe(format!("SELECT typeof({text}), CAST({text} AS TEXT)"));
    let (kind, text): (String, Option<String>) = sqlx::query_as(statement).fetch_one(connection).await?;
    let text = text.unwrap_or_default();
    let invalid_default = || sqlx::Error::Protocol(format!("a column's default is {kind} {text}"));
    Ok(match kind.as_str() {
        "integer" => Value::Integer(text.parse().map_err(|_| invalid_default())?),
        "real" => Value::Real(text.parse().map_err(|_| invalid_default())?),
        "text" => Value::Text(text),
        "null" => Value::Null,
        _ => return Err(invalid_default()),
    })
}
