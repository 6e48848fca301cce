//! Examination of an agent's spool: waiting batches, their integrity, and free disk space.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use peernet_agent::spool::{InspectError, Inspection, SpoolDamage, inspect};
use peernet_store::maintenance::{Finding, Severity, free_bytes};
use serde::Serialize;

/// A disk with less free space counts as full, bytes.
const MIN_FREE_BYTES: u64 = 16 << 20;
/// Advice about a damaged spool.
const RENEW_ADVICE: &str = "stop the agent, move the file and its -wal to another folder, and start the agent again: it creates \
                     a new spool, and the aggregator records the lost events as a gap";
/// Advice about a full disk.
const FREE_SPACE_ADVICE: &str = "free disk space: while the aggregator is unreachable, events that do not fit into the agent's \
                         memory are lost and counted";

/// State of a spool.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct SpoolReport {
    pub(super) spool: PathBuf,
    #[serde(flatten)]
    pub(super) inspection: Inspection,
    /// Size of the file and its log, bytes.
    pub(super) file_bytes: u64,
    /// Free space on the disk of the spool, bytes. The file with which the agent reserves space for deleting
    /// does not count as free space.
    pub(super) disk_free_bytes: u64,
    pub(super) findings: Vec<Finding>,
}

/// Reads the whole spool in one transaction; an agent may be running.
pub(super) async fn examine(path: &Path) -> anyhow::Result<SpoolReport> {
    if !path.is_file() {
        bail!(
            "the spool {} does not exist; an agent with [agent] aggregator creates it at its start",
            path.display()
        );
    }
    let mut report = SpoolReport { spool: path.to_owned(), ..SpoolReport::default() };
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
    let mut log_path = path.as_os_str().to_owned();
    log_path.push("-wal");
    report.file_bytes = length(path) + length(Path::new(&log_path));
    report.check_free_space(path);
    match inspect(path).await {
        Ok(inspection) => report.add_inspection(inspection),
        // SQLite needs some disk space even for reading.
        Err(InspectError::Read(error)) if report.disk_free_bytes < MIN_FREE_BYTES => {
            report.add_problem(format!("the spool cannot be read: {error}"), FREE_SPACE_ADVICE);
        }
        Err(InspectError::Read(error)) => {
            return Err(error).with_context(|| format!("cannot read the spool {}", path.display()));
        }
        Err(error) => {
            let advice = match error {
                InspectError::Database => "examine it with `peernetd doctor --database FILE`",
                InspectError::Empty => "start its agent, which creates the spool",
                _ => "give the path of [spool] file",
            };
            report.add_problem(error.to_string(), advice);
        }
    }
    Ok(report)
}

impl SpoolReport {
    fn check_free_space(&mut self, path: &Path) {
        match free_bytes(path) {
            Ok(bytes) => {
                self.disk_free_bytes = bytes;
                if bytes < MIN_FREE_BYTES {
                    self.add_problem(
                        format!("the disk of the spool has only {} KiB of free space", bytes >> 10),
                        FREE_SPACE_ADVICE,
                    );
                }
            }
            Err(error) => {
                self.add_problem(
                    format!("cannot read the free space of the spool's disk: {error}"),
                    "check it with `df`",
                );
            }
        }
    }

    fn add_inspection(&mut self, inspection: Inspection) {
        for damage in inspection.damages.iter().map(SpoolDamage::to_string) {
            self.add_problem(damage, RENEW_ADVICE);
        }
        self.findings.extend(loss_findings(inspection.dropped, inspection.lost_when_killed));
        self.inspection = inspection;
    }

    fn add_problem(&mut self, what: String, advice: &str) {
        self.findings.push(Finding { severity: Severity::Problem, what, advice: advice.to_owned() });
    }
}

/// Returns the findings about lost events. `dropped` counts all lost events, `lost_when_killed` those that were in the
/// memory of a killed agent; the other events were dropped for lack of space. `lost_when_killed` is `None` if a spool
/// of an earlier release does not distinguish the two causes.
fn loss_findings(dropped: i64, lost_when_killed: Option<i64>) -> Vec<Finding> {
    let finding = |events: i64, cause: &str, advice: &str| {
        (events > 0).then(|| Finding {
            severity: Severity::Notice,
            what: format!("{events} events {cause}; gaps report them"),
            advice: advice.to_owned(),
        })
    };
    const SPACE_ADVICE: &str = "raise [spool] limit_bytes, or check why the aggregator was unreachable";
    let Some(lost_when_killed) = lost_when_killed else {
        let cause = "were dropped for lack of space, or lost when the agent was killed";
        return Vec::from_iter(finding(
            dropped,
            cause,
            "look up the reason of the gaps on the page Incidents",
        ));
    };
    let lack_of_space = finding(dropped - lost_when_killed, "were dropped for lack of space", SPACE_ADVICE);
    let kill = finding(
        lost_when_killed,
        "were lost when the agent was killed before they reached its spool",
        "stop the agent with SIGTERM or Ctrl-C, which writes everything to the spool first",
    );
    lack_of_space.into_iter().chain(kill).collect()
}

#[cfg(test)]
mod tests {
    use super::loss_findings;

    #[test]
    fn losses_are_reported_by_cause() {
        let describe = |dropped, killed| -> Vec<_> {
            loss_findings(dropped, killed)
                .into_iter()
                .map(|finding| format!("{} → {}", finding.what, finding.advice))
                .collect()
        };
        assert!(describe(0, Some(0)).is_empty() && describe(0, None).is_empty());
        let [killed] = &describe(2, Some(2))[..] else { panic!("{:?}", describe(2, Some(2))) };
        assert!(
            killed.starts_with("2 events were lost when the agent was killed")
                && !killed.contains("limit_bytes"),
            "{killed}"
        );
        let [lack_of_space, killed] = &describe(5, Some(2))[..] else { panic!("{:?}", describe(5, Some(2))) };
        assert!(
            lack_of_space.starts_with("3 events") && lack_of_space.contains("limit_bytes"),
            "{lack_of_space}"
        );
        assert!(killed.starts_with("2 events"), "{killed}");
        let [finding] = &describe(4, None)[..] else { panic!("{:?}", describe(4, None)) };
        assert!(finding.contains("for lack of space, or") && finding.contains("Incidents"), "{finding}");
    }
}
