//! Conditions of this host that can distort measurements. They are inspected before each run.
//!
//! Each condition has one file, which reads the kernel's files below configurable roots. A condition that cannot be
//! determined has the grade unknown. The cloud sends its conditions when it accepts the session; the run's description
//! contains the conditions of both hosts. `docs/trust.md` lists the thresholds and their sources.

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

use std::path::PathBuf;
use std::time::Duration;

use peernet_stream::{Condition, Grade};

use crate::config::AgentConfig;

/// Longest time that the start of a run waits for the inspection of its host.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Settings of an inspection. The roots are configurable, so that tests can inspect other file trees.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InspectionSettings {
    /// Root of sysfs.
    pub sys: PathBuf,
    /// Root of procfs.
    pub proc: PathBuf,
    /// Root of the file system, in which container managers create marker files.
    pub root: PathBuf,
    /// Files and folders that are written to during a run, with their purposes: `results`, `spool`. A path may not
    /// exist yet.
    pub written_paths: Vec<(String, PathBuf)>,
    /// Possible paths of the command `iw`, which reports the power save of a wireless interface.
    pub iw: Vec<PathBuf>,
    /// `true` if the run uses a network; otherwise wireless interfaces are not inspected.
    pub network: bool,
    /// Number of times that competing threads are counted, at least 1, at intervals of 8 ms.
    pub counting_rounds: u32,
}

impl Default for InspectionSettings {
    fn default() -> Self {
        Self {
            sys: Self::SYSFS.into(),
            proc: "/proc".into(),
            root: "/".into(),
            written_paths: Vec::new(),
            iw: ["iw", "/usr/sbin/iw", "/sbin/iw"].map(PathBuf::from).to_vec(),
            network: true,
            counting_rounds: 5,
        }
    }
}

impl InspectionSettings {
    /// Path at which Linux mounts sysfs.
    pub(crate) const SYSFS: &str = "/sys";

    /// Returns the settings for this host, with the paths to which an agent with this configuration writes. `results` is
    /// the folder to which the program of the agent writes results, if any.
    pub(crate) fn from_config(config: &AgentConfig, results: Option<PathBuf>) -> Self {
        let spool = config.agent.aggregator.as_ref().map(|_| config.spool.path(&config.agent.state_dir));
        let paths = [("spool", spool), ("results", results)].into_iter();
        let paths = paths.filter_map(|(purpose, path)| Some((purpose.to_owned(), path?)));
        Self { written_paths: paths.collect(), ..Self::default() }
    }
}

/// Inspects this host, whose name is `host`. Blocks, for less than 50 ms on most hosts.
pub fn inspect_host(settings: &InspectionSettings, host: &str) -> Vec<Condition> {
    let mut findings = Vec::new();
    findings.extend(frequency::governor(settings));
    findings.extend(heat::throttling(settings));
    findings.push(load::competing_threads(settings));
    findings.extend(load::cpu_quota(settings));
    findings.extend(load::steal_time(settings));
    findings.extend(memory::swap(settings));
    findings.extend(disk::free_space(settings));
    if settings.network {
        findings.extend(wireless::power_save(settings));
    }
    findings.push(machine::machine_kind(settings));
    findings.into_iter().map(|finding| finding.with_host(host)).collect()
}

/// Inspects this host without blocking. If the inspection takes longer than [`TIMEOUT`] or panics, the result is a
/// single unknown condition.
pub(crate) async fn inspect_host_in_time(settings: InspectionSettings, host: String) -> Vec<Condition> {
    let name = host.clone();
    let inspection = tokio::task::spawn_blocking(move || inspect_host(&settings, &name));
    let reason = match tokio::time::timeout(TIMEOUT, inspection).await {
        Ok(Ok(conditions)) => return conditions,
        Ok(Err(_)) => {
            "the inspection of the host panicked; see the log for the location in the code".to_owned()
        }
        Err(_) => format!("the inspection of the host took longer than {} ms", TIMEOUT.as_millis()),
    };
    vec![Finding::unknown("host", reason).with_host(&host)]
}

/// A condition without the name of the host.
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

    fn graded(
        about: &'static str,
        grade: Grade,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Self {
        Self { about, found: found.into(), grade, advice: advice.into() }
    }

    fn with_host(self, host: &str) -> Condition {
        let Self { about, found, grade, advice } = self;
        Condition { host: host.to_owned(), about: about.to_owned(), found, grade, advice }
    }
}
