//! The parts of the agent that pipelines use.

use std::sync::Arc;

use peernet_external::exec::FingerprintKey;
use peernet_inference::Bank;

use crate::conditions::InspectionSettings;
use crate::host::{EventSinks, Host};
use crate::link::Links;
use crate::observed::ObservedPipelines;

/// The parts of the agent that pipelines use.
#[derive(Clone, Debug)]
pub(crate) struct PipelineContext {
    pub(crate) host: Host,
    pub(crate) events: EventSinks,
    /// Models of this host.
    pub(crate) bank: Arc<Bank>,
    pub(crate) links: Links,
    /// Stamps of the messages that this host's pipelines observe. Peers may query these stamps.
    pub(crate) observed: ObservedPipelines,
    /// Secret key for the fingerprint that stands for a program's arguments in the facts of a run.
    pub(crate) fingerprint_key: FingerprintKey,
    /// Settings of the inspection of this host's conditions before a run.
    pub(crate) inspection: Arc<InspectionSettings>,
}
