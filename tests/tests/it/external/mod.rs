//! Tests of programs as sensors, models and actuators of real agents. The documents' example programs
//! are among them: a sensor in shell, a model in C, an actuator in shell.

mod failing;
mod one_agent;
mod secrets;
mod talkative;
mod two_agents;

use std::path::Path;
use std::process::Command;

use peernet_tests::root;

/// Builds the model in C into a folder, with the command in its first lines.
pub(crate) fn build_example(folder: &Path) {
    let source = root().join("docs/examples/external/brightness.c");
    let program = folder.join("brightness");
    let compiler_output =
        Command::new("cc").args(["-O2", "-Wall", "-Werror", "-o"]).arg(&program).arg(source).output();
    let compiler_output = compiler_output.expect("a C compiler is there: apt-get install gcc");
    assert!(compiler_output.status.success(), "{}", String::from_utf8_lossy(&compiler_output.stderr));
}
