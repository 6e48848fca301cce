//! What a serving host has open to its peers, before anyone comes in.

use peernet_inference::ModelConfig;
use peernet_logger::Slug;
use peernet_networks::{Address, Listener, ProbeKey};
use peernet_probes::{Key, Reflector};
use uuid::Uuid;

use super::reflector;
use crate::config::AgentConfig;
use crate::error::StartError;
use crate::host::Host;
use crate::link::ProbeSettings;

/// The name of the built-in model that `peernet calibrate` asks for.
const CALIBRATION: &str = "calibration";

/// The ports for sessions, and those for probes unless that is switched off.
#[derive(Debug)]
pub(crate) struct ServeEndpoints {
    /// Tells this process from others behind the same address, and from those before it.
    pub(super) instance: u64,
    /// What peers are given with their session to authenticate probes, unless a key of this host's own is configured.
    pub(super) probe_key: Option<ProbeKey>,
    /// The name of the built-in model, if it is offered.
    pub(super) built_in: Option<Slug>,
    /// One for each address of `[serve] listen`, in that order.
    pub(super) listeners: Vec<Listener>,
    /// One for each of these machine's addresses that peers know.
    pub(super) reflectors: Vec<Reflector>,
    /// The port at which the probes of a listener's peers are answered, for each listener.
    pub(super) probes: Vec<Option<u16>>,
}

impl ServeEndpoints {
    /// Takes the ports, if the host is to serve.
    pub(crate) async fn open(
        config: &AgentConfig,
        probes: &ProbeSettings,
        host: &Host,
    ) -> Result<Option<Self>, StartError> {
        let Some(serve) = &config.serve else { return Ok(None) };
        let listen = serve.listen.all();
        let listeners = Listener::bind_all(listen, &serve.session, host.id, &host.clock).await?;
        let instance = Uuid::new_v4().as_u64_pair().0;
        let offers_key = config.probes.reflect && probes.key.is_none();
        let probe_key = offers_key.then(|| ProbeKey::new(Key::random_bytes()));
        let (reflectors, probes) = if config.probes.reflect {
            let asked = reflector::Answering { settings: probes, instance, session_key: probe_key };
            reflector::bind_all(listen, &config.probes, asked, &host.clock).await?
        } else {
            (Vec::new(), vec![None; listeners.len()])
        };
        let built_in = calibration(config).map(|model| model.name().clone());
        Ok(Some(Self { instance, probe_key, built_in, listeners, reflectors, probes }))
    }

    /// Where peers may ask for models, with the real ports.
    pub(crate) fn addresses(&self) -> Vec<Address> {
        self.listeners.iter().map(|listener| listener.address().clone()).collect()
    }
}

/// The built-in model that answers with what it was given, unless it is not wanted or the name is taken.
pub(crate) fn calibration(config: &AgentConfig) -> Option<ModelConfig> {
    let wanted = config.serve.as_ref().is_some_and(|serve| serve.calibration);
    let name: Slug = CALIBRATION.parse().ok()?;
    let free = config.models.iter().all(|model| *model.name() != name);
    (wanted && free).then(|| ModelConfig::echo(name))
}
