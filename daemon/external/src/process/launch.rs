//! Description of a process to be started.

use std::collections::BTreeMap;
use std::env;
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use rustix::io::{FdFlags, fcntl_setfd};
use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};

use super::StderrLog;

/// Program with its arguments, working directory and environment; may be started repeatedly.
#[derive(Clone, Debug)]
pub struct Launch {
    /// Owner of the process, for the log: `the sensor of pipeline camera`.
    pub name: String,
    /// Log target of the process's standard error.
    pub stderr_log: StderrLog,
    /// The program: a path, or a name that is searched in `PATH`.
    pub program: OsString,
    /// Arguments of the program.
    pub arguments: Vec<OsString>,
    /// Working directory; `None` for PEERNet's working directory.
    pub folder: Option<PathBuf>,
    /// Environment variables added to PEERNet's environment.
    pub environment: BTreeMap<String, String>,
    /// Open file that the process inherits, under the same descriptor number.
    pub inherited_file: Option<Arc<File>>,
}

impl Launch {
    /// Returns the program and its working directory as text.
    pub(crate) fn describe(&self) -> String {
        let program = self.program.to_string_lossy();
        match &self.folder {
            Some(folder) => format!("{program} in {}", folder.display()),
            None => program.into_owned(),
        }
    }

    /// Returns the command, with pipes for standard input, output and error. The kernel kills the process when
    /// PEERNet's process ends.
    pub(super) fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).envs(&self.environment);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if let Some(folder) = &self.folder {
            command.current_dir(folder);
        }
        let parent = getpid();
        let inherited_file = self.inherited_file.clone();
        #[expect(
            unsafe_code,
            reason = "the parent-death signal and the inherited descriptor can only be set between fork and exec"
        )]
        // SAFETY: the closure makes three system calls, allocates nothing and takes no lock.
        unsafe {
            command.pre_exec(move || {
                if let Some(file) = &inherited_file {
                    // Close-on-exec is removed in the child only: processes that other threads start do not inherit
                    // the file.
                    fcntl_setfd(file, FdFlags::empty())?;
                }
                set_parent_process_death_signal(Some(Signal::KILL))?;
                // The parent may have ended before the parent-death signal was set.
                if getppid() == Some(parent) { Ok(()) } else { Err(rustix::io::Errno::SRCH.into()) }
            });
        }
        command
    }
}

/// Returns the name of a variable that the system cannot pass to a process, if there is one.
pub(crate) fn invalid_variable(environment: &BTreeMap<String, String>) -> Option<&str> {
    let is_invalid = |(name, value): &(&String, &String)| {
        name.is_empty() || name.contains(['=', '\0']) || value.contains('\0')
    };
    environment.iter().find(is_invalid).map(|(name, _)| name.as_str())
}

/// Returns the file of a program; `None` if there is no such file. A name with a slash is the path of the file. For any
/// other name, the file is the first executable file of that name in the folders of `PATH`.
pub fn find_program(name: &OsStr) -> Option<PathBuf> {
    if Path::new(name).components().count() > 1 {
        return Some(PathBuf::from(name)).filter(|path| path.is_file());
    }
    env::split_paths(&env::var_os("PATH")?).map(|folder| folder.join(name)).find(|path| is_executable(path))
}

/// Returns whether a path leads to a file that its owner, its group or others may execute.
pub(crate) fn is_executable(path: &Path) -> bool {
    path.metadata().is_ok_and(|file| file.is_file() && file.permissions().mode() & EXECUTE != 0)
}

/// Permission bits: the owner, the group and others may execute the file.
const EXECUTE: u32 = 0o111;
