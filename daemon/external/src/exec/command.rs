//! The command of an external program, as configured or given on the command line.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt;
use std::num::NonZeroU64;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use peernet_clock::Span;
use serde::{Deserialize, Serialize};

use super::arguments::program_fact;
use super::error::CommandError;
use super::shell::{script, single_program, split};
use super::{FingerprintKey, Role};
use crate::digest;
use crate::process::{MAX_TIMEOUT_MS, find_program, invalid_variable, is_executable};

/// Maximum number of a command's files that are recorded as facts.
// Facts are read before a run, and hashing many files would delay the run.
const MAX_RECORDED_FILES: usize = 4;

/// Permission bit: users who are neither the file's owner nor in its group may read the file.
const READ_BY_OTHERS: u32 = 0o004;

/// Command: a line for the shell, or a program with its arguments.
///
/// A command is serialized as its program and the number of its arguments, because arguments may be secret. Within
/// [`with_arguments`](super::with_arguments) it is serialized as it was read.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum CommandLine {
    /// Line that is run by `sh -c`. If the line is a single program with arguments, this program replaces the shell.
    Shell(String),
    /// Program and arguments, run without a shell. The program is looked up in `PATH` unless its name contains a
    /// slash.
    Words(Vec<String>),
}

/// Configuration of an external program: `{ kind = "exec", … }`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExecConfig {
    /// Command: `["./blur", "--fast"]`, or a line for `sh -c`.
    pub command: CommandLine,
    /// Longest time for one reply, milliseconds, up to one day. Afterwards the program is killed; the next request
    /// restarts it. Default: 10000.
    #[serde(default = "ten_seconds")]
    pub timeout_ms: NonZeroU64,
    /// Working directory of the program; a program name with a slash is relative to it. Default: the current
    /// directory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// Environment variables of the program.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub env: BTreeMap<String, String>,
    /// `true` if the program, a sensor or an actuator, is reset before each episode. Default: `false`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub resets: bool,
}

impl ExecConfig {
    /// Returns the configuration of a command with the defaults.
    pub fn new(command: CommandLine) -> Self {
        Self { command, timeout_ms: ten_seconds(), folder: None, env: BTreeMap::new(), resets: false }
    }

    /// Returns the longest time for one reply.
    pub fn timeout(&self) -> Span {
        Span::from_millis(self.timeout_ms.get().min(MAX_TIMEOUT_MS).cast_signed())
    }

    /// Checks the configuration without running the program.
    ///
    /// # Errors
    /// If the program cannot be run with this configuration in this role.
    pub fn check_for(&self, role: Role) -> Result<(), CommandError> {
        if self.resets && role == Role::Model {
            return Err(CommandError::ModelResets);
        }
        if self.timeout_ms.get() > MAX_TIMEOUT_MS {
            return Err(CommandError::Timeout { timeout_ms: self.timeout_ms });
        }
        if let Some(folder) = self.folder.as_ref().filter(|folder| !folder.is_dir()) {
            return Err(CommandError::NotAFolder(folder.clone()));
        }
        if let Some(name) = invalid_variable(&self.env) {
            return Err(CommandError::Variable(name.to_owned()));
        }
        match &self.command {
            CommandLine::Shell(line) if line.trim().is_empty() => Err(CommandError::Empty),
            CommandLine::Shell(line) => match single_program(line) {
                // A name without a slash may be a builtin command of the shell.
                Some(program) if self.is_shell_command(program) => Ok(()),
                Some(program) => self.check_program(program),
                None => Ok(()),
            },
            CommandLine::Words(words) => match words.first() {
                None => Err(CommandError::Empty),
                Some(program) if words.iter().any(|word| word.contains('\0')) => {
                    Err(CommandError::ZeroByte { program: program.clone() })
                }
                Some(program) => self.check_program(program),
            },
        }
    }

    /// Returns facts for the run's page: the program, and the SHA-256 of each file that the command names. The
    /// arguments are left out, because they may be secret. The name of each fact begins with the role. Reads the
    /// files.
    pub fn facts_for(&self, role: Role) -> Vec<(String, String)> {
        let prefix = role.fact_prefix();
        let mut facts = vec![(prefix.to_owned(), program_fact(&self.command))];
        facts.extend(digest::files_fact(prefix, &self.files(role)));
        facts
    }

    /// Returns the fact that distinguishes runs with different arguments without revealing them (`Sensor arguments`,
    /// `2, fingerprint 8a5e1f0c92d3`); `None` if there are no arguments.
    pub fn arguments_fact_for(&self, role: Role, key: &FingerprintKey) -> Option<(String, String)> {
        let fingerprint = self.command.fingerprint(key)?;
        Some((format!("{} arguments", role.fact_prefix()), fingerprint))
    }

    /// Returns the files that the text of the command names: the program, and its script or data.
    ///
    /// For an actuator these are only the program and its script, because the actuator may write the other files. A
    /// file that only some users of the host may read is left out, because it may hold passwords. The program and its
    /// script are never left out.
    fn files(&self, role: Role) -> Vec<PathBuf> {
        let (program, words) = match &self.command {
            CommandLine::Shell(line) => (single_program(line), split(line)),
            CommandLine::Words(words) => (words.first().map(String::as_str), words.clone()),
        };
        let name_in_path = program.filter(|program| !program.contains('/'));
        let program_in_path = name_in_path.and_then(|program| find_program(OsStr::new(program)));
        let folder = self.folder.as_deref().unwrap_or(Path::new(""));
        let is_file = |word: &str| folder.join(word).is_file();
        let script = script(&words, is_file).cloned();
        let is_code = |word: &str| Some(word) == program || Some(word) == script.as_deref();
        let is_public = |word: &str| {
            let metadata = folder.join(word).metadata();
            metadata.is_ok_and(|metadata| metadata.permissions().mode() & READ_BY_OTHERS != 0)
        };
        let words = match role {
            Role::Sensor | Role::Model => words,
            Role::Actuator => program.map(str::to_owned).into_iter().chain(script.clone()).collect(),
        };
        // A program without a slash runs from `PATH`, even if the folder has a file of that name. Its word is skipped
        // here.
        let named_files = words.into_iter().skip(program_in_path.iter().count());
        let named_files = named_files.filter(|word| is_file(word) && (is_code(word) || is_public(word)));
        program_in_path
            .into_iter()
            .chain(named_files.map(|word| folder.join(word)))
            .take(MAX_RECORDED_FILES)
            .collect()
    }

    /// Returns whether only the shell can run a name: as a builtin command of the shell, or as a program that the shell
    /// finds with the configured variables (`env`). Returns `false` for a name with a slash and for a program in
    /// PEERNet's `PATH`. Runs the shell, but not the named program.
    fn is_shell_command(&self, name: &str) -> bool {
        let is_unknown_name = !name.contains('/') && find_program(OsStr::new(name)).is_none();
        is_unknown_name
            && Command::new("sh")
                .args(["-c", "command -v \"$0\"", name])
                .envs(&self.env)
                .stdin(Stdio::null())
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .is_ok_and(|status| status.success())
    }

    /// Checks that a program exists and can be executed.
    fn check_program(&self, program: &str) -> Result<(), CommandError> {
        if program.contains('/') {
            let path = self.folder.as_deref().unwrap_or(Path::new("")).join(program);
            return match path.is_file() {
                true if is_executable(&path) => Ok(()),
                true => Err(CommandError::NotExecutable(path)),
                false => Err(CommandError::NoFile(path)),
            };
        }
        let program_in_path = find_program(OsStr::new(program)).map(drop);
        program_in_path.ok_or_else(|| CommandError::NotInPath(program.to_owned()))
    }

    /// Returns the program and its arguments for the system call.
    pub(super) fn program_and_arguments(&self) -> (String, Vec<String>) {
        match &self.command {
            CommandLine::Shell(line) => {
                // A single program replaces the shell. A shell that waits for the program would keep the pipes open
                // when the program closes them. It would also turn a signal that kills the program into an exit status.
                let is_single_program =
                    single_program(line).is_some_and(|program| self.check_program(program).is_ok());
                let line = if is_single_program { format!("exec {line}") } else { line.clone() };
                ("sh".to_owned(), vec!["-c".to_owned(), line])
            }
            CommandLine::Words(words) => {
                let mut words = words.iter().cloned();
                (words.next().unwrap_or_default(), words.collect())
            }
        }
    }
}

const fn ten_seconds() -> NonZeroU64 {
    NonZeroU64::MIN.saturating_add(9999)
}

impl CommandLine {
    /// Returns the program without its arguments; `sh` for a line that is not a single program with
    /// arguments.
    pub fn program(&self) -> &str {
        match self {
            Self::Shell(line) => single_program(line).unwrap_or("sh"),
            Self::Words(words) => words.first().map_or("", String::as_str),
        }
    }

    /// Returns the number of the program's arguments.
    pub(super) fn argument_count(&self) -> usize {
        match self {
            Self::Shell(line) if single_program(line).is_some() => split(line).len().saturating_sub(1),
            // The line is the one argument after `-c`.
            Self::Shell(_) => 1,
            Self::Words(words) => words.len().saturating_sub(1),
        }
    }
}

/// Formats only the program, for messages: arguments may be secret.
impl fmt::Display for CommandLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.program())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<ExecConfig, toml::de::Error> {
        toml::from_str(text)
    }

    #[test]
    fn command_is_shell_line_or_list_of_words() {
        let words = read("command = ['cat', '-u']").expect("reads");
        assert_eq!(words.program_and_arguments(), ("cat".to_owned(), vec!["-u".to_owned()]));
        assert_eq!((words.check_for(Role::Actuator), words.timeout()), (Ok(()), Span::from_seconds(10)));
        let line = read("command = 'while read x; do :; done'\ntimeout_ms = 5").expect("reads");
        assert_eq!(line.program_and_arguments().1, ["-c", "while read x; do :; done"]);
        assert!(read("comand = 'x'").is_err() && read("command = 3").is_err());
    }

    #[test]
    fn single_program_replaces_its_shell() {
        for (line, is_single_program) in [
            ("cat -u", true),
            ("  cat \"$HOME\" 2> /dev/null", true),
            ("/bin/cat", true),
            ("cat | cat", false),
            ("cat & wait", false),
            ("cd x && cat", false),
            ("LANG=C cat", false),
            ("shift 1", false),
            (". /etc/profile", false),
            ("~/own", false),
        ] {
            let expected = if is_single_program { format!("exec {line}") } else { line.to_owned() };
            assert_eq!(
                ExecConfig::new(CommandLine::Shell(line.to_owned())).program_and_arguments().1[1],
                expected
            );
        }
    }

    #[test]
    fn files_of_command_are_recorded() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("own.sh"), "abc").expect("writable");
        let script_entry = "/own.sh SHA-256 ba7816bf";
        for (command, expected_files) in [
            ("['sh', 'own.sh', '--fast']", &["/sh SHA-256", script_entry][..]),
            ("['./own.sh', 'none']", &[script_entry]),
            ("'sh own.sh 2> /dev/null'", &["/sh SHA-256", script_entry]),
            ("'sh \"own.sh\" --fast'", &["/sh SHA-256", script_entry]),
            ("'while read x; do own.sh; done'", &[]),
            ("'cd x && cat'", &[]),
        ] {
            let config = read(&format!("command = {command}\nfolder = {:?}", folder.path())).expect("reads");
            let facts = config.facts_for(Role::Sensor);
            assert!(facts[0].0 == "Sensor" && facts[0].1.starts_with("the program "), "{facts:?}");
            let files_fact = facts.get(1).map_or("", |(name, fact)| {
                assert_eq!(name, "Sensor files");
                fact
            });
            let files: Vec<&str> = files_fact.split(", ").filter(|file| !file.is_empty()).collect();
            assert_eq!(files.len(), expected_files.len(), "{command}: {files:?}");
            assert!(
                files.iter().zip(expected_files).all(|(file, expected)| file.contains(expected)),
                "{command}: {files:?}"
            );
        }
    }

    #[test]
    fn output_files_of_actuator_are_not_hashed() {
        let folder = tempfile::tempdir().expect("a folder");
        for file in ["act.sh", "answers.txt"] {
            std::fs::write(folder.path().join(file), "abc").expect("writable");
        }
        let script_entry = "/act.sh SHA-256 ba7816bf";
        for (command, expected_files) in [
            ("['sh', 'act.sh', 'answers.txt']", &["/sh SHA-256", script_entry][..]),
            ("['sh', '-e', 'act.sh', 'answers.txt']", &["/sh SHA-256", script_entry]),
            ("['/bin/sh', 'act.sh', 'answers.txt']", &["/bin/sh SHA-256", script_entry]),
            ("['env', 'A=b', './act.sh', 'answers.txt']", &["/env SHA-256", script_entry]),
            ("['./act.sh', 'answers.txt']", &[script_entry]),
            ("['tee', 'answers.txt']", &["/tee SHA-256"]),
            ("['sh', '-c', 'cat > \"$0\"', 'answers.txt']", &["/sh SHA-256"]),
            ("'sh act.sh >> answers.txt'", &["/sh SHA-256", script_entry]),
            ("'./act.sh >> answers.txt'", &[script_entry]),
            ("'sh act.sh | tee answers.txt'", &[script_entry]),
            ("'cd x && tee answers.txt'", &[]),
        ] {
            let config = read(&format!("command = {command}\nfolder = {:?}", folder.path())).expect("reads");
            let facts = config.facts_for(Role::Actuator);
            let files_fact = facts.get(1).map_or("", |(_, fact)| fact);
            let files: Vec<&str> = files_fact.split(", ").filter(|file| !file.is_empty()).collect();
            assert_eq!(files.len(), expected_files.len(), "{command}: {files:?}");
            assert!(
                files.iter().zip(expected_files).all(|(file, expected)| file.contains(expected)),
                "{command}: {files:?}"
            );
        }
    }

    #[test]
    fn file_without_permission_to_execute_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("act.sh"), "#!/bin/sh\n").expect("writable");
        let check = |command: &str| {
            let config = read(&format!("command = {command}\nfolder = {:?}", folder.path())).expect("reads");
            config.check_for(Role::Actuator)
        };
        for command in ["['./act.sh']", "'./act.sh --fast'"] {
            let error = check(command).expect_err("cannot be executed").to_string();
            assert!(error.contains("act.sh is not executable; run chmod +x "), "{error}");
        }
        let permissions = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(folder.path().join("act.sh"), permissions).expect("can be set");
        assert_eq!(check("['./act.sh']"), Ok(()));
        assert_eq!(check("'shift 1'"), Ok(()), "a builtin command of the shell");
    }

    #[test]
    fn unrunnable_command_is_found_by_check() {
        for (text, expected_part) in [
            ("command = ''", "empty"),
            ("command = []", "empty"),
            ("command = ['no-such-program-anywhere']", "PATH"),
            ("command = ['./no/such/program']", "./no/such/program"),
            ("command = './no/such/program --fast'", "no program ./no/such/program"),
            ("command = 'no-such-program-anywhere --fast'", "PATH; install it"),
            ("command = 'x'\nfolder = '/no/such/folder'", "/no/such/folder"),
            ("command = 'x'\nenv = { 'a=b' = 'c' }", "a=b"),
            ("command = 'x'\ntimeout_ms = 86400001", "86400000"),
            ("command = 'x'\nresets = true", "a model has no episodes"),
        ] {
            let error = read(text).expect("reads").check_for(Role::Model).expect_err(text);
            assert!(error.to_string().contains(expected_part), "{error}");
        }
    }
}
