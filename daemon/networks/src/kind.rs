//! The registry of transports.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::transport::{self, BindFailure, Bound, DialFailure, Dialled};
use crate::{Address, SessionSettings};

macro_rules! registry {
    ($($(#[$doc:meta])* $variant:ident = $name:literal in $module:ident;)*) => {
        /// The networks a sample can travel over.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum NetworkKind {
            $($(#[$doc])* $variant,)*
        }

        impl NetworkKind {
            /// Every kind, in the order of declaration.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// The name used in configurations, in storage and on the pages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            pub(crate) async fn dial(
                self,
                address: &Address,
                settings: &SessionSettings,
            ) -> Result<Dialled, DialFailure> {
                match self { $(Self::$variant => transport::$module::dial(address, settings).await),* }
            }

            pub(crate) async fn bind(
                self,
                address: &Address,
                settings: &SessionSettings,
            ) -> Result<Bound, BindFailure> {
                match self { $(Self::$variant => transport::$module::bind(address, settings).await),* }
            }
        }
    };
}

registry! {
    /// ZMTP over TCP: any ZeroMQ library can be the peer (DEALER on the edge, ROUTER on the cloud).
    ZmqTcp = "zmq-tcp" in zmq_tcp;
}

impl fmt::Display for NetworkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
