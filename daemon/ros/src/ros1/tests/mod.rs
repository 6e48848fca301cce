//! Tests of nodes against a master in this process and against each other.

mod exchange;
mod faults;
mod master;
mod memory;
mod slave_api;

use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{ClockIdentity, SharedClock, SystemClock};

pub(crate) use self::master::TestMaster;
pub(in crate::ros1) use self::memory::TestLimit;
use super::{Environment, Node, RpcUri};

/// Longest wait for an event that a test expects.
const TIME_LIMIT: Duration = Duration::from_secs(30);

pub(crate) fn clock() -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("boot", "clock")))
}

pub(crate) fn environment(uri: &str) -> Environment {
    Environment {
        master: RpcUri::parse(uri).unwrap(),
        advertised_host: Some("127.0.0.1".to_owned()),
        namespace: "/".to_owned(),
    }
}

async fn node(master: &TestMaster, name: &str) -> Node {
    Node::new(&environment(&master.uri()), name, clock()).await.unwrap()
}

/// Awaits a future that must end within [`TIME_LIMIT`].
pub(crate) async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(TIME_LIMIT, future).await.expect("it happens in time")
}
