//! What all parts of the agent share.

use std::sync::Arc;

use peernet_clock::SharedClock;
use peernet_external::exec::FingerprintKey;
use peernet_inference::Bank;
use peernet_logger::{HostId, Slug};
use peernet_stream::HostClock;
use tokio::sync::watch;

use crate::conditions::Places;
use crate::feed::Feed;
use crate::incidents::Incidents;
use crate::link::Links;
use crate::runs::Runs;

/// This host as its own parts see it.
#[derive(Clone, Debug)]
pub(crate) struct Host {
    pub(crate) id: HostId,
    pub(crate) name: Slug,
    /// The program's version, as peers and the aggregator are told.
    pub(crate) version: &'static str,
    pub(crate) clock: SharedClock,
    pub(crate) bank: Arc<Bank>,
    /// Key of the fingerprints of programs' arguments.
    pub(crate) fingerprints: FingerprintKey,
    pub(crate) feed: Feed,
    pub(crate) incidents: Incidents,
    pub(crate) runs: Runs,
    /// What is known of this host's own clock.
    pub(crate) own: watch::Receiver<HostClock>,
    pub(crate) links: Links,
    /// Paths in /proc and /sys that show what can disturb a run.
    pub(crate) places: Arc<Places>,
}
