//! Guard of a topic that is registered as long as its publisher or subscriber exists.

use std::sync::Arc;

use super::error::NodeError;
use super::registrar::Registrar;
use super::registration::Registration;

/// Keeps a topic in the node and with the master until it is dropped.
#[derive(Debug)]
pub(super) struct RegistrationGuard {
    registrar: Arc<Registrar>,
    registration: Registration,
}

impl RegistrationGuard {
    /// Registers a topic that the node has. Returns the guard, with the URIs of the topic's subscribers for a
    /// publisher, of its publishers for a subscriber.
    ///
    /// # Errors
    /// If the master does not answer or refuses. The topic is then removed from the node.
    pub(super) async fn register(
        registrar: &Arc<Registrar>,
        registration: Registration,
    ) -> Result<(Self, Vec<String>), NodeError> {
        // The guard is created first: if the call fails, dropping the guard unregisters the topic, which the master may
        // know nevertheless.
        let guard = Self { registrar: Arc::clone(registrar), registration };
        let uris = registrar.register(&guard.registration).await?;
        Ok((guard, uris))
    }

    /// Checks that the node has not ended.
    ///
    /// # Errors
    /// If the node has ended.
    pub(super) fn check_open(&self) -> Result<(), NodeError> {
        self.registrar.lifetime().check_open()
    }

    /// Returns the error of a node that has ended.
    pub(super) fn closed_error(&self) -> NodeError {
        self.registrar.lifetime().closed_error()
    }
}

impl Drop for RegistrationGuard {
    fn drop(&mut self) {
        self.registrar.remove(self.registration.clone());
    }
}
