//! Repair of a damaged database: everything that can be read is written to a new file, which replaces the damaged file.
//!
//! The b-trees are read with the parser of the integrity check, because SQLite's recovery extension is not in the
//! bundled library. Rows are decoded and checked against the types of the columns; unreadable rows are omitted.
//! [`reconcile`] then makes the tables agree with each other and records lost iterations as gaps.

mod reconcile;
mod rows;
mod tree;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{MetadataExt, chown};
use std::path::{Path, PathBuf};

use peernet_clock::WallTime;
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};
use tokio_util::sync::CancellationToken;

use self::reconcile::Reconciliation;
use self::rows::{CopiedTable, Table, Value, decode_values};
use self::tree::{Item, Walk};
use super::{BUSY_TIMEOUT, free_bytes};
use crate::database::MIGRATIONS;
use crate::database_error::{DatabaseError, is_damage};
use crate::foreign_log::{ForeignLog, assign_id, refuse_foreign_log};
use crate::integrity::pages::PageFile;
use crate::integrity::{delete_record, find_damage_with_sqlite, recorded_damage, remove_if_exists};
use crate::lock::{DatabaseLock, LockError};
use crate::rebuild::rebuild;

/// Table in which sqlx records the migrations of a database.
const MIGRATIONS_TABLE: &str = "_sqlx_migrations";

/// Reason why a database was not repaired. The database is unchanged.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The database does not exist.
    #[error("there is no database {}; give the file that the key `database` of [aggregator] names", .0.display())]
    Missing(PathBuf),
    /// The database cannot be locked. Usually an aggregator holds the lock.
    #[error("cannot repair the database without its lock: {0}")]
    Lock(#[from] LockError),
    /// Another process reads or writes the database without the lock, so SQLite keeps the write-ahead log for it.
    #[error("cannot repair the database {path}: another process has it open, so its newest data cannot be moved from the write-ahead log (-wal) into the file; stop the process (`fuser {path}` shows it) and repeat the repair", path = .0.display())]
    InUse(PathBuf),
    /// The write-ahead log of another database lies beside the file.
    #[error(transparent)]
    ForeignLog(#[from] ForeignLog),
    /// The header or the list of tables cannot be read.
    #[error("cannot repair {}: {what} cannot be read, and without it no row can be found; restore the newest backup, and agents send the events in their spools again", path.display())]
    Unreadable {
        /// The database.
        path: PathBuf,
        /// Part that cannot be read.
        what: &'static str,
    },
    /// The database was written by a newer version.
    #[error("cannot repair {}: a newer version wrote it (its schema is {found}, this program supports {supported}); update this program", path.display())]
    NewerSchema {
        /// The database.
        path: PathBuf,
        /// Schema in the file.
        found: i64,
        /// Newest schema that this program supports.
        supported: i64,
    },
    /// The disk has not enough space for the new file.
    #[error("{} has {free} bytes free, but the new file needs up to {needed}; free some space", folder.display())]
    NoRoom {
        /// The folder of the new file.
        folder: PathBuf,
        /// Number of bytes needed.
        needed: u64,
        /// Number of bytes free.
        free: u64,
    },
    /// A file cannot be read, written or renamed.
    #[error("cannot repair the database: {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The database cannot be checked for damage, for example because another program locks it.
    #[error("cannot check the database {} for damage: {source}", path.display())]
    Check {
        /// The database.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The new file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The new file.
        path: PathBuf,
        /// SQLite's error.
        source: DatabaseError,
    },
    /// The new file is damaged, too.
    #[error("the new file {} is damaged, too: {what}; the disk or the memory of this machine is probably failing", path.display())]
    Failing {
        /// The new file.
        path: PathBuf,
        /// Description of the damage.
        what: String,
    },
}

/// Result of a repair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RepairResult {
    /// Path of the damaged file.
    pub damaged: PathBuf,
    /// Result for each table, by name.
    pub tables: Vec<SalvagedTable>,
    /// Number of lost iterations, as far as the counters of runs or missing iteration numbers show it.
    pub lost_iterations: u64,
    /// `true` if the write-ahead log beside the database could not be applied. The newest data is missing then.
    pub without_log: bool,
}

/// Result for one table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SalvagedTable {
    /// Name of the table.
    pub table: String,
    /// Number of rows in the new file.
    pub rows: u64,
    /// Number of ranges of rows that could not be read.
    pub unreadable_ranges: u64,
}

/// Replaces a damaged database by a new file with everything that can be read. Returns `None` if the database is not
/// damaged.
///
/// The damaged file is kept as `<database>.damaged-<stamp>`. `progress` is called with each table before it is read.
///
/// # Errors
/// When the aggregator runs, another process uses the database, nothing can be read, or the new file cannot be written.
/// The database is unchanged then.
pub async fn repair(
    database: &Path,
    now: WallTime,
    stamp: &str,
    mut progress: impl FnMut(&str),
) -> Result<Option<RepairResult>, RepairError> {
    if !database.is_file() {
        return Err(RepairError::Missing(database.to_owned()));
    }
    let lock = DatabaseLock::take(database)?;
    refuse_foreign_log(database, &lock.file())?;
    // A symbolic link is resolved: log, new file and damaged file lie beside the database itself, not beside the link.
    let path = fs::canonicalize(database).map_err(|source| file_error(database, source))?;
    let recorded_damage = recorded_damage(&path).map_err(|source| file_error(&path, source))?;
    // The write-ahead log has the newest data, and only SQLite can apply the log. All later steps read the file without
    // SQLite.
    let without_log = !checkpoint_log(&path).await?;
    // Recorded damage may not exist any more, for example after a backup was restored. An intact database is not
    // rewritten. A database whose log cannot be applied is not intact.
    let damage = find_damage_with_sqlite(&path, &CancellationToken::new())
        .await
        .map_err(|error| RepairError::Check { path: path.clone(), source: DatabaseError::new(error) })?;
    if damage.is_none() && !without_log {
        if recorded_damage.is_some() {
            delete_record(&path).map_err(|source| file_error(&path, source))?;
        }
        return Ok(None);
    }
    let old = OldFile::open(&path)?;
    let new = sibling_path(&path, ".repaired");
    remove_leftover_files(&new)?;
    let salvaged = salvage(&old, &new, now, &mut progress).await;
    let (tables, lost) = match salvaged {
        Ok(salvaged) => salvaged,
        Err(error) => {
            remove_leftover_files(&new)?;
            return Err(error);
        }
    };
    let damaged = replace_database(&path, &new, stamp).map_err(|source| file_error(&path, source))?;
    delete_record(&path).map_err(|source| file_error(&path, source))?;
    Ok(Some(RepairResult { damaged, tables, lost_iterations: u64::try_from(lost).unwrap_or(0), without_log }))
}

/// The damaged file, read without SQLite.
struct OldFile {
    file: PageFile,
    /// Root page of each table.
    roots: BTreeMap<String, u32>,
    /// Newest migration of the file; `None` if it cannot be read.
    version: Option<i64>,
}

impl OldFile {
    /// Opens the file and reads its list of tables.
    fn open(path: &Path) -> Result<Self, RepairError> {
        let unreadable = |what| RepairError::Unreadable { path: path.to_owned(), what };
        let file = PageFile::open(path).map_err(|source| file_error(path, source))?;
        let file = file.ok_or_else(|| unreadable("the file's header"))?;
        let mut roots = BTreeMap::new();
        // The root of the list of tables is page 1.
        for item in Walk::over_rowid_table(&file, 1) {
            let Item::Row(_, record) = item else { continue };
            let columns = decode_values(&record).unwrap_or_default();
            let [Value::Text(kind), Value::Text(name), _, Value::Integer(root), ..] = columns.as_slice()
            else {
                continue;
            };
            if kind == "table"
                && let Ok(root) = u32::try_from(*root)
            {
                roots.insert(name.clone(), root);
            }
        }
        if roots.is_empty() {
            return Err(unreadable("the list of its tables"));
        }
        let migrations = roots.get(MIGRATIONS_TABLE).map(|root| Walk::over_rowid_table(&file, *root));
        let versions = migrations.into_iter().flatten().filter_map(|item| match item {
            Item::Row(_, record) => match decode_values(&record)?.first()? {
                Value::Integer(version) => Some(*version),
                _ => None,
            },
            Item::Unreadable => None,
        });
        let version = versions.max();
        let supported = MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0);
        // Columns of a newer schema are unknown here, so its rows would be lost.
        if let Some(found) = version.filter(|found| *found > supported) {
            return Err(RepairError::NewerSchema { path: path.to_owned(), found, supported });
        }
        Ok(Self { file, roots, version })
    }

    /// Returns the root page of a table. If the old file does not state the page, the page of the same table in the new
    /// file is returned, provided that all stated root pages are equal in both files. They are equal if the same
    /// migrations created both files.
    fn root(&self, table: &str, new_roots: &BTreeMap<String, u32>) -> Option<u32> {
        let is_same_layout =
            || self.roots.iter().all(|(table, root)| new_roots.get(table).is_none_or(|new| new == root));
        self.roots.get(table).copied().or_else(|| new_roots.get(table).copied().filter(|_| is_same_layout()))
    }
}

/// Checkpoints the write-ahead log into the file, as the next start of the aggregator would. Returns whether the log is
/// empty or missing afterwards.
///
/// # Errors
/// When another process uses the database, or the file cannot be written.
async fn checkpoint_log(path: &Path) -> Result<bool, RepairError> {
    let options =
        SqliteConnectOptions::new().filename(path).busy_timeout(BUSY_TIMEOUT).disable_statement_logging();
    let checkpoint = async {
        let mut connection = options.connect().await?;
        // If another process prevents the checkpoint, the statement succeeds, and the first column of its row is 1.
        let is_prevented: bool =
            sqlx::query_scalar("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(&mut connection).await?;
        connection.close().await?;
        Ok::<_, sqlx::Error>(is_prevented)
    };
    match checkpoint.await {
        Ok(false) => {}
        // Without the log, the newest data would be missing in the repaired file.
        Ok(true) => return Err(RepairError::InUse(path.to_owned())),
        // Damage is expected here. The length of the write-ahead log shows whether the log was applied.
        Err(error) if is_damage(&error) => {}
        Err(error) => {
            return Err(RepairError::Write { path: path.to_owned(), source: DatabaseError::new(error) });
        }
    }
    Ok(fs::metadata(sibling_path(path, "-wal")).map_or(true, |log| log.len() == 0))
}

/// Writes the new file. Returns the tables and the number of lost iterations.
async fn salvage(
    old: &OldFile,
    new: &Path,
    now: WallTime,
    progress: &mut impl FnMut(&str),
) -> Result<(Vec<SalvagedTable>, i64), RepairError> {
    // The new file is at most about as large as the old file, and both files exist at the same time.
    let needed = u64::from(old.file.page_count) * old.file.page_bytes as u64;
    let folder = new.parent().unwrap_or(new).to_owned();
    let free = free_bytes(&folder).map_err(|source| file_error(&folder, source))?;
    if free < needed {
        return Err(RepairError::NoRoom { folder, needed, free });
    }
    let failed =
        |error: sqlx::Error| RepairError::Write { path: new.to_owned(), source: DatabaseError::new(error) };
    let options = SqliteConnectOptions::new()
        .filename(new)
        .create_if_missing(true)
        // The file is synced once, when it is complete, because it is not used before that.
        .journal_mode(SqliteJournalMode::Memory)
        .synchronous(SqliteSynchronous::Off)
        // Tables are filled in the order of their names, so a row may refer to a row that is inserted later.
        .foreign_keys(false)
        .disable_statement_logging();
    let mut connection = options.connect().await.map_err(failed)?;
    let result = fill(&mut connection, old, now, progress).await.map_err(failed)?;
    assign_id(&mut connection).await.map_err(failed)?;
    connection.close().await.map_err(failed)?;
    // A failing disk could damage the new file, too, and the new file is about to replace the old file.
    if let Some(what) = find_damage_with_sqlite(new, &CancellationToken::new()).await.map_err(failed)? {
        return Err(RepairError::Failing { path: new.to_owned(), what });
    }
    Ok(result)
}

/// Creates the tables of the new file and copies all readable rows. Returns the tables and the number of lost
/// iterations.
async fn fill(
    connection: &mut SqliteConnection,
    old: &OldFile,
    now: WallTime,
    progress: &mut impl FnMut(&str),
) -> Result<(Vec<SalvagedTable>, i64), sqlx::Error> {
    // The new file gets the schema of the old file. The next start of the aggregator runs the other migrations.
    let old_migrations =
        MIGRATIONS.iter().filter(|migration| old.version.is_none_or(|version| migration.version <= version));
    let migrator =
        Migrator { migrations: Cow::Owned(old_migrations.cloned().collect()), ..Migrator::DEFAULT };
    // `None`: up to the newest migration. `false`: no migration is only marked as applied.
    migrator.run_direct(None, &mut *connection, false).await.map_err(|error| match error {
        MigrateError::Execute(error) => error,
        error => sqlx::Error::Protocol(error.to_string()),
    })?;
    // Rows are copied unchanged, so triggers must not act on the copied rows. Creating an index is faster when all rows
    // exist.
    let triggers_and_indexes: Vec<(String, String, String)> = sqlx::query_as(
        "SELECT type, name, sql FROM sqlite_schema WHERE type IN ('trigger', 'index') AND sql IS NOT NULL",
    )
    .fetch_all(&mut *connection)
    .await?;
    let roots: Vec<(String, u32)> = sqlx::query_as(
        "SELECT name, rootpage FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\' AND name <> ?1 ORDER BY name",
    )
    .bind(MIGRATIONS_TABLE)
    .fetch_all(&mut *connection)
    .await?;
    let roots: BTreeMap<String, u32> = roots.into_iter().collect();
    sqlx::query("BEGIN").execute(&mut *connection).await?;
    for (kind, name, _) in &triggers_and_indexes {
        sqlx::query(AssertSqlSafe(format!("DROP {kind} \"{name}\""))).execute(&mut *connection).await?;
    }
    let mut tables = BTreeMap::new();
    for name in roots.keys() {
        progress(name);
        let table = Table::describe(connection, name.clone()).await?;
        let copied = table.copy(connection, &old.file, old.root(name, &roots)).await?;
        tables.insert(table.name, copied);
    }
    continue_numbering(connection, old).await?;
    for (_, _, sql) in triggers_and_indexes.iter().filter(|(kind, ..)| kind == "index") {
        sqlx::query(AssertSqlSafe(sql.as_str())).execute(&mut *connection).await?;
    }
    progress("references between tables");
    let now_ns = now.unix_nanos();
    let lost = Reconciliation { connection: &mut *connection, tables: &tables, now_ns }.run().await?;
    for (_, _, sql) in triggers_and_indexes.iter().filter(|(kind, ..)| kind == "trigger") {
        sqlx::query(AssertSqlSafe(sql.as_str())).execute(&mut *connection).await?;
    }
    sqlx::query("COMMIT").execute(&mut *connection).await?;
    let has_unreadable = |table: &str| {
        tables.get(table).is_some_and(|table: &CopiedTable| !table.unreadable_ranges.is_empty())
    };
    // These tables hold statistics, which can be computed again from the nodes.
    if has_unreadable("rollup") || has_unreadable("verdict_count") {
        progress("statistics from the nodes");
        rebuild(connection, None, |_| {}).await?;
    }
    let mut salvaged = Vec::new();
    for (table, copied) in tables {
        let statement = AssertSqlSafe(format!("SELECT count(*) FROM \"{table}\""));
        let rows: i64 = sqlx::query_scalar(statement).fetch_one(&mut *connection).await?;
        let rows = u64::try_from(rows).unwrap_or(0);
        let unreadable_ranges = copied.unreadable_ranges.len() as u64;
        salvaged.push(SalvagedTable { table, rows, unreadable_ranges });
    }
    Ok((salvaged, lost))
}

/// Copies the highest row number of each table, so that new rows do not get the numbers of lost rows.
async fn continue_numbering(connection: &mut SqliteConnection, old: &OldFile) -> Result<(), sqlx::Error> {
    let Some(root) = old.roots.get("sqlite_sequence") else { return Ok(()) };
    for item in Walk::over_rowid_table(&old.file, *root) {
        let Item::Row(_, record) = item else { continue };
        let row = decode_values(&record).unwrap_or_default();
        let [Value::Text(table), Value::Integer(last)] = row.as_slice() else { continue };
        sqlx::query("DELETE FROM sqlite_sequence WHERE name = ?1 AND seq < ?2")
            .bind(table)
            .bind(last)
            .execute(&mut *connection)
            .await?;
        sqlx::query(
            "INSERT INTO sqlite_sequence (name, seq) SELECT ?1, ?2 \
             WHERE NOT EXISTS (SELECT 1 FROM sqlite_sequence WHERE name = ?1)",
        )
        .bind(table)
        .bind(last)
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

/// Renames the damaged file, and renames the new file to `path`. A file with the name `path` exists at all times.
/// Returns the path of the damaged file.
fn replace_database(path: &Path, new: &Path, stamp: &str) -> io::Result<PathBuf> {
    let old_metadata = fs::metadata(path)?;
    fs::set_permissions(new, old_metadata.permissions())?;
    let new_metadata = fs::metadata(new)?;
    let old_owner = (old_metadata.uid(), old_metadata.gid());
    if (new_metadata.uid(), new_metadata.gid()) != old_owner {
        chown(new, Some(old_owner.0), Some(old_owner.1))?;
    }
    // The new file is synced before it is renamed: after a power failure, the name must not lead to a file without
    // contents.
    File::open(new)?.sync_all()?;
    let damaged = sibling_path(path, &format!(".damaged-{stamp}"));
    // The file is linked and not renamed, so that the name `path` exists at all times.
    fs::hard_link(path, &damaged)?;
    // A log that stays beside the new file would be checkpointed into it.
    let log = sibling_path(path, "-wal");
    match fs::metadata(&log).map(|log| log.len()) {
        Ok(0) | Err(_) => remove_if_exists(&log)?,
        Ok(_) => fs::rename(&log, sibling_path(&damaged, "-wal"))?,
    }
    remove_if_exists(&sibling_path(path, "-shm"))?;
    fs::rename(new, path)?;
    // The new names are on the disk only when their folder is synced (fsync(2)).
    File::open(path.parent().unwrap_or(path))?.sync_all()?;
    Ok(damaged)
}

/// Returns the path with a suffix appended to the file's name.
fn sibling_path(path: &Path, suffix: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(suffix);
    path.into()
}

/// Removes an unfinished new file and the files that SQLite created beside it.
fn remove_leftover_files(new: &Path) -> Result<(), RepairError> {
    for path in
        [new.to_owned(), sibling_path(new, "-wal"), sibling_path(new, "-shm"), sibling_path(new, "-journal")]
    {
        remove_if_exists(&path).map_err(|source| file_error(&path, source))?;
    }
    Ok(())
}

fn file_error(path: &Path, source: io::Error) -> RepairError {
    RepairError::File { path: path.to_owned(), source }
}
