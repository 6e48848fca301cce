//! The `[aggregator]` table of the configuration file, and the checks of its values that are possible before the start.

use std::path::{Path, PathBuf};
use std::time::Duration;

use peernet_logger::Slug;
use peernet_networks::{Address, InvalidEventStreamAddress};
use serde::{Deserialize, Serialize};

use peernet_store::RetentionConfig;

use crate::error::Problem;

/// The `[aggregator]` table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AggregatorConfig {
    /// Name that the aggregator states to agents; the machine's host name by default.
    pub name: Option<Slug>,
    /// Address that agents connect to: `tcp://ADDRESS:PORT`. Port 0 means any free port.
    pub listen: String,
    /// Longest time that a connection may exist without an accepted hello, 10 to 86,400,000 ms.
    pub hello_timeout_ms: u64,
    /// Memory for the incomplete messages of all agents together, 65,536 to 2^40 bytes. A connection whose message
    /// would exceed this memory is closed. A connection without an accepted hello may hold 64 KiB.
    pub max_unfinished_bytes: u64,
    /// Path of the SQLite file. It is created with its folder if it does not exist; SQLite adds `-wal` and `-shm` files
    /// in the same folder.
    pub database: PathBuf,
    /// Longest time that a batch waits for other batches before the commit, 1 to 10,000 ms.
    pub commit_interval_ms: u64,
    /// Number of tree nodes (rows) at which a commit starts without waiting, 1 to 1,000,000. The sync is a small part
    /// of the cost of such a large commit. Other batches that are ready join the commit.
    pub commit_nodes: usize,
    /// Number of read-only connections to the database, 1 to 64. Pages and API share these connections.
    pub readers: u32,
    /// Longest time of a reader's SQL statement, 100 to 600,000 ms; a longer statement is interrupted.
    pub question_limit_ms: u64,
    /// Time after the last message of a host until the live state drops the host, 1 to 2^32 - 1 s; its stored runs
    /// remain.
    pub forget_hosts_after_s: u64,
    /// Maximum number of stored hosts, 1 to 65,536. Agents of further hosts are refused; stored hosts are always
    /// accepted.
    pub max_hosts: usize,
    /// Retention limits of stored data.
    pub retention: RetentionConfig,
}

impl Default for AggregatorConfig {
    fn default() -> Self {
        Self {
            name: None,
            listen: "tcp://127.0.0.1:5550".to_owned(),
            hello_timeout_ms: 5_000,
            max_unfinished_bytes: 64 * 1024 * 1024,
            database: PathBuf::from("peernet.sqlite"),
            commit_interval_ms: 50,
            commit_nodes: 10_000,
            readers: 4,
            question_limit_ms: 10_000,
            forget_hosts_after_s: 24 * 3600,
            max_hosts: 1_000,
            retention: RetentionConfig::default(),
        }
    }
}

impl AggregatorConfig {
    /// [`Self::hello_timeout_ms`] as a duration.
    pub(crate) const fn hello_timeout(&self) -> Duration {
        Duration::from_millis(self.hello_timeout_ms)
    }

    /// [`Self::commit_interval_ms`] as a duration.
    pub(crate) const fn commit_interval(&self) -> Duration {
        Duration::from_millis(self.commit_interval_ms)
    }

    /// [`Self::question_limit_ms`] as a duration.
    pub(crate) const fn question_limit(&self) -> Duration {
        Duration::from_millis(self.question_limit_ms)
    }

    /// Returns the configured name, or the machine's host name if that is a valid name, or `aggregator`.
    pub(crate) fn name(&self) -> Slug {
        self.name.clone().unwrap_or_else(|| {
            let host_name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
            host_name.trim().parse().unwrap_or_else(|_| "aggregator".parse().expect("a valid name"))
        })
    }

    /// Returns the problems that are found without starting.
    pub(crate) fn problems(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut check = |key, message: Option<String>| {
            problems.extend(message.map(|message| Problem { key, message }));
        };
        check("listen", address_problem(&self.listen));
        check("hello_timeout_ms", range_problem(self.hello_timeout_ms, 10, 24 * 3600 * 1000));
        check("max_unfinished_bytes", range_problem(self.max_unfinished_bytes, 64 * 1024, 1 << 40));
        check("database", database_problem(&self.database));
        check("commit_interval_ms", range_problem(self.commit_interval_ms, 1, 10_000));
        check("commit_nodes", range_problem(self.commit_nodes as u64, 1, 1_000_000));
        check("readers", range_problem(u64::from(self.readers), 1, 64));
        check("question_limit_ms", range_problem(self.question_limit_ms, 100, 600_000));
        check("forget_hosts_after_s", range_problem(self.forget_hosts_after_s, 1, u64::from(u32::MAX)));
        check("max_hosts", range_problem(self.max_hosts as u64, 1, 65_536));
        let retention_problems = self.retention.problems().into_iter();
        problems.extend(retention_problems.map(|(key, message)| Problem { key, message }));
        problems
    }
}

/// Returns a problem if `value` is not between `min` and `max`.
fn range_problem(value: u64, min: u64, max: u64) -> Option<String> {
    (value < min || value > max).then(|| format!("{value} is outside {min} to {max}"))
}

/// Returns a problem if `address` cannot be listened on.
fn address_problem(address: &str) -> Option<String> {
    match address.parse::<Address>() {
        Ok(address) => address.check_event_stream().err().map(|error| error.to_string()),
        Err(error) => Some(InvalidEventStreamAddress(error).to_string()),
    }
}

/// Returns a problem unless `path` names a file that is writable or can be created: the file, and the nearest existing
/// folder above it, must be writable.
fn database_problem(path: &Path) -> Option<String> {
    let text = path.to_string_lossy();
    // SQLite would accept these paths and lose acknowledged data at the end of the program.
    if text.is_empty() || text.starts_with(":memory:") || text.starts_with("file:") {
        return Some(format!(
            "{text:?} is not the path of a file, and acknowledged events must survive a restart: name a file, such as \
             peernet.sqlite"
        ));
    }
    if path.is_dir() {
        return Some(format!("{} is a folder; name a file in it", path.display()));
    }
    let current_folder = Path::new(".");
    let folders = path
        .ancestors()
        .skip(1)
        .map(|folder| if folder.as_os_str().is_empty() { current_folder } else { folder });
    let folder = folders.into_iter().find(|folder| folder.exists()).unwrap_or(current_folder);
    // SQLite creates files beside the database, so the folder has to be writable, too.
    let (write, enter) = (rustix::fs::Access::WRITE_OK, rustix::fs::Access::EXEC_OK);
    let file = path.exists().then_some((path, write));
    let access_problem = [(folder, write | enter)].into_iter().chain(file).find_map(|(path, access)| {
        let error = rustix::fs::access(path, access).err()?;
        Some(format!("cannot write to {}: {error}; choose another path or change the owner", path.display()))
    });
    let folder_problem =
        || (!folder.is_dir()).then(|| format!("{} is not a folder; choose another path", folder.display()));
    // The more specific problem comes first.
    folder_problem().or(access_problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(change: impl FnOnce(&mut AggregatorConfig)) -> Vec<&'static str> {
        let mut config = AggregatorConfig::default();
        change(&mut config);
        config.problems().iter().map(|problem| problem.key).collect()
    }

    #[test]
    fn invalid_value_is_reported_with_its_key() {
        assert!(problems(|_| {}).is_empty());
        assert!(problems(|config| config.database = "not/yet/there/peernet.sqlite".into()).is_empty());
        for address in ["127.0.0.1:5550", "udp://127.0.0.1:5550", "tcp://127.0.0.1", "inproc://x", ""] {
            assert_eq!(problems(|config| config.listen = address.into()), ["listen"], "{address}");
        }
        for database in ["/", "", ":memory:", "file:peernet.sqlite", "file::memory:?cache=shared"] {
            assert_eq!(problems(|config| config.database = database.into()), ["database"], "{database}");
        }
        assert_eq!(
            problems(|config| config.database = "/proc/version/x/peernet.sqlite".into()),
            ["database"]
        );
        assert_eq!(
            problems(|config| (config.commit_nodes, config.readers) = (0, 65)),
            ["commit_nodes", "readers"]
        );
    }

    #[test]
    fn unknown_keys_are_refused() {
        let valid: Result<AggregatorConfig, _> = serde_json::from_str(r#"{"listen": "tcp://127.0.0.1:1"}"#);
        assert!(valid.is_ok());
        let misspelt: Result<AggregatorConfig, _> = serde_json::from_str(r#"{"listn": "x"}"#);
        assert!(misspelt.is_err());
    }
}
