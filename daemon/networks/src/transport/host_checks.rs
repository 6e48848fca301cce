//! Checks of a configuration that depend on the build and on this host.

use std::error::Error;

use crate::{Address, SessionSettings};

/// An error of a network's own type.
type BoxedError = Box<dyn Error + Send + Sync>;

/// The checks of a network that depend on the build and on this host.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HostChecks {
    /// Checks that this build can reach peers at an address of the network.
    pub(crate) check_address: fn(&Address) -> Result<(), BoxedError>,
    /// Checks the settings that only this network has. An error names the key.
    pub(crate) check_settings: fn(&SessionSettings) -> Result<(), (&'static str, BoxedError)>,
}

impl HostChecks {
    /// Checks of a network that works on every host.
    pub(crate) const NONE: Self = Self { check_address: |_| Ok(()), check_settings: |_| Ok(()) };
}

/// Error: an address cannot be used on this host.
#[derive(Debug, thiserror::Error)]
#[error("{address}: {problem}")]
pub struct UnusableAddress {
    /// The address.
    pub address: Address,
    /// The reason.
    pub problem: BoxedError,
}

/// Error: a setting cannot be used on this host.
#[derive(Debug, thiserror::Error)]
#[error("{key}: {problem}")]
pub struct UnusableSetting {
    /// Key in the table of the session settings.
    pub key: &'static str,
    /// The reason.
    pub problem: BoxedError,
}

impl Address {
    /// Checks that this host can use the address, without connecting to it.
    ///
    /// # Errors
    /// If this build of the program does not support the network.
    pub fn check_usable_on_this_host(&self) -> Result<(), UnusableAddress> {
        (self.network().host_checks().check_address)(self)
            .map_err(|problem| UnusableAddress { address: self.clone(), problem })
    }
}
