//! Asking an aggregator's REST API.

use std::time::Duration;

use anyhow::{Context, anyhow};
use peernetd::exit::{Exit, Failure};
use serde::de::DeserializeOwned;

/// How long an answer may take.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The document at a path below the dashboard's address.
///
/// # Errors
/// When nobody answers there (69), or not with what was expected.
pub(crate) fn get<T: DeserializeOwned>(url: &str, path: &str) -> Result<T, Failure> {
    ask(url, path).map_err(|error| Failure::new(Exit::Unavailable, error))
}

fn ask<T: DeserializeOwned>(url: &str, path: &str) -> anyhow::Result<T> {
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(TIMEOUT)).build().into();
    let url = format!("{}{path}", url.trim_end_matches('/'));
    let mut response = agent.get(&url).call().with_context(|| {
        format!(
            "cannot ask {url}; is an aggregator with a table [web] running there? give its address with --url"
        )
    })?;
    let text =
        response.body_mut().read_to_string().with_context(|| format!("cannot read the answer of {url}"))?;
    serde_json::from_str(&text)
        .map_err(|error| anyhow!("{url} does not answer as this version expects: {error}"))
}
