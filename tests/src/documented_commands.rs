//! Two machines on which a test executes the commands of the documents literally.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::network::{DATA_INTERFACE, Host};
use crate::{Document, Network, Process, program, root};

/// Address of the cloud in the shipped files, which are for one machine, and the address that replaces it here.
const CLOUD_ADDRESS_CHANGE: (&str, &str) = ("tcp://127.0.0.1:", "tcp://10.0.0.2:");

/// Folders in which a package installs files. Here they are below a folder for each machine.
const PACKAGE_FOLDERS: [&str; 5] =
    ["/etc/", "/usr/lib/peernet", "/usr/share/peernet/", "/var/lib/peernet/", "/backup/"];

/// Files and folders of the checkout that are linked unchanged.
const LINKED_PATHS: [&str; 6] = [
    "deploy",
    "docs",
    "models/export_torchvision.py",
    "models/quality-control",
    "models/quality_control",
    "onnxruntime",
];

/// Edge and cloud with a link between them, and a folder that both see as the root of the checkout. The programs are on
/// the path, and models and examples are present. A test copies the configurations that it needs.
#[derive(Debug)]
pub struct DocumentedCommands {
    commands: &'static [&'static str],
    executed: RefCell<BTreeSet<String>>,
    folder: TempDir,
    network: Network,
}

impl DocumentedCommands {
    /// Address of the cloud, as in the documents.
    pub const CLOUD_ADDRESS: &str = "10.0.0.2";
    const EDGE_ADDRESS: &str = "10.0.0.1";

    /// Creates the machines for a test that executes each of `commands`, which are from the documents.
    ///
    /// # Panics
    /// As [`Network::direct`].
    pub fn new(commands: &'static [&'static str]) -> Self {
        Self::with_network(Network::direct(), commands)
    }

    /// Creates the machines for a test that executes no command of the documents, with a third host on a separate
    /// cable to the cloud.
    ///
    /// # Panics
    /// As [`Network::direct`].
    pub fn with_third_host() -> Self {
        Self::with_network(Network::direct().with_third_host(), &[])
    }

    fn with_network(network: Network, commands: &'static [&'static str]) -> Self {
        network.edge().add_address(DATA_INTERFACE, Self::EDGE_ADDRESS);
        network.cloud().add_address(DATA_INTERFACE, Self::CLOUD_ADDRESS);
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        let link = |name: &str, target: &Path| {
            let name = folder.path().join(name);
            std::fs::create_dir_all(name.parent().expect("the path has a parent")).expect("writable");
            symlink(target, name).expect("writable");
        };
        for name in LINKED_PATHS {
            link(name, &root().join(name));
        }
        for name in ["peernet", "peernetd"] {
            link(&format!("bin/{name}"), &program(name));
            link(&format!("target/release/{name}"), &program(name));
            link(&format!("target/demo/{name}"), &program(name));
        }
        link("bin/PEERNet", &program("peernet"));
        Self { commands, executed: RefCell::default(), folder, network }
    }

    /// Returns the folder that both machines share.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the machines and the cables between them.
    pub const fn network(&self) -> &Network {
        &self.network
    }

    /// Returns the edge.
    pub const fn edge(&self) -> &Host {
        self.network.edge()
    }

    /// Returns the cloud.
    pub const fn cloud(&self) -> &Host {
        self.network.cloud()
    }

    /// Writes a file.
    pub fn write(&self, name: &str, text: &str) {
        let path = self.folder().join(name);
        std::fs::create_dir_all(path.parent().expect("the path has a parent")).expect("writable");
        std::fs::write(path, text).expect("writable");
    }

    /// Copies a file of the checkout with changes; the cloud's address is replaced.
    ///
    /// # Panics
    /// If the file does not exist, or if a change does not apply.
    pub fn copy(&self, name: &str, changes: &[(&str, &str)]) {
        let text = apply_changes(&Document::read(name).text, changes);
        self.write(name, &replace_all(&text, &[CLOUD_ADDRESS_CHANGE]));
    }

    /// Writes a file of one machine where a package would install it, with changes.
    ///
    /// # Panics
    /// If a change does not apply.
    pub fn install(&self, host: &Host, name: &str, text: &str, changes: &[(&str, &str)]) {
        self.write(
            &self.with_machine_paths(host, name),
            &self.with_machine_paths(host, &apply_changes(text, changes)),
        );
    }

    /// Returns the folder that stands for the root of a machine's files.
    pub fn root_of(&self, host: &Host) -> PathBuf {
        self.folder().join(if host.address == self.edge().address { "edge" } else { "cloud" })
    }

    /// Replaces the folders of a package in a text by the folders of a machine.
    fn with_machine_paths(&self, host: &Host, text: &str) -> String {
        let root = self.root_of(host).display().to_string();
        PACKAGE_FOLDERS.iter().fold(text.to_owned(), |text, package_folder| {
            let mut parts = text.split(package_folder);
            let first = parts.next().unwrap_or_default().to_owned();
            parts.fold(first, |before, after| {
                // `deploy/debian/etc/` is another folder than `/etc/`.
                let machine = if before.ends_with(char::is_alphanumeric) { "" } else { &root };
                format!("{before}{machine}{package_folder}{after}")
            })
        })
    }

    /// Executes a command on the edge, after these changes to its text.
    ///
    /// # Panics
    /// If the command is not one of this test's commands, or if a change does not apply.
    pub fn on_edge(&self, command: &str, changes: &[(&str, &str)]) -> Process {
        self.execute_on(self.edge(), command, changes)
    }

    /// Executes a command on the cloud, after these changes to its text.
    ///
    /// # Panics
    /// As [`on_edge`](Self::on_edge).
    pub fn on_cloud(&self, command: &str, changes: &[(&str, &str)]) -> Process {
        self.execute_on(self.cloud(), command, changes)
    }

    /// Executes a command on a host, after these changes to its text.
    ///
    /// # Panics
    /// As [`on_edge`](Self::on_edge).
    pub fn execute_on(&self, host: &Host, command: &str, changes: &[(&str, &str)]) -> Process {
        assert!(self.commands.contains(&command), "{command} is not one of this test's commands");
        self.executed.borrow_mut().insert(command.to_owned());
        self.run_on(host, &self.with_machine_paths(host, &apply_changes(command, changes)))
    }

    /// Executes a shell command that is not in the documents.
    pub fn run_on(&self, host: &Host, line: &str) -> Process {
        let folder = self.folder().display();
        let path = format!("{folder}/bin:{}", std::env::var("PATH").unwrap_or_default());
        let state = format!("{folder}/state");
        // The scripts of the checkout must not write byte code into the checkout.
        let environment = [("PATH", &*path), ("XDG_STATE_HOME", &state), ("PYTHONDONTWRITEBYTECODE", "1")];
        // The program replaces the shell, so that a signal reaches the program.
        host.start(Path::new("sh"), &["-c", &format!("exec {line}")], self.folder(), &environment)
    }

    /// Ends the test.
    ///
    /// # Panics
    /// If a command of the test was not executed.
    pub fn finish(self) {
        let executed = self.executed.borrow();
        let missing: Vec<_> = self.commands.iter().filter(|command| !executed.contains(**command)).collect();
        assert!(missing.is_empty(), "the test did not execute: {missing:#?}");
    }
}

fn replace_all(text: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
}

/// Replaces texts, each of which must occur.
fn apply_changes(text: &str, changes: &[(&str, &str)]) -> String {
    for (from, _) in changes {
        assert!(text.contains(from), "{from:?} does not occur in {text}");
    }
    replace_all(text, changes)
}
