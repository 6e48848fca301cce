//! What pipelines need of the rest of the agent.

use std::sync::Arc;

use peernet_external::exec::FingerprintKey;
use peernet_inference::Bank;

use crate::conditions::InspectionSettings;
use crate::host::{EventSinks, Host};
use crate::link::Links;
use crate::observed::ObservedPipelines;

/// What pipelines need of the rest of the agent.
#[derive(Clone, Debug)]
pub(crate) struct PipelineContext {
    pub(crate) host: Host,
    pub(crate) events: EventSinks,
    /// This host's models.
    pub(crate) bank: Arc<Bank>,
    pub(crate) links: Links,
    /// What peers can ask about this host's pipelines that observe.
    pub(crate) observed: ObservedPipelines,
    /// Key of the fingerprints of programs' arguments.
    pub(crate) fingerprints: FingerprintKey,
    /// Paths in /proc and /sys that show what can disturb a run.
    pub(crate) inspection: Arc<InspectionSettings>,
}
