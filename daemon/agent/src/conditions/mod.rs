//! What is found of this host before a run: what can make its figures say something else than they seem to.
//!
//! One file per subject, each a question to the kernel's files. What cannot be found out says so: nothing is assumed.
//! `docs/trust.md` gives the thresholds and where they come from.

mod disk;
mod files;
mod frequency;
mod heat;
mod load;
mod machine;
mod memory;
#[cfg(test)]
mod tests;
mod wireless;

use std::path::{Path, PathBuf};
use std::time::Duration;

use peernet_stream::{Condition, Grade};

use crate::config::AgentConfig;

/// Longest that a run waits for what is found of its host.
const PATIENCE: Duration = Duration::from_millis(500);

/// Where to look: the system's roots, so that tests can point at trees of their own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Places {
    /// sysfs.
    pub sys: PathBuf,
    /// procfs.
    pub proc: PathBuf,
    /// The file system's root, where container managers leave their marks.
    pub root: PathBuf,
    /// Folders that are written to while it runs, with what they are for: `results`, `spool`.
    pub folders: Vec<(String, PathBuf)>,
    /// Where the command `iw` may be, which tells a wireless interface's power save.
    pub iw: Vec<PathBuf>,
    /// Whether the run uses a network: without one, wireless interfaces do not matter.
    pub network: bool,
    /// How often it is looked which threads compete; 8 ms pass between two looks. At least 1.
    pub looks: u32,
}

impl Default for Places {
    fn default() -> Self {
        Self {
            sys: Self::SYSFS.into(),
            proc: "/proc".into(),
            root: "/".into(),
            folders: Vec::new(),
            iw: ["iw", "/usr/sbin/iw", "/sbin/iw"].map(PathBuf::from).to_vec(),
            network: true,
            looks: 5,
        }
    }
}

impl Places {
    /// Where Linux mounts sysfs.
    pub(crate) const SYSFS: &str = "/sys";

    /// Those of this host, with what an agent of that configuration writes to.
    pub(crate) fn of(config: &AgentConfig) -> Self {
        let spool = config.agent.aggregator.as_ref().map(|_| config.spool.path(&config.agent.state_dir));
        let folders = spool.into_iter().map(|file| ("spool".to_owned(), file)).collect();
        Self { folders, ..Self::default() }
    }
}

/// Looks whether there is room for something at a path, which need not be there yet.
pub fn room(purpose: &str, path: &Path, host: &str) -> Condition {
    disk::of(purpose, path).of(host)
}

/// Looks at the host, which is called `host`. Blocks, for less than 50 ms on most hosts.
pub fn look(places: &Places, host: &str) -> Vec<Condition> {
    let mut found = Vec::new();
    found.extend(frequency::governor(places));
    found.extend(heat::throttling(places));
    found.push(load::competing(places));
    found.extend(load::quota(places));
    found.extend(load::stolen(places));
    found.extend(memory::swap(places));
    found.extend(disk::free(places));
    if places.network {
        found.extend(wireless::power_save(places));
    }
    found.push(machine::kind(places));
    found.into_iter().map(|finding| finding.of(host)).collect()
}

/// The same without blocking. A host that does not answer in time says so.
pub(crate) async fn look_soon(places: Places, host: String) -> Vec<Condition> {
    let name = host.clone();
    let looking = tokio::task::spawn_blocking(move || look(&places, &name));
    let why = match tokio::time::timeout(PATIENCE, looking).await {
        Ok(Ok(found)) => return found,
        Ok(Err(_)) => "looking at the host panicked; the log says where".to_owned(),
        Err(_) => format!("the host did not answer within {} ms", PATIENCE.as_millis()),
    };
    vec![Finding::unknown("host", why).of(&host)]
}

/// A condition of a host that has no name yet.
#[derive(Debug, PartialEq, Eq)]
struct Finding {
    about: &'static str,
    found: String,
    grade: Grade,
    advice: String,
}

impl Finding {
    fn good(about: &'static str, found: impl Into<String>) -> Self {
        Self { about, found: found.into(), grade: Grade::Good, advice: String::new() }
    }

    fn unknown(about: &'static str, found: impl Into<String>) -> Self {
        Self { about, found: found.into(), grade: Grade::Unknown, advice: String::new() }
    }

    fn worse(about: &'static str, grade: Grade, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { about, found: found.into(), grade, advice: advice.into() }
    }

    fn of(self, host: &str) -> Condition {
        let Self { about, found, grade, advice } = self;
        Condition { host: host.to_owned(), about: about.to_owned(), found, grade, advice }
    }
}
