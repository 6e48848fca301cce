//! Checks `[spool]`.

use std::path::Path;

use super::{Report, check_writable};
use crate::config::{AgentConfig, SpoolConfig};
use crate::outbox::FileKind;

/// Smallest limit of a spool in bytes: 1 MiB.
const MIN_LIMIT_BYTES: u64 = 1 << 20;
/// Largest limit of a spool in bytes: 1 TiB.
const MAX_LIMIT_BYTES: u64 = 1 << 40;
/// Longest interval between two syncs: a minute.
const MAX_SYNC_INTERVAL_MS: u64 = 60_000;

pub(super) fn check_spool(report: &mut Report, config: &AgentConfig) {
    let (spool, batch_bytes) = (&config.spool, config.agent.batch_bytes.get() as u64);
    let limit = spool.limit_bytes.get();
    report.check_max("spool.limit_bytes", limit, MAX_LIMIT_BYTES);
    if limit < MIN_LIMIT_BYTES {
        report.add("spool.limit_bytes", format!("{limit} is too small; at least {MIN_LIMIT_BYTES}"));
    } else if limit < 4 * batch_bytes {
        let text = format!(
            "{limit} is too small: the spool must have space for four batches, {} bytes; raise spool.limit_bytes or lower agent.batch_bytes",
            4 * batch_bytes
        );
        report.add("spool.limit_bytes", text);
    }
    report.check_max("spool.sync_interval_ms", spool.sync_interval_ms.get().into(), MAX_SYNC_INTERVAL_MS);
    // Without `spool.file` the file is in `state_dir`. `super::check` checks `state_dir`.
    if let Some(file) = &spool.file {
        if file.as_os_str().is_empty() {
            report.add(
                "spool.file",
                "is empty; give a path, or remove the key to use spool.sqlite in state_dir",
            );
        } else if !file.is_dir() {
            let folder = file.parent().unwrap_or_else(|| Path::new("."));
            report.check_result("spool.file", check_writable(folder, "spool file"));
        }
    }
    check_content(report, config);
}

/// Checks the file that exists at the spool's path, if there is one. A file that is not a spool is a problem at a
/// configured path, because it may be other data; at the default path it is quarantined at the start.
fn check_content(report: &mut Report, config: &AgentConfig) {
    let path = config.spool.path(&config.agent.state_dir);
    let is_default_path = path == SpoolConfig::default().path(&config.agent.state_dir);
    if path.is_dir() {
        let text = format!("{} is a folder; name a file, such as spool.sqlite, in it", path.display());
        return report.add("spool.file", text);
    }
    // Without an aggregator no spool is opened. `check_spool` has reported an empty path.
    if config.agent.aggregator.is_none() || path.as_os_str().is_empty() {
        return;
    }
    if path.exists() && !path.is_file() {
        return report.add("spool.file", format!("{} is a device or a pipe; name a file", path.display()));
    }
    match FileKind::from_path(&path) {
        Ok(FileKind::Other) if is_default_path => {}
        Ok(kind) => {
            if let Some(objection) = kind.refusal_reason() {
                report.add("spool.file", format!("the file {} {objection}", path.display()));
            }
        }
        Err(error) => report.add("spool.file", format!("cannot read {}: {error}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problems(state: &Path, file: &Path) -> Vec<String> {
        let table = format!(
            "[agent]\nname = 'edge'\nstate_dir = {state:?}\naggregator = 'tcp://127.0.0.1:5550'\n[spool]\nfile = {file:?}"
        );
        let config: AgentConfig = toml::from_str(&table).expect("it can be read");
        let mut report = Report::default();
        check_spool(&mut report, &config);
        report.0.into_iter().map(|problem| problem.text).collect()
    }

    #[test]
    fn foreign_file_is_refused_except_at_default_path() {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let (state, notes) = (folder.path(), folder.path().join("notes.txt"));
        assert!(problems(state, &notes).is_empty(), "the start creates a missing file");
        // A truncated header of an SQLite file may belong to a damaged spool, so the check accepts such a file.
        for (content, objection) in [("", ""), ("notes", "not a spool"), ("SQLite format 3", "")] {
            std::fs::write(&notes, content).expect("it can be written");
            let problem_texts = problems(state, &notes).join(" ");
            assert!(
                problem_texts.contains(objection) && problem_texts.is_empty() == objection.is_empty(),
                "{content:?}: {problem_texts}"
            );
        }
        let default_file = state.join("spool.sqlite");
        std::fs::write(&default_file, "spoilt by its disk").expect("it can be written");
        assert!(problems(state, &default_file).is_empty());
        assert!(problems(state, Path::new("")).join(" ").contains("give a path"));
        assert!(problems(state, state).join(" ").contains("is a folder"));
    }
}
