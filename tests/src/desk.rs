//! Two machines on which a test types the command lines of the documents, word for word.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::network::{DATA, Host};
use crate::{Document, Network, Process, program, root};

/// Where the shipped files, which are for one machine, have the one that serves, and where it is here.
const SERVING: (&str, &str) = ("tcp://127.0.0.1:", "tcp://10.0.0.2:");

/// Where a package keeps things; here each machine has such a folder of its own.
const PACKAGED: [&str; 5] =
    ["/etc/", "/usr/lib/peernet", "/usr/share/peernet/", "/var/lib/peernet/", "/backup/"];

/// What of the checkout is there as it is.
const LINKED: [&str; 6] = [
    "deploy",
    "docs",
    "models/export_torchvision.py",
    "models/quality-control",
    "models/quality_control",
    "onnxruntime",
];

/// An edge and a cloud at the two ends of a cable, and a folder that is the checkout's root for both: the programs stand on
/// the path, models and examples are there, configurations are copied when a test asks for them.
#[derive(Debug)]
pub struct Desk {
    commands: &'static [&'static str],
    typed: RefCell<BTreeSet<String>>,
    folder: TempDir,
    network: Network,
}

impl Desk {
    /// The cloud's address, as the documents have it.
    pub const CLOUD: &str = "10.0.0.2";
    const EDGE: &str = "10.0.0.1";

    /// For a test that types these commands of the documents, all of them.
    ///
    /// # Panics
    /// As [`Network::direct`].
    pub fn new(commands: &'static [&'static str]) -> Self {
        Self::on(Network::direct(), commands)
    }

    /// For a test that types no command of the documents, with a third host on a cable of its own to the cloud.
    ///
    /// # Panics
    /// As [`Network::direct`].
    pub fn with_third_host() -> Self {
        Self::on(Network::direct().with_third_host(), &[])
    }

    fn on(network: Network, commands: &'static [&'static str]) -> Self {
        network.edge().also(DATA, Self::EDGE);
        network.cloud().also(DATA, Self::CLOUD);
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        let link = |name: &str, to: &Path| {
            let name = folder.path().join(name);
            std::fs::create_dir_all(name.parent().expect("it is in the folder")).expect("writable");
            symlink(to, name).expect("writable");
        };
        for name in LINKED {
            link(name, &root().join(name));
        }
        for name in ["peernet", "peernetd"] {
            link(&format!("bin/{name}"), &program(name));
            link(&format!("target/release/{name}"), &program(name));
        }
        link("bin/PEERNet", &program("peernet"));
        Self { commands, typed: RefCell::default(), folder, network }
    }

    /// The folder of both machines.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The machines and the cables between them.
    pub const fn network(&self) -> &Network {
        &self.network
    }

    /// Where samples come from.
    pub const fn edge(&self) -> &Host {
        self.network.edge()
    }

    /// Where they are computed on.
    pub const fn cloud(&self) -> &Host {
        self.network.cloud()
    }

    /// Writes a file.
    pub fn write(&self, name: &str, text: &str) {
        let path = self.folder().join(name);
        std::fs::create_dir_all(path.parent().expect("it is in the folder")).expect("writable");
        std::fs::write(path, text).expect("writable");
    }

    /// Copies a file of the checkout, in which the cloud is another machine, with further changes.
    ///
    /// # Panics
    /// When it is not there, or a change has nothing to change.
    pub fn copy(&self, name: &str, changes: &[(&str, &str)]) {
        let text = changed(&Document::read(name).text, changes);
        self.write(name, &replaced(&text, &[SERVING]));
    }

    /// Writes a machine's file, as a package would have installed it; with changes.
    ///
    /// # Panics
    /// When a change has nothing to change.
    pub fn install(&self, host: &Host, name: &str, text: &str, changes: &[(&str, &str)]) {
        self.write(&self.installed(host, name), &self.installed(host, &changed(text, changes)));
    }

    /// The folder that stands for the root of a machine's files.
    pub fn root_of(&self, host: &Host) -> PathBuf {
        self.folder().join(if host.address == self.edge().address { "edge" } else { "cloud" })
    }

    /// A text in which the folders of a package are those of a machine.
    fn installed(&self, host: &Host, text: &str) -> String {
        let root = self.root_of(host).display().to_string();
        PACKAGED.iter().fold(text.to_owned(), |text, place| {
            let mut parts = text.split(place);
            let first = parts.next().unwrap_or_default().to_owned();
            parts.fold(first, |before, after| {
                // `deploy/debian/etc/` is another folder than `/etc/`.
                let machine = if before.ends_with(char::is_alphanumeric) { "" } else { &root };
                format!("{before}{machine}{place}{after}")
            })
        })
    }

    /// Types a command where samples come from; what has to be different is changed first.
    ///
    /// # Panics
    /// When it is none of this test's commands, or a change has nothing to change.
    pub fn on_edge(&self, command: &str, changes: &[(&str, &str)]) -> Process {
        self.type_on(self.edge(), command, changes)
    }

    /// Types a command where samples are computed on.
    ///
    /// # Panics
    /// As [`on_edge`](Self::on_edge).
    pub fn on_cloud(&self, command: &str, changes: &[(&str, &str)]) -> Process {
        self.type_on(self.cloud(), command, changes)
    }

    /// Types a command on either.
    ///
    /// # Panics
    /// As [`on_edge`](Self::on_edge).
    pub fn type_on(&self, host: &Host, command: &str, changes: &[(&str, &str)]) -> Process {
        assert!(self.commands.contains(&command), "{command} is none of this test's commands");
        self.typed.borrow_mut().insert(command.to_owned());
        self.run_on(host, &self.installed(host, &changed(command, changes)))
    }

    /// Runs a line of a shell that no document shows.
    pub fn run_on(&self, host: &Host, line: &str) -> Process {
        let folder = self.folder().display();
        let path = format!("{folder}/bin:{}", std::env::var("PATH").unwrap_or_default());
        let state = format!("{folder}/state");
        // The scripts of the checkout leave nothing beside themselves.
        let environment = [("PATH", &*path), ("XDG_STATE_HOME", &state), ("PYTHONDONTWRITEBYTECODE", "1")];
        // In the shell's place, so that a signal reaches the program.
        host.start(Path::new("sh"), &["-c", &format!("exec {line}")], self.folder(), &environment)
    }

    /// Ends the test.
    ///
    /// # Panics
    /// When it did not type all its commands.
    pub fn finish(self) {
        let typed = self.typed.borrow();
        let missing: Vec<_> = self.commands.iter().filter(|command| !typed.contains(**command)).collect();
        assert!(missing.is_empty(), "never typed: {missing:#?}");
    }
}

fn replaced(text: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
}

/// The same, and each change must have something to change.
fn changed(text: &str, changes: &[(&str, &str)]) -> String {
    for (from, _) in changes {
        assert!(text.contains(from), "there is no {from:?} in {text}");
    }
    replaced(text, changes)
}
