//! The spools of a host that is there for some runs only: one for each aggregator that it was told to stream to.
//!
//! With one for all of them, an aggregator would lack the batches that another one has acknowledged, and take them for lost.

use std::fmt;
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use peernet_agent::spool::{SpoolReadError, waiting_events};
use peernet_networks::Address;
use peernet_statistics::number::counted;

/// The one spool of versions that had no others.
const OLD: &str = "spool.sqlite";
/// Held by an agent while it runs.
pub(crate) const OF_AGENT: &str = "lock";
/// What stands before and after an aggregator's address in the name of its spool.
const NAME: (&str, &str) = ("spool-", ".sqlite");

/// The spool of the host in this folder for an aggregator.
///
/// # Errors
/// When there is the one of an older version and it cannot be taken over.
pub(super) fn of(folder: &Path, aggregator: &Address) -> io::Result<PathBuf> {
    let spool = folder.join(format!("{}{}{}", NAME.0, name_of(aggregator), NAME.1));
    take_over(folder, &spool)?;
    Ok(spool)
}

/// An aggregator's address as it stands in the name of its spool.
fn name_of(aggregator: &Address) -> String {
    // Names of one machine that everybody mixes.
    match aggregator.host().as_str() {
        "127.0.0.1" | "::1" => format!("localhost:{}", aggregator.port()),
        _ => aggregator.authority().to_ascii_lowercase(),
    }
}

/// Lets the spool of an older version go on as that of the first aggregator that is named. What waits in it goes there, as
/// it would have with that version.
fn take_over(folder: &Path, spool: &Path) -> io::Result<()> {
    let old = folder.join(OLD);
    if spool.exists() || !old.exists() {
        return Ok(());
    }
    let lock = File::options().create(true).append(true).open(folder.join(OF_AGENT))?;
    match lock.try_lock() {
        Ok(()) => {}
        // An agent is at work here: this one will be refused for it.
        Err(TryLockError::WouldBlock) => return Ok(()),
        Err(TryLockError::Error(error)) => return Err(error),
    }
    // The file itself comes last: whoever is killed before it goes on from there.
    for end in ["-wal", "-reserve", ""] {
        match fs::rename(with_end(&old, end), with_end(spool, end)) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    for end in ["-shm", "-lock"] {
        // What is of no use any more does no harm.
        let _ = fs::remove_file(with_end(&old, end));
    }
    Ok(())
}

fn with_end(path: &Path, end: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(end);
    path.into()
}

/// What waits on a host for one of its aggregators, or that nobody can tell.
pub(crate) struct Waiting {
    at: String,
    file: PathBuf,
    events: Result<u64, SpoolReadError>,
}

impl Waiting {
    /// Whether it waits for this aggregator.
    pub(crate) fn is_for(&self, aggregator: &Address) -> bool {
        self.at == name_of(aggregator)
    }

    /// What waits in a file; `None` when nothing does.
    async fn look(at: String, file: PathBuf) -> Option<Self> {
        let events = waiting_events(&file).await;
        let waits = !matches!(events, Ok(0));
        waits.then_some(Self { at, file, events })
    }
}

impl fmt::Display for Waiting {
    /// A sentence.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { at, file, events } = self;
        let file = file.display();
        match events {
            Ok(events) => {
                let (wait, them) = if *events == 1 { ("waits", "it") } else { ("wait", "them") };
                write!(
                    f,
                    "{} {wait} for the aggregator at {at}, in {file}; the next run of this host that streams there hands {them} over",
                    counted(*events, "event"),
                )
            }
            Err(error) => write!(
                f,
                "it is not known what waits for the aggregator at {at}: cannot read {file}: {error}"
            ),
        }
    }
}

/// What waits on the host in this folder, one for each aggregator that something waits for. Its agent does not run.
pub(crate) async fn undelivered(folder: &Path) -> Vec<Waiting> {
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    let mut waiting = Vec::new();
    for name in names {
        let at = name.strip_prefix(NAME.0).and_then(|name| name.strip_suffix(NAME.1));
        let Some(at) = at else { continue };
        waiting.extend(Waiting::look(at.to_owned(), folder.join(&name)).await);
    }
    waiting
}

/// What waits for an aggregator in a file that was named, rather than in one of a host's own. Its agent does not run.
pub(crate) async fn undelivered_in(file: &Path, aggregator: &Address) -> Option<Waiting> {
    if file.exists() { Waiting::look(name_of(aggregator), file.to_owned()).await } else { None }
}

#[cfg(test)]
mod tests {
    use sqlx::sqlite::SqliteConnectOptions;
    use sqlx::{ConnectOptions, Connection};

    use super::*;

    fn spool(folder: &Path, address: &str) -> PathBuf {
        of(folder, &address.parse().expect("an address")).expect("nothing stands in the way")
    }

    #[test]
    fn each_aggregator_has_one_and_two_names_of_this_machine_are_one() {
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

    async fn told(folder: &Path) -> Vec<String> {
        undelivered(folder).await.iter().map(Waiting::to_string).collect()
    }

    #[test]
    fn what_waits_is_for_one_aggregator() {
        let waiting = |at: &str| Waiting { at: at.to_owned(), file: PathBuf::new(), events: Ok(1) };
        let is_for = |at: &str, address: &str| waiting(at).is_for(&address.parse().expect("an address"));
        assert!(is_for("localhost:5550", "tcp://127.0.0.1:5550") && is_for("lab:5550", "tcp://Lab:5550"));
        assert!(!is_for("lab:5550", "tcp://lab:5551") && !is_for("lab:5550", "tcp://localhost:5550"));
    }

    /// A spool as a program leaves it that is killed: some of it in the log.
    async fn killed(folder: &Path) {
        let elsewhere = tempfile::tempdir().expect("a folder");
        let file = elsewhere.path().join(OLD);
        let options = SqliteConnectOptions::new().filename(&file).create_if_missing(true);
        let options = options.journal_mode(sqlx::sqlite::SqliteJournalMode::Wal);
        let mut connection = options.connect().await.expect("writable");
        let make = "CREATE TABLE batch (number INTEGER PRIMARY KEY, events INTEGER NOT NULL);\
                    INSERT INTO batch VALUES (1, 40), (2, 2);";
        sqlx::raw_sql(make).execute(&mut connection).await.expect("writable");
        for end in ["", "-wal", "-shm"] {
            fs::copy(with_end(&file, end), with_end(&folder.join(OLD), end)).expect("it is there");
        }
        connection.close().await.expect("closes");
    }

    #[tokio::test]
    async fn that_of_an_older_version_goes_on_with_all_that_waits_in_it() {
        let folder = tempfile::tempdir().expect("a folder");
        killed(folder.path()).await;
        let agent = File::create(folder.path().join(OF_AGENT)).expect("writable");
        agent.try_lock().expect("it is free");
        spool(folder.path(), "tcp://lab:5550");
        assert!(folder.path().join(OLD).exists(), "an agent is at work with it");
        agent.unlock().expect("let go");
        // Another program was killed when it had begun.
        let taken = folder.path().join("spool-lab:5550.sqlite");
        fs::rename(with_end(&folder.path().join(OLD), "-wal"), with_end(&taken, "-wal")).expect("movable");
        assert_eq!(spool(folder.path(), "tcp://lab:5550"), taken);
        let told = told(folder.path()).await;
        assert!(told.len() == 1 && told[0].starts_with("42 events wait for the aggregator at lab:5550, in "));
        let here = "tcp://127.0.0.1:5550".parse().expect("an address");
        let named = undelivered_in(&taken, &here).await.expect("it waits there");
        assert!(named.is_for(&here) && named.to_string().starts_with("42 events wait"), "{named}");
        assert!(undelivered_in(&folder.path().join("none"), &here).await.is_none());
        assert!(!folder.path().join(OLD).exists());
        assert_ne!(spool(folder.path(), "tcp://other:5550"), taken);
        assert!(taken.exists(), "it stays that of the first");
    }

    #[tokio::test]
    async fn what_cannot_be_read_is_told() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(spool(folder.path(), "tcp://lab:5550"), "no database").expect("writable");
        let told = told(folder.path()).await;
        assert!(told.len() == 1 && told[0].contains("aggregator at lab:5550: cannot read"), "{told:?}");
    }
}
