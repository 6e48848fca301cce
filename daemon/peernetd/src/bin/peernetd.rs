//! `peernetd`: the daemon.

use std::process::ExitCode;

fn main() -> ExitCode {
    peernetd::main()
}
