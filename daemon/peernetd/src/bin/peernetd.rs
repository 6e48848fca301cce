//! `peernetd`: the daemon. If the program is started through a link named `peernet`, it is the command line.

use std::path::Path;
use std::process::ExitCode;

// This program contains the command line, too, so that an optimised build links one program instead of two. Linking
// takes most of such a build.
fn main() -> ExitCode {
    peernetd::disable_library_telemetry();
    let program_path = std::env::args_os().next().unwrap_or_default();
    let name = Path::new(&program_path).file_name().and_then(|name| name.to_str());
    if name.is_some_and(|name| peernet_cli::NAMES.contains(&name)) {
        peernet_cli::main()
    } else {
        peernetd::main()
    }
}
