//! Real chronyd processes that do not change the machine's clock.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use peernet_test_ports::free_port;

use crate::config::{ClaimSource, ClockConfig};

/// Returns the path of a program of chrony: from the package that `deploy/install-tools.sh test` unpacks, or of the
/// system.
fn program(name: &str) -> PathBuf {
    let tools = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.venv-tools/chrony/usr");
    let folders = [tools.join("sbin"), tools.join("bin"), "/usr/sbin".into(), "/usr/bin".into()];
    let path = folders.iter().map(|folder| folder.join(name)).find(|path| path.exists());
    path.unwrap_or_else(|| panic!("{name} is missing: run `deploy/install-tools.sh test`"))
}

/// A chronyd with separate files, killed at the end of the test.
pub(super) struct Chronyd {
    child: Child,
    folder: tempfile::TempDir,
    ntp_port: u16,
    command_port: u16,
}

impl Chronyd {
    /// Starts a server that follows only its own clock.
    pub(super) fn server() -> Self {
        Self::start("local stratum 10\nallow 127.0.0.1\n", free_port())
    }

    /// Starts a client of `server`. The client corrects its measurements of the server by `offset_s`.
    pub(super) fn client(server: &Self, offset_s: f64) -> Self {
        let line = format!(
            "server 127.0.0.1 port {} iburst minpoll -2 maxpoll 0 offset {offset_s}\n",
            server.ntp_port
        );
        let client = Self::start(&line, 0);
        let mut command = client.chronyc();
        // Right after its first measurement chrony reports an unbounded rate. This waits, in steps of 0.1 s, until
        // the rate is known to 100 ppm.
        let output = command.args(["waitsync", "600", "0", "100", "0.1"]).output().expect("chronyc runs");
        assert!(output.status.success(), "not synchronised within a minute:\n{}", client.log());
        client
    }

    /// Starts a daemon without a server.
    pub(super) fn without_server() -> Self {
        let mut daemon = Self::start("", 0);
        // The loop needs no pause, because each run of chronyc takes a while.
        while !daemon.answers() {
            let status = daemon.child.try_wait().expect("it is our child");
            assert_eq!(status, None, "chronyd ended:\n{}", daemon.log());
        }
        daemon
    }

    fn start(lines: &str, ntp_port: u16) -> Self {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let command_port = free_port();
        let path = |name: &str| folder.path().join(name).display().to_string();
        // `bindcmdaddress /` disables the Unix socket for commands.
        let configuration = format!(
            "{lines}port {ntp_port}\nbindaddress 127.0.0.1\ncmdport {command_port}\nbindcmdaddress /\n\
             bindcmdaddress 127.0.0.1\npidfile {}\n",
            path("pid")
        );
        std::fs::write(path("conf"), configuration).expect("the temporary folder is writable");
        let log = std::fs::File::create(path("log")).expect("the temporary folder is writable");
        let user = Command::new("id").arg("-un").output().expect("id runs").stdout;
        // -x does not touch the clock, -U needs no privilege.
        let child = Command::new(program("chronyd"))
            .args(["-x", "-d", "-U", "-u", String::from_utf8_lossy(&user).trim(), "-f", &path("conf")])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("chronyd starts");
        Self { child, folder, ntp_port, command_port }
    }

    /// Returns the configuration of an agent that queries only this chronyd.
    pub(super) fn clock_config(&self) -> ClockConfig {
        ClockConfig {
            discipline: vec![ClaimSource::Chrony],
            discipline_interval_s: 0.1,
            chronyc: program("chronyc").display().to_string(),
            chronyc_arguments: self.arguments(),
            ..ClockConfig::default()
        }
    }

    /// Kills the daemon.
    pub(super) fn kill(&mut self) {
        self.child.kill().expect("it was running");
        self.child.wait().expect("it is our child");
    }

    fn arguments(&self) -> Vec<String> {
        ["-h", "127.0.0.1", "-p"]
            .into_iter()
            .map(str::to_owned)
            .chain([self.command_port.to_string()])
            .collect()
    }

    fn chronyc(&self) -> Command {
        let mut command = Command::new(program("chronyc"));
        command.args(self.arguments()).arg("-n");
        command
    }

    fn answers(&self) -> bool {
        self.chronyc().arg("tracking").output().expect("chronyc runs").status.success()
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }
}

impl Drop for Chronyd {
    fn drop(&mut self) {
        // The daemon may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
