//! Asking an aggregator's REST API.

use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use peernetd::exit::{Exit, Failure};
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// How long an answer may take.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Where to ask.
#[derive(Debug, clap::Args)]
pub(crate) struct Api {
    /// Address of the dashboard.
    #[arg(long, default_value = "http://127.0.0.1:8040", env = "PEERNET_URL")]
    url: String,
}

/// What a problem says of itself (RFC 9457).
#[derive(Debug, Deserialize)]
struct Problem {
    detail: String,
}

impl Api {
    /// The document at a path below the dashboard's address.
    ///
    /// # Errors
    /// When nobody answers there (69), or not with what was expected.
    pub(crate) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        self.ask(path).map_err(|error| Failure::new(Exit::Unavailable, error))
    }

    fn ask<T: DeserializeOwned>(&self, path: &str) -> anyhow::Result<T> {
        let config = ureq::Agent::config_builder().timeout_global(Some(TIMEOUT)).http_status_as_error(false);
        let agent: ureq::Agent = config.build().into();
        let url = format!("{}{path}", self.url.trim_end_matches('/'));
        let mut response = agent.get(&url).call().with_context(|| {
            format!(
                "cannot ask {url}; is an aggregator with a table [web] running there? give its address with --url"
            )
        })?;
        let text = response
            .body_mut()
            .read_to_string()
            .with_context(|| format!("cannot read the answer of {url}"))?;
        let status = response.status();
        if !status.is_success() {
            match serde_json::from_str::<Problem>(&text) {
                Ok(problem) => bail!("{url}: {}", problem.detail),
                Err(_) => bail!("{url} answers {status}; is it a dashboard of this version?"),
            }
        }
        serde_json::from_str(&text)
            .map_err(|error| anyhow!("{url} does not answer as this version expects: {error}"))
    }
}
