//! What is started, and how.

use std::collections::BTreeMap;
use std::env;
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use rustix::io::{FdFlags, fcntl_setfd};
use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};

use super::Voice;

/// A program to be started, as often as it takes.
#[derive(Clone, Debug)]
pub struct Launch {
    /// Whose it is, for the log: `the sensor of pipeline camera`.
    pub name: String,
    /// What its standard error is logged as.
    pub voice: Voice,
    /// The program: a path, or a name that is looked for in `PATH`.
    pub program: OsString,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// The folder it runs in; `None` for this program's own.
    pub folder: Option<PathBuf>,
    /// Environment variables on top of this program's own.
    pub environment: BTreeMap<String, String>,
    /// A file that it gets open, under the number that it has here.
    pub inherits: Option<Arc<File>>,
}

impl Launch {
    /// The program and its folder, for people.
    pub(crate) fn describe(&self) -> String {
        let program = self.program.to_string_lossy();
        match &self.folder {
            Some(folder) => format!("{program} in {}", folder.display()),
            None => program.into_owned(),
        }
    }

    /// The command: three pipes, and an end when this program ends.
    pub(super) fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).envs(&self.environment);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if let Some(folder) = &self.folder {
            command.current_dir(folder);
        }
        let parent = getpid();
        let inherits = self.inherits.clone();
        #[expect(
            unsafe_code,
            reason = "only between fork and exec can a process be told to die with its parent, and what stays open"
        )]
        // SAFETY: the closure makes three system calls, allocates nothing and takes no lock.
        unsafe {
            command.pre_exec(move || {
                if let Some(file) = &inherits {
                    fcntl_setfd(file, FdFlags::empty())?;
                }
                set_parent_process_death_signal(Some(Signal::KILL))?;
                // The parent may have gone before the kernel was told.
                if getppid() == Some(parent) { Ok(()) } else { Err(rustix::io::Errno::SRCH.into()) }
            });
        }
        command
    }
}

/// The name of a variable that no process can be given.
pub(crate) fn impossible_variable(environment: &BTreeMap<String, String>) -> Option<&str> {
    let impossible = |(name, value): &(&String, &String)| {
        name.is_empty() || name.contains(['=', '\0']) || value.contains('\0')
    };
    environment.iter().find(impossible).map(|(name, _)| name.as_str())
}

/// The file of a program: itself when it is a path, otherwise the first of that name in the folders of `PATH`.
pub fn find_program(name: &OsStr) -> Option<PathBuf> {
    if Path::new(name).components().count() > 1 {
        return Some(PathBuf::from(name)).filter(|path| path.is_file());
    }
    env::split_paths(&env::var_os("PATH")?).map(|folder| folder.join(name)).find(|path| path.is_file())
}
