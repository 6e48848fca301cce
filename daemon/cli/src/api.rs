//! Requests to an aggregator's REST API.

use std::time::Duration;

use crate::exit::{Exit, Failure};
use anyhow::{Context, anyhow, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::foreground::long_duration;

/// Time limit for stored answers, from the lookup of the host's name to the last byte.
const STORED_TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit for answers that the aggregator has to compute.
const COMPUTED_TIMEOUT: Duration = Duration::from_secs(60);

/// Address of the API.
#[derive(Debug, clap::Args)]
pub(crate) struct Api {
    /// Address of the dashboard.
    #[arg(long, default_value = "http://127.0.0.1:8040", env = "PEERNET_URL")]
    url: String,
}

/// Body of an error answer (problem+json, RFC 9457).
#[derive(Debug, Deserialize)]
struct Problem {
    detail: String,
}

impl Api {
    /// Requests the document at a path below the dashboard's address.
    ///
    /// # Errors
    /// When no server answers, or the answer does not have the expected form (exit code 69).
    pub(crate) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        self.request(path, STORED_TIMEOUT).map_err(|error| Failure::new(Exit::Unavailable, error))
    }

    /// Requests a document like [`Self::get`], with a longer timeout because the aggregator computes the document.
    ///
    /// # Errors
    /// The same as for [`Self::get`].
    pub(crate) fn get_computed<T: DeserializeOwned>(&self, path: &str) -> Result<T, Failure> {
        self.request(path, COMPUTED_TIMEOUT).map_err(|error| Failure::new(Exit::Unavailable, error))
    }

    fn request<T: DeserializeOwned>(&self, path: &str, timeout: Duration) -> anyhow::Result<T> {
        // The body of an error answer says what is wrong, so it is read like that of any answer.
        let config = ureq::Agent::config_builder().timeout_global(Some(timeout)).http_status_as_error(false);
        let agent: ureq::Agent = config.build().into();
        let url = format!("{}{path}", self.url.trim_end_matches('/'));
        let describe = |error: ureq::Error| match error {
            ureq::Error::Timeout(_) => {
                anyhow!("no complete answer within {}", long_duration(timeout.as_secs_f64()))
            }
            // The library's text of this error begins with "io: ", so only the cause is kept.
            ureq::Error::Io(error) => error.into(),
            error => error.into(),
        };
        let mut response = agent.get(&url).call().map_err(|error| {
            let cause = describe(error);
            anyhow!(
                "cannot reach {url}: {cause}; start an aggregator with a table [web] there (`peernetd run FILE`), or give the \
                 address of another dashboard with --url"
            )
        })?;
        let text = response
            .body_mut()
            .read_to_string()
            .map_err(describe)
            .with_context(|| format!("cannot read the answer of {url}"))?;
        let status = response.status();
        if !status.is_success() {
            match serde_json::from_str::<Problem>(&text) {
                Ok(problem) => bail!("{url}: {}", problem.detail),
                Err(_) => bail!("{url} answers {status}; does a dashboard of this version run there?"),
            }
        }
        serde_json::from_str(&text)
            .map_err(|error| anyhow!("{url} does not answer as this version expects: {error}"))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn endless_headers_are_read_until_timeout() {
        let server = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
        let url = format!("http://{}", server.local_addr().expect("bound"));
        let answering = std::thread::spawn(move || {
            let (mut peer, _) = server.accept().expect("the client connects");
            let header_lines =
                std::iter::once("HTTP/1.1 200 OK\r\n").chain(std::iter::repeat("X-More: 1\r\n"));
            // Sends until the client has gone.
            for text in header_lines {
                if peer.write_all(text.as_bytes()).is_err() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        let error = Api { url }
            .request::<()>("/x", Duration::from_millis(300))
            .expect_err("the answer is never complete");
        answering.join().expect("no panic");
        assert!(format!("{error:#}").contains("no complete answer within 0.3 s"), "{error:#}");
    }

    #[test]
    fn silent_server_is_waited_for_until_timeout() {
        // The operating system accepts the connection, but no program answers.
        let server = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
        let url = format!("http://{}", server.local_addr().expect("bound"));
        let error = Api { url }
            .request::<()>("/x", Duration::from_millis(300))
            .expect_err("the answer is never complete");
        let message = format!("{error:#}");
        assert!(message.starts_with("cannot reach") && message.contains("within 0.3 s"), "{message}");
    }
}
