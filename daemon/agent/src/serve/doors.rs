//! What a serving host has open to its peers, before anyone comes in.

use std::sync::Arc;

use peernet_inference::ModelConfig;
use peernet_logger::Slug;
use peernet_networks::{Address, Listener, PeerClock};
use peernet_probes::Reflector;
use peernet_stream::HostClock;
use uuid::Uuid;

use super::reflector;
use crate::config::AgentConfig;
use crate::error::StartError;
use crate::host::Host;
use crate::link::ProbeSettings;

/// The name of the built-in model that `peernet calibrate` asks for.
const CALIBRATION: &str = "calibration";

/// The port for sessions, and the one for probes unless that is switched off.
#[derive(Debug)]
pub(crate) struct Doors {
    /// Tells this process from others behind the same address, and from those before it.
    pub(super) instance: u64,
    /// The name of the built-in model, if it is offered.
    pub(super) built_in: Option<Slug>,
    pub(super) listener: Listener,
    pub(super) reflector: Option<Reflector>,
}

impl Doors {
    /// Takes the ports, if the host is to serve.
    pub(crate) async fn open(
        config: &AgentConfig,
        probes: &ProbeSettings,
        host: &Host,
    ) -> Result<Option<Self>, StartError> {
        let Some(serve) = &config.serve else { return Ok(None) };
        let (session, clock) = (serve.session.clone(), Arc::clone(&host.clock));
        let listener = Listener::bind(serve.network, &serve.listen, session, host.id, clock).await?;
        let instance = Uuid::new_v4().as_u64_pair().0;
        let reflector = if config.probes.reflect {
            Some(reflector::bind(&serve.listen, &config.probes, probes, instance, &host.clock).await?)
        } else {
            None
        };
        let built_in = calibration(config).map(|model| model.name().clone());
        Ok(Some(Self { instance, built_in, listener, reflector }))
    }

    /// Where peers may ask for models, with the real port.
    pub(crate) const fn address(&self) -> &Address {
        self.listener.address()
    }

    /// The port at which probes are answered.
    pub(super) fn probes(&self) -> Option<u16> {
        self.reflector.as_ref().map(|reflector| reflector.address().port())
    }
}

/// The built-in model that answers with what it was given, unless it is not wanted or the name is taken.
pub(crate) fn calibration(config: &AgentConfig) -> Option<ModelConfig> {
    let wanted = config.serve.as_ref().is_some_and(|serve| serve.calibration);
    let name: Slug = CALIBRATION.parse().ok()?;
    let free = config.models.iter().all(|model| *model.name() != name);
    (wanted && free).then(|| ModelConfig::echo(name))
}

/// What peers are told of this host's clock.
pub(super) fn to_peers(clock: HostClock) -> PeerClock {
    let HostClock { discipline, text, epoch, rehearsal } = clock;
    PeerClock { epoch, discipline, text, rehearsal }
}
