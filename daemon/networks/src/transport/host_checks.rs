//! What a network checks of a configuration on this host.

use std::error::Error;

use crate::{Address, SessionSettings};

/// What is wrong; only the network itself knows the type.
type Problem = Box<dyn Error + Send + Sync>;

/// The checks of a network that depend on the build and on this host.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HostChecks {
    /// Checks that peers at an address of the network can be reached by this build.
    pub(crate) address: fn(&Address) -> Result<(), Problem>,
    /// Checks the settings that only the network has; an error names their key.
    pub(crate) settings: fn(&SessionSettings) -> Result<(), (&'static str, Problem)>,
}

impl HostChecks {
    /// A network that works everywhere.
    pub(crate) const NONE: Self = Self { address: |_| Ok(()), settings: |_| Ok(()) };
}

/// An address that cannot be used on this host.
#[derive(Debug, thiserror::Error)]
#[error("{address}: {problem}")]
pub struct UnusableAddress {
    /// The address.
    pub address: Address,
    /// Why.
    pub problem: Problem,
}

/// A setting that cannot be used on this host.
#[derive(Debug, thiserror::Error)]
#[error("{key}: {problem}")]
pub struct UnusableSetting {
    /// The key below that of the session.
    pub key: &'static str,
    /// Why.
    pub problem: Problem,
}

impl Address {
    /// Checks that this host can use the address, without connecting to it.
    ///
    /// # Errors
    /// When the build lacks the network.
    pub fn check_host(&self) -> Result<(), UnusableAddress> {
        (self.network().host_checks().address)(self)
            .map_err(|problem| UnusableAddress { address: self.clone(), problem })
    }
}
