//! `peernet`: PEERNet's command line.

use std::process::ExitCode;

fn main() -> ExitCode {
    peernet_cli::main()
}
