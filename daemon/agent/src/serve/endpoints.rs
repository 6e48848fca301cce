//! The open ports of a serving host.

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

/// Name of the built-in model that `peernet calibrate` uses.
const CALIBRATION: &str = "calibration";

/// Open ports for sessions, and open ports for probes unless probes are switched off.
#[derive(Debug)]
pub(crate) struct ServeEndpoints {
    /// Random number that distinguishes this process from earlier processes and from other processes behind the same
    /// address.
    pub(super) instance: u64,
    /// Key that is sent to peers with their session to authenticate probes; `None` if this host has a configured key.
    pub(super) probe_key: Option<ProbeKey>,
    /// Name of the built-in model, if it is offered.
    pub(super) built_in: Option<Slug>,
    /// Listeners for sessions, one for each address of `[serve] listen`, in that order.
    pub(super) listeners: Vec<Listener>,
    /// Reflectors of probes, one for each IP address of the listeners.
    pub(super) reflectors: Vec<Reflector>,
    /// UDP port for probes of each listener's peers; `None` if probes are not answered.
    pub(super) probe_ports: Vec<Option<u16>>,
}

impl ServeEndpoints {
    /// Opens the ports; returns `None` if the host does not serve.
    pub(crate) async fn open(
        config: &AgentConfig,
        probe_settings: &ProbeSettings,
        host: &Host,
    ) -> Result<Option<Self>, StartError> {
        let Some(serve) = &config.serve else { return Ok(None) };
        let listen = serve.listen.as_slice();
        let listeners = Listener::bind_all(listen, &serve.session, host.id, &host.clock).await?;
        let instance = Uuid::new_v4().as_u64_pair().0;
        let offers_key = config.probes.reflect && probe_settings.key.is_none();
        let probe_key = offers_key.then(|| ProbeKey::new(Key::random_bytes()));
        let (reflectors, probe_ports) = if config.probes.reflect {
            let reflector_settings =
                reflector::ReflectorSettings { probe_settings, instance, session_key: probe_key };
            reflector::bind_all(listen, &config.probes, reflector_settings, &host.clock).await?
        } else {
            (Vec::new(), vec![None; listeners.len()])
        };
        let built_in = calibration_model(config).map(|model| model.name().clone());
        Ok(Some(Self { instance, probe_key, built_in, listeners, reflectors, probe_ports }))
    }

    /// Returns the addresses at which peers may ask for models, with the actual port numbers: the system chooses the
    /// port if the configured port is 0.
    pub(crate) fn addresses(&self) -> Vec<Address> {
        self.listeners.iter().map(|listener| listener.address().clone()).collect()
    }
}

/// Returns the built-in model that answers with its input; `None` if the model is switched off, or if a configured
/// model has the same name.
pub(crate) fn calibration_model(config: &AgentConfig) -> Option<ModelConfig> {
    let is_enabled = config.serve.as_ref().is_some_and(|serve| serve.calibration);
    let name: Slug = CALIBRATION.parse().ok()?;
    let is_name_free = config.models.iter().all(|model| *model.name() != name);
    (is_enabled && is_name_free).then(|| ModelConfig::echo(name))
}
