//! Tables of an agent's configuration file that a foreground run uses.

use std::path::Path;

use crate::exit::{Exit, Failure};
use crate::renamed_tables::rename_tables;
use crate::small_file;
use crate::toml_errors::describe_error;
use anyhow::anyhow;
use peernet_agent::AgentConfig;

/// Tables that a foreground run uses. Other tables configure a daemon or are replaced by the command line.
const USED_TABLES: [&str; 4] = ["clock", "probes", "clock_fault", "onnxruntime"];

/// Reads the tables for clocks, probes and ONNX Runtime from an agent's configuration file, and the agent's name and
/// clock identity. Returns the defaults without a file.
///
/// # Errors
/// When the file cannot be read (exit code 66) or its tables are wrong (exit code 78).
pub(crate) fn read_agent_tables(file: Option<&Path>) -> Result<AgentConfig, Failure> {
    let Some(file) = file else { return Ok(AgentConfig::default()) };
    let text = small_file::read(file, small_file::MAX_BYTES)
        .map_err(|error| anyhow!("cannot read the configuration {}: {error}", file.display()))
        .map_err(|error| Failure::new(Exit::NoInput, error))?;
    read(&text, file).map_err(|error| Failure::new(Exit::Configuration, error))
}

fn read(text: &str, file: &Path) -> anyhow::Result<AgentConfig> {
    let mut document: toml::Table = text
        .parse()
        .map_err(|error: toml::de::Error| anyhow!("{}: {}", file.display(), describe_error(&error)))?;
    rename_tables(&mut document).map_err(|error| anyhow!("{}: {error}", file.display()))?;
    // Other keys of [agent], such as the aggregator and the state folder, are meant for the daemon.
    let agent = document.get("agent").and_then(toml::Value::as_table);
    let agent: toml::Table = ["name", "clock_identity"]
        .iter()
        .filter_map(|key| Some(((*key).to_owned(), agent?.get(*key)?.clone())))
        .collect();
    document.retain(|key, _| USED_TABLES.contains(&key));
    document.insert("agent".to_owned(), toml::Value::Table(agent));
    serde_path_to_error::deserialize(document)
        .map_err(|error| anyhow!("{}: {}: {}", file.display(), error.path(), describe_error(error.inner())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_used_tables_are_taken_from_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("edge.toml");
        let text = "[agent]\nname = 'edge'\naggregator = 'tcp://a:1'\n[clock]\nmax_drift_ppm = 150\n\
                    [clock_fault]\noffset_ms = 1000\n[web]\nlisten = 'x'\n[serve]\n";
        std::fs::write(&file, text).expect("writable");
        let config = read_agent_tables(Some(&file)).expect("reads");
        assert_eq!(
            (config.clock.max_drift_ppm, config.clock_fault.map(|fault| fault.offset_ms)),
            (150.0, Some(1000.0))
        );
        assert_eq!(
            (config.agent.name.map(|name| name.to_string()), config.agent.aggregator),
            (Some("edge".into()), None)
        );
        assert!(config.serve.is_none() && config.pipelines.is_empty());

        std::fs::write(&file, "[rehearsal]\noffset_ms = 5\n").expect("writable");
        let former = read_agent_tables(Some(&file)).expect("reads the former name").clock_fault;
        assert_eq!(former.map(|fault| fault.offset_ms), Some(5.0));

        std::fs::write(&file, "[clock]\nmax_drift = 150\n").expect("writable");
        let error = read_agent_tables(Some(&file)).expect_err("misspelt");
        assert!(error.exit == Exit::Configuration && error.to_string().contains("max_drift"), "{error}");
        let missing = read_agent_tables(Some(&folder.path().join("no.toml"))).expect_err("not there");
        assert!(missing.exit == Exit::NoInput && missing.to_string().contains("no.toml"), "{missing}");
    }
}
