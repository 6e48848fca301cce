//! `peernet`: PEERNet's command line.

use std::process::ExitCode;

fn main() -> ExitCode {
    peernetd::disable_library_telemetry();
    peernet_cli::main()
}
