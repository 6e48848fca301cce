//! Descriptors of this process, and how many connections each port may keep of them.
//!
//! | share of the limit | for | at most |
//! | --- | --- | --- |
//! | 5/16 | connections of agents to the aggregator | 4,096 |
//! | 5/16 | connections of edges to the data port, or to all data ports together | 4,096 for each port |
//! | 1/8 | connections to the dashboard and the REST API | 1,024 |
//! | the rest, at least 1/4 | database, spool, log, models, pipes, connections to others | |

use std::io;
use std::num::NonZeroUsize;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Sockets that a port needs beside its connections: the listening one, and those that are being closed.
const PORT_OVERHEAD: u64 = 18;

/// A port that accepts connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptorShare {
    /// Agents connect to it, and send events.
    EventPort,
    /// Edges connect to it, and send samples.
    DataPort,
    /// Browsers and programs connect to it.
    Web,
}

impl DescriptorShare {
    /// How many connections the port may keep open under the current limit of this process.
    pub fn connections(self) -> usize {
        self.connections_of_each(NonZeroUsize::MIN)
    }

    /// How many connections each of so many ports of this kind may keep open.
    pub fn connections_of_each(self, ports: NonZeroUsize) -> usize {
        self.connections_of(getrlimit(Resource::Nofile).current, ports)
    }

    /// The same under a limit; without one, the largest number.
    fn connections_of(self, limit: Option<u64>, ports: NonZeroUsize) -> usize {
        let (sixteenths, most) = match self {
            Self::EventPort | Self::DataPort => (5, 4_096),
            Self::Web => (2, 1_024),
        };
        let all = limit.map_or(u64::MAX, |limit| limit / 16 * sixteenths);
        let share = (all / ports.get() as u64).saturating_sub(PORT_OVERHEAD);
        usize::try_from(share.clamp(1, most)).unwrap_or(usize::MAX)
    }
}

/// Raises the number of descriptors that this process may have to what it may raise it to. Returns that number;
/// `None` when there is no limit.
///
/// # Errors
/// When the system refuses; the limit is as before then.
pub fn raise_limit() -> io::Result<Option<u64>> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum {
        setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })?;
    }
    Ok(maximum)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHARES: [DescriptorShare; 3] =
        [DescriptorShare::EventPort, DescriptorShare::DataPort, DescriptorShare::Web];

    fn one(share: DescriptorShare, limit: Option<u64>) -> usize {
        share.connections_of(limit, NonZeroUsize::MIN)
    }

    #[test]
    fn all_ports_together_leave_a_quarter() {
        for limit in [256, 1_024, 4_096, 1 << 20] {
            let connections = SHARES.map(|share| one(share, Some(limit)) as u64 + PORT_OVERHEAD);
            assert!(connections.iter().sum::<u64>() <= limit * 3 / 4, "{limit}: {connections:?}");
        }
        assert_eq!(SHARES.map(|share| one(share, Some(1_024))), [302, 302, 110]);
        assert_eq!(SHARES.map(|share| one(share, None)), [4_096, 4_096, 1_024]);
        assert_eq!(SHARES.map(|share| one(share, Some(1 << 19))), [4_096, 4_096, 1_024]);
        assert_eq!(SHARES.map(|share| one(share, Some(10))), [1, 1, 1]);
    }

    #[test]
    fn several_data_ports_take_one_share() {
        let of_each = |ports| {
            let ports = NonZeroUsize::new(ports).expect("above 0");
            DescriptorShare::DataPort.connections_of(Some(1_024), ports)
        };
        assert_eq!([1, 2, 4, 100].map(of_each), [302, 142, 62, 1]);
    }
}
