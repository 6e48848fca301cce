//! The REST API, asked as a program would.

use serde_json::Value;

use crate::process::until;

/// A client of one aggregator.
#[derive(Clone, Debug)]
pub struct Api {
    base: String,
    agent: ureq::Agent,
}

impl Api {
    /// A client for the aggregator's web port on this machine.
    pub fn at(port: u16) -> Self {
        let agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
        Self { base: format!("http://127.0.0.1:{port}"), agent }
    }

    /// Status and text of a page; `None` when nobody answers.
    pub fn get(&self, path: &str) -> Option<(u16, String)> {
        let mut response = self.agent.get(format!("{}{path}", self.base)).call().ok()?;
        let text = response.body_mut().read_to_string().ok()?;
        Some((response.status().as_u16(), text))
    }

    /// The document at a path.
    ///
    /// # Panics
    /// When it cannot be had.
    pub fn json(&self, path: &str) -> Value {
        let (status, text) =
            self.get(path).unwrap_or_else(|| panic!("nobody answers at {}{path}", self.base));
        assert_eq!(status, 200, "{path}: {text}");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{path} is no JSON ({error}): {text}"))
    }

    /// Asks for a document until `holds` finds in it what it looks for.
    ///
    /// # Panics
    /// When that takes longer than [`crate::PATIENCE`].
    pub fn until<T>(&self, path: &str, mut holds: impl FnMut(&Value) -> Option<T>) -> T {
        until(path, || {
            let (status, text) = self.get(path)?;
            if status != 200 {
                return None;
            }
            holds(&serde_json::from_str(&text).ok()?)
        })
    }
}
