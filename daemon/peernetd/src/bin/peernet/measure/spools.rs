//! The spools of a host that is there for some runs only: one for each aggregator that it was told to stream to.
//!
//! With one for all of them, an aggregator would lack the batches that another one has acknowledged, and take them for lost.

use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::Duration;

use peernet_networks::Address;
use peernet_report::number::counted;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

/// The one spool of versions that had no others.
const OLD: &str = "spool.sqlite";
/// Held by an agent while it runs.
pub(crate) const OF_AGENT: &str = "lock";
/// What stands before and after an aggregator's address in the name of its spool.
const NAME: (&str, &str) = ("spool-", ".sqlite");
/// How long another program that looks into a spool is waited for.
const BUSY: Duration = Duration::from_secs(1);

/// The spool of the host in this folder for an aggregator.
///
/// # Errors
/// When there is the one of an older version and it cannot be taken over.
pub(super) fn of(folder: &Path, aggregator: &Address) -> io::Result<PathBuf> {
    // Names of one machine that everybody mixes.
    let at = match aggregator.host().as_str() {
        "127.0.0.1" | "::1" => format!("localhost:{}", aggregator.port()),
        _ => aggregator.authority().to_ascii_lowercase(),
    };
    let spool = folder.join(format!("{}{at}{}", NAME.0, NAME.1));
    take_over(folder, &spool)?;
    Ok(spool)
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

/// What waits on the host in this folder for its aggregators, in a sentence for each that something waits for, or of which
/// that cannot be told. Its agent does not run.
pub(crate) async fn undelivered(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    let mut told = Vec::new();
    for name in names {
        let at = name.strip_prefix(NAME.0).and_then(|name| name.strip_suffix(NAME.1));
        let Some(at) = at else { continue };
        let file = folder.join(&name);
        match events(&file).await {
            Ok(0) => {}
            Ok(events) => {
                let (wait, them) = if events == 1 { ("waits", "it") } else { ("wait", "them") };
                told.push(format!(
                    "{} {wait} for the aggregator at {at}, in {}; the next run of this host that streams there hands {them} over",
                    counted(events, "event"),
                    file.display()
                ));
            }
            Err(error) => told.push(format!(
                "it is not known what waits for the aggregator at {at}: cannot read {}: {error}",
                file.display()
            )),
        }
    }
    told
}

/// Events in a spool.
async fn events(file: &Path) -> Result<u64, sqlx::Error> {
    let options = SqliteConnectOptions::new().filename(file).read_only(true).busy_timeout(BUSY);
    let mut connection = options.disable_statement_logging().connect().await?;
    let events: i64 =
        sqlx::query_scalar("SELECT COALESCE(SUM(events), 0) FROM batch").fetch_one(&mut connection).await?;
    connection.close().await?;
    Ok(u64::try_from(events).unwrap_or(0))
}

#[cfg(test)]
mod tests {
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
        let told = undelivered(folder.path()).await;
        assert!(told.len() == 1 && told[0].starts_with("42 events wait for the aggregator at lab:5550, in "));
        assert!(!folder.path().join(OLD).exists());
        assert_ne!(spool(folder.path(), "tcp://other:5550"), taken);
        assert!(taken.exists(), "it stays that of the first");
    }

    #[tokio::test]
    async fn what_cannot_be_read_is_told() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(spool(folder.path(), "tcp://lab:5550"), "no database").expect("writable");
        let told = undelivered(folder.path()).await;
        assert!(told.len() == 1 && told[0].contains("aggregator at lab:5550: cannot read"), "{told:?}");
    }
}
