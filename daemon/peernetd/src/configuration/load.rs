//! Reads a configuration file, and checks everything that it names.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::{fmt, io};

use peernet_agent::Agent;
use peernet_agent::config::{
    AgentConfig, ClockConfig, ClockFaultConfig, HostConfig, PipelineConfig, ProbesConfig, ServeConfig,
    SpoolConfig,
};
use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_cli::renamed_tables::{RENAMED_TABLES, RenamedTable};
use peernet_cli::toml_errors::describe_error;
use peernet_cli::{clock, small_file};
use peernet_clock::{ClockIdentity, SharedClock};
use peernet_inference::{BankConfig, ModelConfig, OnnxRuntimeConfig};
use peernet_sample::{printable_line, printable_lines};
use peernet_web::WebConfig;
use serde::Deserialize;

use super::Locator;
use super::mistakes::{self, Mistake, Remainder};
use crate::lifecycle::LifecycleConfig;
use crate::log::LogConfig;

/// Largest size of a configuration file, bytes.
const MAX_FILE_BYTES: u64 = 4 << 20;

/// Tables that do not belong at the top of the file, and the hint where each table belongs.
const MISPLACED_TABLES: [(&str, &str); 1] = [("retention", "did you mean [aggregator.retention]?")];

/// Pairs of a table and the last part of keys. The check of these keys depends on the table, so their problems are not
/// reported if the table has mistakes.
const DEPENDENT_KEYS: [(&str, &str); 9] = [
    ("model", ".placement.model"),
    ("bank", ".placement.model"),
    ("model", "serve"),
    ("bank", "serve"),
    ("pipeline", "serve"),
    ("pipeline", ".warm_up"),
    ("serve", "probes.port"),
    ("agent", "spool.file"),
    ("lifecycle", "agent.stop_timeout_ms"),
];

/// Top-level keys of the file that are arrays of tables; all other top-level keys are tables.
const TABLE_ARRAYS: [&str; 2] = ["model", "pipeline"];

/// A whole configuration file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    log: LogConfig,
    #[serde(default)]
    lifecycle: LifecycleConfig,
    aggregator: Option<AggregatorConfig>,
    web: Option<WebConfig>,
    agent: Option<HostConfig>,
    spool: Option<SpoolConfig>,
    clock: Option<ClockConfig>,
    probes: Option<ProbesConfig>,
    #[serde(alias = "rehearsal")]
    clock_fault: Option<ClockFaultConfig>,
    serve: Option<ServeConfig>,
    #[serde(default)]
    model: Vec<ModelConfig>,
    bank: Option<BankConfig>,
    onnxruntime: Option<OnnxRuntimeConfig>,
    #[serde(default)]
    pipeline: Vec<PipelineConfig>,
}

/// Roles and settings of a configuration file.
#[derive(Debug)]
pub(crate) struct Configuration {
    pub(crate) log: LogConfig,
    pub(crate) lifecycle: LifecycleConfig,
    pub(crate) aggregator: Option<AggregatorConfig>,
    pub(crate) web: Option<WebConfig>,
    pub(crate) agent: Option<AgentConfig>,
    /// Lines about deprecated names: one for each table that has its former name.
    pub(crate) deprecation_lines: Vec<String>,
}

/// A problem that prevents the use of a configuration file.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    file: PathBuf,
    line: Option<usize>,
    key: String,
    text: String,
}

impl fmt::Display for Problem {
    /// Formats the problem: `FILE:LINE: KEY: problem and remedy`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.key.is_empty() {
            // Key and text may contain parts of the file, whose control characters must not reach the terminal.
            write!(f, ": {}", printable_line(&self.key))?;
        }
        write!(f, ": {}", printable_lines(&self.text))
    }
}

/// Reads a configuration file and checks everything that it names.
///
/// # Errors
/// All problems that were found. If the file cannot be read or is not TOML, this is the only problem.
pub(crate) fn load(path: &Path) -> Result<Configuration, Vec<Problem>> {
    let text = small_file::read(path, MAX_FILE_BYTES).map_err(|error| vec![unreadable_file(path, &error)])?;
    let locator = Locator::new(&text);
    let problem = |(key, text): (String, String)| Problem {
        file: path.to_owned(),
        line: locator.line(&key),
        key,
        text,
    };
    let file = match mistakes::read::<File>(&text, &TABLE_ARRAYS) {
        Ok(file) => file,
        Err(first_mistake) => {
            let (mistakes, remainder) = mistakes::all_mistakes::<File>(&text, &TABLE_ARRAYS, first_mistake);
            let mistake_problems =
                mistakes.into_iter().map(|mistake| problem_from_mistake(path, mistake, &locator));
            let remainder_problems =
                remainder.map(check_remainder).unwrap_or_default().into_iter().map(problem);
            let mut problems: Vec<Problem> = mistake_problems.chain(remainder_problems).collect();
            problems.sort_by_key(|problem| problem.line);
            return Err(problems);
        }
    };
    let role_problems = missing_role_tables(&file, &BTreeSet::new())
        .into_iter()
        .map(|(key, text)| (key.to_owned(), text.to_owned()));
    let mut configuration = Configuration::from(file);
    configuration.deprecation_lines = deprecation_lines(path, &locator);
    let problems: Vec<(String, String)> = role_problems.chain(configuration.check()).collect();
    if problems.is_empty() {
        return Ok(configuration);
    }
    Err(problems.into_iter().map(problem).collect())
}

/// Reads a configuration file without checking the files, models and addresses that it names.
///
/// # Errors
/// If the file cannot be read or parsed.
pub(super) fn read_unchecked(path: &Path) -> Result<Configuration, Vec<Problem>> {
    let text = small_file::read(path, MAX_FILE_BYTES).map_err(|error| vec![unreadable_file(path, &error)])?;
    let describe = |mistake| vec![problem_from_mistake(path, mistake, &Locator::new(&text))];
    mistakes::read::<File>(&text, &TABLE_ARRAYS).map(Configuration::from).map_err(describe)
}

/// Returns a line for each table that has its former name: `FILE:LINE: what is deprecated, and what to write`.
fn deprecation_lines(path: &Path, locator: &Locator<'_>) -> Vec<String> {
    let line = |table: &RenamedTable| {
        let line = locator.line(table.former)?;
        Some(format!("{}:{line}: {}", path.display(), table.deprecation()))
    };
    RENAMED_TABLES.iter().filter_map(line).collect()
}

fn unreadable_file(path: &Path, error: &io::Error) -> Problem {
    let text = format!("cannot read the configuration: {error}");
    Problem { file: path.to_owned(), line: None, key: String::new(), text }
}

/// Returns the problem of a key that could not be read.
fn problem_from_mistake(path: &Path, mistake: Mistake, locator: &Locator<'_>) -> Problem {
    let Mistake { key, error } = mistake;
    // In a table whose `kind` selects the type, the span of the error begins with the table and not with the key. The
    // later one of the two lines is therefore more precise.
    let line = error.span().map(|span| locator.line_at(span.start)).max(locator.line(&key));
    let mut text = describe_error(&error);
    if text.starts_with("unknown field")
        && let Some((_, hint)) = MISPLACED_TABLES.iter().find(|(table, _)| *table == key)
    {
        text = format!("{hint} ({text})");
    }
    Problem { file: path.to_owned(), line, key, text }
}

/// Returns the problems of the readable part of a file, except for problems that depend on the unreadable part.
fn check_remainder(mut remainder: Remainder<File>) -> Vec<(String, String)> {
    let file = std::mem::take(&mut remainder.file);
    let role_problems = missing_role_tables(&file, &remainder.tables_with_mistakes).into_iter();
    let role_problems = role_problems.map(|(key, text)| (key.to_owned(), text.to_owned()));
    let problems = Configuration::from(file).check().into_iter();
    // Elements of arrays that cannot be read are missing in the remainder, so the later elements have other indices.
    let problems = problems.map(|(key, text)| (remainder.key_in_file(&key), text));
    let is_certain = |(key, _): &(String, String)| {
        let depends_on_table_with_mistakes = |(table, suffix): &(&str, &str)| {
            remainder.tables_with_mistakes.contains(*table) && key.ends_with(suffix)
        };
        !remainder.is_removed(key) && !DEPENDENT_KEYS.iter().any(depends_on_table_with_mistakes)
    };
    role_problems.chain(problems.filter(is_certain)).collect()
}

/// Returns the problems (key and text) of tables that need another table. The tables in `tables_with_mistakes` exist in
/// the configuration file, even if `file` does not have them.
fn missing_role_tables(
    file: &File,
    tables_with_mistakes: &BTreeSet<String>,
) -> Vec<(&'static str, &'static str)> {
    let (has_agent, has_aggregator) = (
        file.agent.is_some() || tables_with_mistakes.contains("agent"),
        file.aggregator.is_some() || tables_with_mistakes.contains("aggregator"),
    );
    if !has_agent && !has_aggregator {
        return vec![("", "the file enables no role: add a table [agent], a table [aggregator], or both")];
    }
    let mut problems = Vec::new();
    let agent_tables = [
        ("spool", file.spool.is_some()),
        ("clock", file.clock.is_some()),
        ("probes", file.probes.is_some()),
        ("clock_fault", file.clock_fault.is_some()),
        ("serve", file.serve.is_some()),
        ("bank", file.bank.is_some()),
        ("onnxruntime", file.onnxruntime.is_some()),
        ("model", !file.model.is_empty()),
        ("pipeline", !file.pipeline.is_empty()),
    ];
    if let Some((table, _)) = agent_tables.into_iter().find(|(_, is_present)| !has_agent && *is_present) {
        problems.push((
            table,
            "[spool], [clock], [probes], [clock_fault], [serve], [[model]], [bank], [onnxruntime] and [[pipeline]] belong to an agent: add a table [agent]",
        ));
    }
    if !has_aggregator && file.web.is_some() {
        problems.push(("web", "[web] needs an aggregator: add a table [aggregator], or remove [web]"));
    }
    if file.spool.is_some()
        && !tables_with_mistakes.contains("agent")
        && file.agent.as_ref().is_some_and(|agent| agent.aggregator.is_none())
    {
        problems.push(("spool", "[spool] needs an aggregator: set [agent] aggregator, or remove [spool]"));
    }
    problems
}

impl From<File> for Configuration {
    fn from(file: File) -> Self {
        let agent = file.agent.map(|agent| AgentConfig {
            agent,
            spool: file.spool.unwrap_or_default(),
            clock: file.clock.unwrap_or_default(),
            probes: file.probes.unwrap_or_default(),
            clock_fault: file.clock_fault,
            serve: file.serve,
            models: file.model,
            bank: file.bank.unwrap_or_default(),
            onnxruntime: file.onnxruntime.unwrap_or_default(),
            pipelines: file.pipeline,
        });
        let File { log, lifecycle, aggregator, web, .. } = file;
        Self { log, lifecycle, aggregator, web, agent, deprecation_lines: Vec::new() }
    }
}

impl Configuration {
    /// Returns this machine's clock, with the identity that the agent's table gives it.
    ///
    /// # Errors
    /// If the kernel's boot id cannot be read.
    pub(crate) fn clock(&self) -> io::Result<SharedClock> {
        clock::system(self.agent.as_ref().map_or(ClockIdentity::SYSTEM, |agent| &agent.agent.clock_identity))
    }

    /// Returns the clock that the agent reads: `system_clock`, or a clock with the faults of `[clock_fault]`. The
    /// faults begin with this call.
    ///
    /// # Errors
    /// If the kernel's boot id cannot be read.
    pub(crate) fn agent_clock(&self, system_clock: &SharedClock) -> io::Result<SharedClock> {
        clock::with_faults(system_clock, self.agent.as_ref().and_then(|agent| agent.clock_fault.as_ref()))
    }

    /// Returns key and text of all problems that the roles find in their tables.
    fn check(&self) -> Vec<(String, String)> {
        let mut problems = Vec::new();
        if let Err(error) = self.log.check() {
            problems.push(("log.level".to_owned(), error.to_string()));
        }
        if let Err(error) = self.lifecycle.check() {
            problems.push(("lifecycle.shutdown_deadline_s".to_owned(), error.to_string()));
        }
        let (deadline_s, agent_ms) = (
            self.lifecycle.shutdown_deadline_s,
            self.agent.as_ref().map(|config| config.agent.stop_timeout_ms),
        );
        if let Some(agent_ms) = agent_ms.filter(|ms| *ms > deadline_s.saturating_mul(1000)) {
            let text = format!(
                "{agent_ms} ms is longer than lifecycle.shutdown_deadline_s = {deadline_s} s; reduce agent.stop_timeout_ms or raise the deadline"
            );
            problems.push(("agent.stop_timeout_ms".to_owned(), text));
        }
        if let Some(config) = &self.aggregator {
            let role_problems = Aggregator::check(config).into_iter();
            problems.extend(
                role_problems.map(|problem| (format!("aggregator.{}", problem.key), problem.message)),
            );
        }
        if let Some(config) = &self.web {
            let role_problems = config.check().into_iter();
            problems.extend(role_problems.map(|problem| (format!("web.{}", problem.key), problem.message)));
        }
        match (&self.agent, self.clock()) {
            (Some(config), Ok(clock)) => {
                let role_problems = Agent::check(config, &clock).into_iter();
                problems.extend(role_problems.map(|problem| (problem.key, problem.text)));
            }
            (Some(_), Err(error)) => problems.push(("agent.clock_identity".to_owned(), error.to_string())),
            (None, _) => {}
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::Span;

    use super::*;

    /// Returns the system's clock and the agent's clock for a configuration with these tables.
    fn clocks(tables: &str) -> (SharedClock, SharedClock) {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let file = folder.path().join("it.toml");
        let state = folder.path().join("state");
        std::fs::write(&file, format!("[agent]\nname = \"edge\"\nstate_dir = {state:?}\n{tables}"))
            .expect("the temporary folder is writable");
        let configuration = load(&file).expect("the file has no problem");
        let system_clock = configuration.clock().expect("linux has a boot id");
        let agent_clock = configuration.agent_clock(&system_clock).expect("linux has a boot id");
        (system_clock, agent_clock)
    }

    fn problems_of(text: &str) -> String {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let file = folder.path().join("it.toml");
        std::fs::write(&file, text).expect("the temporary folder is writable");
        let problems = load(&file).expect_err("the file has a problem");
        problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn misplaced_table_is_reported_with_right_place() {
        let text = problems_of("[aggregator]\n[retention]\nnodes_days = 1\n");
        assert!(text.contains("did you mean [aggregator.retention]?"), "{text}");
        // A table [spool] is useless for an agent without an aggregator.
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let text = problems_of(&format!("[agent]\nname = 'a'\nstate_dir = {:?}\n[spool]\n", folder.path()));
        assert!(text.contains(":4: spool: ") && text.contains("[agent] aggregator"), "{text}");
    }

    #[test]
    fn mistakes_of_several_tables_are_reported_together() {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let text = problems_of(&format!(
            "[log]\nlevel = 'loud=very'\n[lifecycle]\nshutdown_deadline_s = 9223372036854775807\n\
             [agent]\nname = 'a'\nstate_dir = {:?}\nqueue_event = 7\nio_threads = 'x'\n\
             [[pipeline]]\nname = 'one'\nsensor = {{ kind = 'synthetic', size_bytes = 10 }}\nplacement = {{ kind = 'local' }}\n\
             [[pipeline]]\nname = 'two'\nsensor = {{ kind = 'synthetic', size_bytes = 10 }}\nplacement = {{ kind = 'none' }}\n\
             rate = 3\n[web]\nlisten = '0.0.0.0:80'\n",
            folder.path()
        ));
        let lines: Vec<&str> = text.lines().collect();
        for (line, expected) in lines.iter().zip([
            ":2: log.level: ",
            ":4: lifecycle.shutdown_deadline_s: ",
            ":8: agent.queue_event: unknown field `queue_event`",
            ":9: agent.io_threads: invalid type",
            ":13: pipeline[0].placement: missing field `model`",
            ":18: pipeline[1].rate: unknown field `rate`",
            ":19: web: [web] needs an aggregator",
            ":20: web.listen: ",
        ]) {
            assert!(line.contains(expected), "{expected} in {text}");
        }
        assert_eq!(lines.len(), 8, "{text}");
    }

    #[test]
    fn mistake_hides_no_problem_in_readable_tables() {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let sensor = "sensor = { kind = 'synthetic', size_bytes = 10 }";
        let text = problems_of(&format!(
            "[agent]\nname = 'a'\nstate_dir = {:?}\nio_threads = 'x'\n[clock]\nwindow_s = 1\nunknown = 1\n\
             [[model]]\nname = 'm'\nkind = 'nonsense'\n\
             [[pipeline]]\nname = 'one'\n{sensor}\nplacement = {{ kind = 'nowhere' }}\n\
             [[pipeline]]\nname = 'two'\n{sensor}\nplacement = {{ kind = 'local', model = 'm' }}\nload = {{ mode = 'rate', hz = -3 }}\n\
             [[pipeline]]\nname = 'two'\nsensor = {{ kind = 'images', path = '/nonexistent' }}\nplacement = {{ kind = 'none' }}\n\
             warm_up = {{ iteration = 3 }}\n",
            folder.path()
        ));
        for expected in [
            ":4: agent.io_threads: invalid type",
            // The default of `fresh_s` is longer than `window_s`. A missing key has the line of its table.
            ":5: clock.fresh_s: ",
            ":6: clock.window_s: ",
            ":7: clock.unknown: unknown field",
            ":10: model[0].kind: unknown variant `nonsense`",
            ":14: pipeline[0].placement.kind: unknown variant `nowhere`",
            ":19: pipeline[1].load.hz: ",
            ":21: pipeline[2].name: another pipeline is named two",
            ":22: pipeline[2].sensor: ",
            ":24: pipeline[2].warm_up.iteration: unknown field",
        ] {
            assert_eq!(
                text.lines().filter(|line| line.contains(expected)).count(),
                1,
                "{expected} in {text}"
            );
        }
        assert!(!text.contains("no [[model]]"), "the file has a model, which cannot be read: {text}");
        assert_eq!(text.lines().count(), 10, "{text}");
    }

    #[test]
    fn keys_are_printed_without_control_characters() {
        let text = problems_of("[aggregator]\n\"k\\u001b[31m\\r\" = 3\n");
        assert!(text.contains("aggregator.k [31m") && !text.contains(['\u{1b}', '\r']), "{text:?}");
    }

    #[test]
    fn deadline_longer_than_a_day_is_refused() {
        let text = problems_of("[lifecycle]\nshutdown_deadline_s = 9223372036854775807\n[aggregator]\n");
        assert!(text.contains(":2: lifecycle.shutdown_deadline_s: ") && text.contains("a day"), "{text}");
    }

    #[test]
    fn agent_without_clock_fault_reads_system_clock() {
        let (system_clock, agent_clock) = clocks("");
        assert!(Arc::ptr_eq(&system_clock, &agent_clock));
    }

    #[test]
    fn agent_with_clock_fault_reads_another_clock() {
        let (system_clock, agent_clock) = clocks("[clock_fault]\noffset_ms = 86400000\n");
        assert_eq!(system_clock.identity().clock.as_ref(), ClockIdentity::SYSTEM);
        assert!(agent_clock.identity().clock.starts_with("clock-fault-"), "{:?}", agent_clock.identity());
        assert!(agent_clock.wall() - system_clock.wall() > Span::from_seconds(80_000));
        assert_eq!(system_clock.injected_faults(), None);

        let (_, clock_with_own_name) = clocks("clock_identity = \"mine\"\n[clock_fault]\n");
        assert_eq!(clock_with_own_name.identity().clock.as_ref(), "mine");
    }
}
