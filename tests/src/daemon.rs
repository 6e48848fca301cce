//! A `peernetd` that is started several times.

use peernet_clock::Span;

use crate::{FalseTime, LoopbackDeployment, Process, ProcessEnd, SpooledIterations};

/// A configuration file with the process that runs it, and data from the logs of earlier processes.
#[derive(Debug)]
pub struct Daemon {
    /// Name of the daemon; the file is `NAME.toml`.
    pub name: String,
    configuration: String,
    process: Option<Process>,
    /// False wall clock that the process sees; `None` for the kernel's.
    false_time: Option<FalseTime>,
    spooled: Vec<SpooledIterations>,
}

impl Daemon {
    /// Writes the configuration; the process is not started.
    pub fn new(deployment: &LoopbackDeployment, name: &str, configuration: &str) -> Self {
        let (name, spooled) = (name.to_owned(), Vec::new());
        let mut daemon =
            Self { name, configuration: String::new(), process: None, false_time: None, spooled };
        daemon.configure(deployment, configuration);
        daemon
    }

    /// Writes the configuration and starts the process.
    pub fn start_new(deployment: &LoopbackDeployment, name: &str, configuration: &str) -> Self {
        let mut daemon = Self::new(deployment, name, configuration);
        daemon.start(deployment);
        daemon
    }

    /// Writes another configuration for the next start.
    pub fn configure(&mut self, deployment: &LoopbackDeployment, configuration: &str) {
        self.configuration = configuration.replace("NAME", &self.name);
        deployment.write(&self.file(), &self.configuration);
    }

    /// Starts the process without its pipelines, so that an agent measures nothing.
    ///
    /// # Panics
    /// If it is already running.
    pub fn start_without_pipelines(&mut self, deployment: &LoopbackDeployment) {
        // All tables from the first pipeline on are left out.
        let (idle, _) = self.configuration.split_once("[[pipeline]]").unwrap_or((&self.configuration, ""));
        let file = format!("{}-idle.toml", self.name);
        deployment.write(&file, idle);
        self.start_from(deployment, &file);
    }

    fn file(&self) -> String {
        format!("{}.toml", self.name)
    }

    /// Starts the process.
    ///
    /// # Panics
    /// If it is already running.
    pub fn start(&mut self, deployment: &LoopbackDeployment) {
        self.start_from(deployment, &self.file());
    }

    fn start_from(&mut self, deployment: &LoopbackDeployment, file: &str) {
        assert!(self.process.is_none(), "{} is already running", self.name);
        let environment = self.false_time.as_ref().map(FalseTime::environment);
        self.process = Some(
            deployment.start_with(file, environment.as_ref().map_or(&[], |environment| &environment[..])),
        );
    }

    /// Shows the process a wall clock that is `ahead` of the kernel's. A process that was started with a
    /// false clock sees the change within a second. Any other process sees it from its next start on.
    pub fn show_time(&mut self, deployment: &LoopbackDeployment, ahead: Span) {
        match &self.false_time {
            Some(false_time) => false_time.show(ahead),
            None => {
                self.false_time =
                    Some(FalseTime::new(&deployment.folder().join(format!("{}-time", self.name)), ahead));
            }
        }
    }

    /// Waits until the process is ready. If it exits with an error instead, restarts it once, as a service manager does.
    /// Returns whether it was restarted.
    ///
    /// # Panics
    /// If the process ends without an error, or if the second process ends as well.
    pub fn restart_if_start_failed(&mut self, deployment: &LoopbackDeployment) -> bool {
        if self.process().logs_before_end("ready") {
            return false;
        }
        let end = self.take_process().wait_for_end();
        let failed = end.status.code().is_some_and(|code| code != 0);
        assert!(failed, "{} ended with {}:\n{}", self.name, end.status, end.log);
        self.record_spooled(&end);
        self.start(deployment);
        self.process().wait_for("ready");
        true
    }

    /// Returns whether the process was started and neither stopped nor killed.
    pub fn is_running(&self) -> bool {
        self.process.is_some()
    }

    /// Returns the process.
    ///
    /// # Panics
    /// If it is not running.
    pub fn process(&self) -> &Process {
        self.process.as_ref().unwrap_or_else(|| panic!("{} is not running", self.name))
    }

    /// Kills the process with SIGKILL and waits for its end.
    pub fn kill(&mut self) -> ProcessEnd {
        let end = self.take_process().kill();
        self.record_spooled(&end);
        end
    }

    /// Stops the process with SIGTERM.
    ///
    /// # Panics
    /// If its exit code is not 0.
    pub fn stop(&mut self) -> ProcessEnd {
        // The process handles signals only after it is ready.
        self.process().wait_for("ready");
        let end = self.take_process().stop();
        assert_eq!(end.code(), 0, "{}:\n{}", self.name, end.log);
        self.record_spooled(&end);
        end
    }

    fn take_process(&mut self) -> Process {
        self.process.take().unwrap_or_else(|| panic!("{} is not running", self.name))
    }

    fn record_spooled(&mut self, end: &ProcessEnd) {
        self.spooled.extend(SpooledIterations::parse_log(&end.log));
    }

    /// Returns the spooled iterations in the logs of the processes that have ended.
    pub fn spooled_iterations(&self) -> &[SpooledIterations] {
        &self.spooled
    }

    /// Returns the spooled iterations in the logs of all processes, including the running process.
    pub fn all_spooled_iterations(&self) -> Vec<SpooledIterations> {
        let current = self
            .process
            .as_ref()
            .map(|process| SpooledIterations::parse_log(&process.log()))
            .unwrap_or_default();
        self.spooled.iter().cloned().chain(current).collect()
    }
}
