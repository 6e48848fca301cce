//! `peernetd`: the daemon. A link to it named `peernet` is the command line.

use std::path::Path;
use std::process::ExitCode;

// Optimised builds link this program alone: linking is most of their time, and both programs contain the same crates.
fn main() -> ExitCode {
    peernetd::disable_library_telemetry();
    let called = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&called).file_name().and_then(|name| name.to_str());
    if name.is_some_and(|name| peernet_cli::NAMES.contains(&name)) {
        peernet_cli::main()
    } else {
        peernetd::main()
    }
}
