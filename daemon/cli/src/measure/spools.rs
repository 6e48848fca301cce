//! Spools of a host that exists only during some runs: one spool for each aggregator to which it streams.
//!
//! With a common spool, an aggregator would not receive the batches that another aggregator has acknowledged, and
//! would count them as lost.

use std::fmt;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use peernet_agent::spool::{SpoolReadError, pending_events};
use peernet_networks::Address;
use peernet_statistics::number::counted;

use super::previous_results::rename_if_exists;

/// File name of the single spool that earlier versions used for all aggregators.
const OLD_SPOOL: &str = "spool.sqlite";
/// Name of the file that an agent locks while it runs.
pub(crate) const AGENT_LOCK: &str = "lock";
/// Part of a spool's file name before the aggregator's address.
const SPOOL_PREFIX: &str = "spool-";
/// Part of a spool's file name after the aggregator's address.
const SPOOL_SUFFIX: &str = ".sqlite";

/// Returns the spool of the host in this folder for an aggregator.
///
/// # Errors
/// When a spool of an earlier version exists and cannot be taken over.
pub(super) fn prepare(folder: &Path, aggregator: &Address) -> io::Result<PathBuf> {
    let spool = spool_file(folder, aggregator);
    take_over(folder, &spool)?;
    Ok(spool)
}

/// Returns the path of the spool of the host in this folder for an aggregator.
pub(crate) fn spool_file(folder: &Path, aggregator: &Address) -> PathBuf {
    folder.join(format!("{SPOOL_PREFIX}{}{SPOOL_SUFFIX}", address_in_file_name(aggregator)))
}

/// Returns an aggregator's address as part of a spool's file name.
fn address_in_file_name(aggregator: &Address) -> String {
    // People use these names of the local machine interchangeably.
    match aggregator.host().as_str() {
        "127.0.0.1" | "::1" => format!("localhost:{}", aggregator.port()),
        _ => aggregator.authority().to_ascii_lowercase(),
    }
}

/// Renames the spool of an earlier version to `spool`, the spool of the first aggregator that is used. That
/// aggregator receives the events that wait in it, as with the earlier version.
fn take_over(folder: &Path, spool: &Path) -> io::Result<()> {
    let old = folder.join(OLD_SPOOL);
    if spool.exists() || !old.exists() {
        return Ok(());
    }
    let lock = File::options().create(true).append(true).open(folder.join(AGENT_LOCK))?;
    match lock.try_lock() {
        Ok(()) => {}
        // Another agent is active in this folder, so this agent will be refused.
        Err(TryLockError::WouldBlock) => return Ok(()),
        Err(TryLockError::Error(error)) => return Err(error),
    }
    // The database file itself is renamed last. If the program is killed before that, the next start continues with
    // the renaming.
    for suffix in ["-wal", "-reserve", ""] {
        rename_if_exists(&with_suffix(&old, suffix), &with_suffix(spool, suffix))?;
    }
    for suffix in ["-shm", "-lock"] {
        // An obsolete file that remains does no harm.
        let _ = fs::remove_file(with_suffix(&old, suffix));
    }
    Ok(())
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(suffix);
    path.into()
}

/// Events of a host that wait for one of its aggregators, or the error of reading them.
pub(crate) struct UndeliveredEvents {
    /// Aggregator, as in the name of the spool.
    aggregator: String,
    file: PathBuf,
    events: Result<u64, SpoolReadError>,
}

impl UndeliveredEvents {
    /// Returns whether the events wait for this aggregator.
    pub(crate) fn is_for(&self, aggregator: &Address) -> bool {
        self.aggregator == address_in_file_name(aggregator)
    }

    /// Returns the aggregator, as in the name of the spool.
    pub(crate) fn aggregator(&self) -> &str {
        &self.aggregator
    }

    /// Returns the spool.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// Returns the number of waiting events; `None` if the spool cannot be read.
    pub(crate) fn count(&self) -> Option<u64> {
        self.events.as_ref().ok().copied()
    }

    /// Reads the waiting events of a file; `None` if there are none.
    async fn read(aggregator: String, file: PathBuf) -> Option<Self> {
        let events = pending_events(&file).await;
        let has_events = !matches!(events, Ok(0));
        has_events.then_some(Self { aggregator, file, events })
    }
}

impl fmt::Display for UndeliveredEvents {
    /// Writes a sentence with the number of events, the aggregator and the spool, or with the error.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { aggregator, file, events } = self;
        let file = file.display();
        match events {
            Ok(events) => {
                let (wait, them) = if *events == 1 { ("waits", "it") } else { ("wait", "them") };
                write!(
                    f,
                    "{} {wait} for the aggregator at {aggregator}, in {file}; the next run of this host with this aggregator delivers {them}",
                    counted(*events, "event"),
                )
            }
            Err(error) => write!(
                f,
                "cannot count the events that wait for the aggregator at {aggregator}: cannot read {file}: {error}"
            ),
        }
    }
}

/// Returns the waiting events of the host in this folder, by aggregator. Its agent must not be running.
pub(crate) async fn undelivered(folder: &Path) -> Vec<UndeliveredEvents> {
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    let mut waiting = Vec::new();
    for name in names {
        let aggregator = name.strip_prefix(SPOOL_PREFIX).and_then(|name| name.strip_suffix(SPOOL_SUFFIX));
        let Some(aggregator) = aggregator else { continue };
        waiting.extend(UndeliveredEvents::read(aggregator.to_owned(), folder.join(&name)).await);
    }
    waiting
}

/// Returns the waiting events for an aggregator in a given spool file. The agent of the spool must not be running.
pub(crate) async fn undelivered_in_spool(file: &Path, aggregator: &Address) -> Option<UndeliveredEvents> {
    if file.exists() {
        UndeliveredEvents::read(address_in_file_name(aggregator), file.to_owned()).await
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use sqlx::sqlite::SqliteConnectOptions;
    use sqlx::{ConnectOptions, Connection};

    use super::*;

    fn spool(folder: &Path, address: &str) -> PathBuf {
        prepare(folder, &address.parse().expect("an address")).expect("the spool can be prepared")
    }

    #[test]
    fn aggregator_has_one_spool_under_any_local_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let name = |address: &str| {
            spool(folder.path(), address).file_name().expect("a name").to_string_lossy().into_owned()
        };
        assert_eq!(name("tcp://Lab.example:5550"), "spool-lab.example:5550.sqlite");
        assert_eq!(name("tcp://[fd00::2]:5550"), "spool-[fd00::2]:5550.sqlite");
        for here in ["tcp://localhost:5550", "tcp://127.0.0.1:5550", "tcp://[::1]:5550"] {
            assert_eq!(name(here), "spool-localhost:5550.sqlite");
        }
        assert_ne!(name("tcp://localhost:5550"), name("tcp://localhost:5551"));
    }

    async fn describe_undelivered(folder: &Path) -> Vec<String> {
        undelivered(folder).await.iter().map(UndeliveredEvents::to_string).collect()
    }

    #[test]
    fn waiting_events_belong_to_one_aggregator() {
        let waiting =
            |at: &str| UndeliveredEvents { aggregator: at.to_owned(), file: PathBuf::new(), events: Ok(1) };
        let is_for = |at: &str, address: &str| waiting(at).is_for(&address.parse().expect("an address"));
        assert!(is_for("localhost:5550", "tcp://127.0.0.1:5550") && is_for("lab:5550", "tcp://Lab:5550"));
        assert!(!is_for("lab:5550", "tcp://lab:5551") && !is_for("lab:5550", "tcp://localhost:5550"));
    }

    /// Leaves a spool as a killed program does, with a part of it in the write-ahead log.
    async fn leave_spool_of_killed_program(folder: &Path) {
        let elsewhere = tempfile::tempdir().expect("a folder");
        let file = elsewhere.path().join(OLD_SPOOL);
        let options = SqliteConnectOptions::new().filename(&file).create_if_missing(true);
        let options = options.journal_mode(sqlx::sqlite::SqliteJournalMode::Wal);
        let mut connection = options.connect().await.expect("writable");
        let make = "CREATE TABLE batch (number INTEGER PRIMARY KEY, events INTEGER NOT NULL);\
                    INSERT INTO batch VALUES (1, 40), (2, 2);";
        sqlx::raw_sql(make).execute(&mut connection).await.expect("writable");
        for suffix in ["", "-wal", "-shm"] {
            fs::copy(with_suffix(&file, suffix), with_suffix(&folder.join(OLD_SPOOL), suffix))
                .expect("it is there");
        }
        connection.close().await.expect("closes");
    }

    #[tokio::test]
    async fn spool_of_older_version_keeps_waiting_events() {
        let folder = tempfile::tempdir().expect("a folder");
        leave_spool_of_killed_program(folder.path()).await;
        let agent = File::create(folder.path().join(AGENT_LOCK)).expect("writable");
        agent.try_lock().expect("it is free");
        spool(folder.path(), "tcp://lab:5550");
        assert!(folder.path().join(OLD_SPOOL).exists(), "a spool that an agent uses is not renamed");
        agent.unlock().expect("it was locked");
        // Another program was killed after it had started the takeover.
        let taken = folder.path().join("spool-lab:5550.sqlite");
        fs::rename(with_suffix(&folder.path().join(OLD_SPOOL), "-wal"), with_suffix(&taken, "-wal"))
            .expect("movable");
        assert_eq!(spool(folder.path(), "tcp://lab:5550"), taken);
        let descriptions = describe_undelivered(folder.path()).await;
        assert!(
            descriptions.len() == 1
                && descriptions[0].starts_with("42 events wait for the aggregator at lab:5550, in ")
        );
        let here = "tcp://127.0.0.1:5550".parse().expect("an address");
        let named = undelivered_in_spool(&taken, &here).await.expect("it waits there");
        assert!(named.is_for(&here) && named.to_string().starts_with("42 events wait"), "{named}");
        assert!(undelivered_in_spool(&folder.path().join("none"), &here).await.is_none());
        assert!(!folder.path().join(OLD_SPOOL).exists());
        assert_ne!(spool(folder.path(), "tcp://other:5550"), taken);
        assert!(taken.exists(), "the spool still belongs to the first aggregator");
    }

    #[tokio::test]
    async fn unreadable_spool_is_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(spool(folder.path(), "tcp://lab:5550"), "no database").expect("writable");
        let descriptions = describe_undelivered(folder.path()).await;
        assert!(
            descriptions.len() == 1 && descriptions[0].contains("aggregator at lab:5550: cannot read"),
            "{descriptions:?}"
        );
    }
}
