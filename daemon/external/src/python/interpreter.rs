//! Choice and start of the Python interpreter.

use std::env;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use peernet_clock::{SharedClock, Span};

use super::{PythonConfig, PythonError, SOURCE};
use crate::DEVICE_VARIABLE;
use crate::process::{Launch, Process, ProcessError, StderrLog, find_program};

/// Environment variable that names the interpreter if the configuration names none.
const PYTHON_VARIABLE: &str = "PEERNET_PYTHON";
/// Python code that reads the source of PEERNet's worker program from standard input, and runs it. The first argument
/// is the length of the source. No byte beyond the source is read, because messages follow.
const BOOTSTRAP: &str = "import os, sys\n\
    assert sys.version_info >= (3, 8), 'Python 3.8 or newer is needed, this is %s' % sys.version\n\
    source = b''\n\
    while len(source) < int(sys.argv[1]):\n    source += os.read(0, int(sys.argv[1]) - len(source))\n\
    exec(compile(source, '<peernet>', 'exec'), {'__name__': '<peernet>'})";
/// Python code that exits with status 0 if Python finds a module; it does not run the module.
const FIND_MODULE: &str = "import importlib.util, sys\n\
    sys.path.insert(0, '')\n\
    sys.exit(importlib.util.find_spec(sys.argv[1]) is None)";
/// Longest time for finding a module.
const MODULE_SEARCH_TIMEOUT: Span = Span::from_seconds(20);

/// Returns the path of the configured interpreter.
///
/// # Errors
/// If the interpreter does not exist.
pub(super) fn python(config: &PythonConfig) -> Result<PathBuf, PythonError> {
    let configured = config.python.clone().map(PathBuf::into_os_string);
    let name = configured
        .or_else(|| env::var_os(PYTHON_VARIABLE).filter(|name| !name.is_empty()))
        .unwrap_or_else(|| OsString::from("python3"));
    let missing_error = || {
        let name = name.to_string_lossy();
        PythonError::NoPython(if name.contains('/') {
            name.into_owned()
        } else {
            format!("{name} on the PATH")
        })
    };
    let path = find_program(&name).ok_or_else(missing_error)?;
    // The process may run in another working directory.
    std::path::absolute(&path).map_err(|_| missing_error())
}

/// Returns the description of an object's process. The process first reads [`SOURCE`] from its standard input.
pub(super) fn launch(
    config: &PythonConfig,
    name: String,
    device: Option<&str>,
) -> Result<Launch, PythonError> {
    let folder = folder(config)?;
    let mut environment = config.env.clone();
    if let Some(device) = device {
        environment.entry(DEVICE_VARIABLE.to_owned()).or_insert_with(|| device.to_owned());
    }
    let length = SOURCE.len().to_string();
    // The worker does not read the last argument: it shows the object in lists of processes.
    let arguments = ["-c", BOOTSTRAP, &length, &config.object].map(OsString::from).to_vec();
    Ok(Launch {
        name,
        stderr_log: StderrLog::Python,
        program: python(config)?.into_os_string(),
        arguments,
        folder,
        environment,
        inherited_file: None,
    })
}

/// Checks everything that can be checked without running custom code: the name, the folder, the interpreter, and
/// whether the interpreter finds the top-level package of the module.
///
/// # Errors
/// The first failed check.
pub(super) fn check(config: &PythonConfig, clock: &SharedClock) -> Result<(), PythonError> {
    config.check()?;
    let (module, _) = config.module_and_path()?;
    let launch = launch(config, config.object.clone(), None)?;
    let module_folder = launch.folder.clone().unwrap_or_default();
    // To find a submodule, Python imports the packages that contain it, and these are custom code.
    let top_package = module.split('.').next().unwrap_or(module);
    // If the folder has the package, no interpreter is needed. The start of an interpreter takes tens of milliseconds.
    if module_folder.join(format!("{top_package}.py")).is_file() || module_folder.join(top_package).is_dir() {
        return Ok(());
    }
    let arguments = ["-c", FIND_MODULE, top_package].map(OsString::from).to_vec();
    let python = launch.program.to_string_lossy().into_owned();
    let start_error =
        |reason: String| PythonError::Start { object: config.object.clone(), python: python.clone(), reason };
    let search = Launch { arguments, ..launch };
    let mut process = Process::start(&search, clock).map_err(PythonError::Process)?;
    // The process writes nothing; reading waits for its end, within the time limit.
    match process.read_exact(1, clock.mono() + MODULE_SEARCH_TIMEOUT) {
        Err(ProcessError::ProcessEnd(end)) if end.is_success() => Ok(()),
        Err(ProcessError::ProcessEnd(end)) if end.status.and_then(|status| status.code()) == Some(1) => {
            let folder = if module_folder.as_os_str().is_empty() {
                env::current_dir().unwrap_or_default()
            } else {
                module_folder
            };
            Err(PythonError::NoModule { module: module.to_owned(), folder, python })
        }
        Err(error) => Err(start_error(error.to_string())),
        Ok(_) => Err(start_error("it wrote to its standard output at its start".to_owned())),
    }
}

/// Returns the configured folder, if it exists.
fn folder(config: &PythonConfig) -> Result<Option<PathBuf>, PythonError> {
    match &config.folder {
        Some(folder) if !Path::new(folder).is_dir() => Err(PythonError::Folder(folder.clone())),
        folder => Ok(folder.clone()),
    }
}
