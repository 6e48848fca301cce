//! A reflector to probe, and the task that probes it.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_clock::RelatedClocks;
use peernet_logger::Slug;
use peernet_probes::{Key, OpenError, ProbeResult, Prober, ProberConfig};
use peernet_stream::Probing;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::probe_pace::ProbePace;
use super::shared::{SharedLinkState, lock};

/// Time after which a probe without an answer is lost.
const TIMEOUT: Duration = Duration::from_secs(2);
/// Pause before a failed prober is opened again.
const RETRY_INTERVAL: Duration = Duration::from_secs(10);
/// Capacity of the channel of results, which are received without delay.
pub(super) const RESULT_CAPACITY: usize = 64;

/// A reflector, and the condition under which its answers are accepted.
#[derive(Clone, Debug)]
pub(super) struct ProbeTarget {
    /// Name of the cloud, for the log.
    pub(super) peer: Slug,
    pub(super) host: String,
    pub(super) port: u16,
    pub(super) key: Option<Key>,
    /// Random number of the process that must answer; `None` if any process may answer.
    pub(super) instance: Option<u64>,
    pub(super) clocks: RelatedClocks,
}

/// Reason why a reflector is not probed.
#[derive(Debug, thiserror::Error)]
enum ProbingError {
    #[error("this host sends no probes: [probes] send = false")]
    NotSent,
    #[error("cannot resolve {host}: {source}")]
    Lookup { host: String, source: io::Error },
    #[error("cannot resolve {host}: the name has no address")]
    NoAddress { host: String },
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error("the prober ended unexpectedly")]
    Ended,
}

impl ProbeTarget {
    /// Probes at the link's pace as long as the future is polled. Writes the state, or the reason why no probes are
    /// sent, to `state`.
    pub(super) async fn probe(
        &self,
        shared: &SharedLinkState,
        pace: &ProbePace,
        state: &Mutex<Probing>,
        results: mpsc::Sender<ProbeResult>,
    ) -> Infallible {
        if !shared.probes.send {
            *lock(state) = Probing::Off(ProbingError::NotSent.to_string());
            return std::future::pending().await;
        }
        loop {
            match self.open(shared).await {
                Ok((prober, target)) => {
                    let stamps = prober.stamp_source_name().to_owned();
                    let address = format!("udp://{target}");
                    *lock(state) = Probing::On { address, rate_hz: pace.rate_hz(), stamps };
                    prober.run(pace.subscribe(), results.clone(), CancellationToken::new()).await;
                    *lock(state) = Probing::Off(ProbingError::Ended.to_string());
                }
                Err(error) => {
                    tracing::warn!(peer = %self.peer, "cannot send probes: {error}");
                    *lock(state) = Probing::Off(error.to_string());
                }
            }
            tokio::time::sleep(RETRY_INTERVAL).await;
        }
    }

    /// Resolves the host and opens a prober. Also returns the address that is probed.
    async fn open(&self, shared: &SharedLinkState) -> Result<(Prober, SocketAddr), ProbingError> {
        let host = &self.host;
        let lookup_result = tokio::net::lookup_host((host.as_str(), self.port)).await;
        let mut addresses =
            lookup_result.map_err(|source| ProbingError::Lookup { host: host.clone(), source })?;
        let target = addresses.next().ok_or_else(|| ProbingError::NoAddress { host: host.clone() })?;
        let config = ProberConfig {
            target,
            key: self.key.clone(),
            instance: self.instance,
            clocks: self.clocks,
            padding_bytes: shared.probes.padding_bytes,
            stamps: shared.probes.stamps,
            timeout: TIMEOUT,
        };
        let mut prober = Prober::open(config, Arc::clone(&shared.host.clock))?;
        prober.check_stamps().await;
        Ok((prober, target))
    }
}
