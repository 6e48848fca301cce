//! Client of the REST API.

use serde_json::Value;

use crate::process::wait_until;

/// Client of the REST API of one aggregator.
#[derive(Clone, Debug)]
pub struct Api {
    base: String,
    agent: ureq::Agent,
}

impl Api {
    /// Creates a client for an aggregator's web port on this machine.
    pub fn on_port(port: u16) -> Self {
        let agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
        Self { base: format!("http://127.0.0.1:{port}"), agent }
    }

    /// Requests a path. Returns the status and the text of the answer; `None` if there is no answer.
    pub fn get(&self, path: &str) -> Option<(u16, String)> {
        let mut response = self.agent.get(format!("{}{path}", self.base)).call().ok()?;
        let text = response.body_mut().read_to_string().ok()?;
        Some((response.status().as_u16(), text))
    }

    /// Returns the JSON document at a path.
    ///
    /// # Panics
    /// If there is no answer, the status is not 200, or the body is not JSON.
    pub fn json(&self, path: &str) -> Value {
        let (status, text) = self.get(path).unwrap_or_else(|| panic!("no answer from {}{path}", self.base));
        assert_eq!(status, 200, "{path}: {text}");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{path} is not JSON ({error}): {text}"))
    }

    /// Requests a document repeatedly until `condition` returns a value, and returns that value.
    ///
    /// # Panics
    /// If that takes longer than [`crate::TEST_TIMEOUT`].
    pub fn wait_until<T>(&self, path: &str, mut condition: impl FnMut(&Value) -> Option<T>) -> T {
        wait_until(path, || {
            let (status, text) = self.get(path)?;
            if status != 200 {
                return None;
            }
            condition(&serde_json::from_str(&text).ok()?)
        })
    }

    /// Waits until the newest run has finished its iterations, and returns its number.
    ///
    /// # Panics
    /// As [`wait_until`](Self::wait_until).
    pub fn wait_for_finished_run(&self) -> i64 {
        self.wait_until("/api/v1/runs", |runs| {
            let run = runs["runs"].get(0)?;
            (run["reason"] == "finished").then(|| run["number"].as_i64())?
        })
    }

    /// Returns the statistics of a stage or value of a run; `None` if the run has no node of that name.
    ///
    /// # Panics
    /// If the statistics cannot be read.
    pub fn stage_statistics(&self, run: i64, name: &str) -> Option<Value> {
        let stages = self.json(&format!("/api/v1/runs/{run}/stages"));
        stages["stages"].as_array()?.iter().find(|stage| stage["name"] == name).cloned()
    }

    /// Returns the mean of a stage or value of a run.
    ///
    /// # Panics
    /// If the run has no node of that name.
    pub fn mean(&self, run: i64, name: &str) -> f64 {
        let statistics = self.stage_statistics(run, name);
        let mean = statistics.and_then(|statistics| statistics["mean"].as_f64());
        mean.unwrap_or_else(|| panic!("run {run} has no mean of {name}"))
    }

    /// Asserts that the means of `stages` and the unattributed time add up to the total.
    ///
    /// # Panics
    /// If the sum differs from the total.
    pub fn assert_stages_sum_to_total(&self, run: i64, stages: &[&str]) {
        let names = stages.iter().chain(&["unattributed"]);
        let sum: f64 = names.map(|name| self.mean(run, name)).sum();
        let total = self.mean(run, "total");
        assert!((sum - total).abs() < 1e-9, "the stages of run {run} are {sum}, the total is {total}");
    }
}
