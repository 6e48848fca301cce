//! File descriptors of this process, and the number of connections that each port may keep open.
//!
//! Each port gets a share of the limit on descriptors, so that a flood of connections to one port leaves descriptors
//! for the other ports and for files.
//!
//! | share of the limit | for | at most |
//! | --- | --- | --- |
//! | 5/16 | connections of agents to the aggregator | 4,096 |
//! | 5/16 | connections of edges to the data port, or to all data ports together | 4,096 for each port |
//! | 1/8 | connections to the dashboard and the REST API | 1,024 |
//! | the rest, at least 1/4 | database, spool, log, models, pipes, outgoing connections | |

use std::io;
use std::num::NonZeroUsize;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Descriptors that a port needs in addition to its connections: the listening socket and sockets that are being
/// closed.
const PORT_OVERHEAD: u64 = 18;

/// Share of this process's descriptors that belongs to one kind of port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DescriptorShare {
    /// Share of the port to which agents connect and send events.
    EventPort,
    /// Share of the ports to which edges connect and send samples.
    DataPort,
    /// Share of the port to which browsers and REST clients connect.
    Web,
}

impl DescriptorShare {
    /// Returns how many connections the port may keep open under the current limit of this process, if it is the only
    /// port of this kind.
    pub fn max_connections(self) -> usize {
        self.max_connections_per_port(NonZeroUsize::MIN)
    }

    /// Returns how many connections each of `ports` ports of this kind may keep open.
    pub fn max_connections_per_port(self, ports: NonZeroUsize) -> usize {
        self.max_connections_under(getrlimit(Resource::Nofile).current, ports)
    }

    /// Returns the number of connections of each port if the process may have `limit` descriptors. `None` means no
    /// limit: the result is the maximum for the kind of port.
    fn max_connections_under(self, limit: Option<u64>, ports: NonZeroUsize) -> usize {
        // The shares of the table in the module documentation.
        let (sixteenths, max_per_port) = match self {
            Self::EventPort | Self::DataPort => (5, 4_096),
            Self::Web => (2, 1_024),
        };
        let descriptors = limit.map_or(u64::MAX, |limit| limit / 16 * sixteenths);
        // At least one connection is allowed, because a port without connections would be useless.
        let per_port = (descriptors / ports.get() as u64).saturating_sub(PORT_OVERHEAD);
        usize::try_from(per_port.clamp(1, max_per_port)).unwrap_or(usize::MAX)
    }
}

/// Raises this process's soft limit on descriptors to its hard limit. Returns the new limit; `None` means no limit.
///
/// # Errors
/// If the system refuses. The limit is then unchanged.
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

    fn max_connections_of_one_port(share: DescriptorShare, limit: Option<u64>) -> usize {
        share.max_connections_under(limit, NonZeroUsize::MIN)
    }

    #[test]
    fn all_ports_leave_a_quarter_of_descriptors() {
        for limit in [256, 1_024, 4_096, 1 << 20] {
            let descriptors =
                SHARES.map(|share| max_connections_of_one_port(share, Some(limit)) as u64 + PORT_OVERHEAD);
            assert!(descriptors.iter().sum::<u64>() <= limit * 3 / 4, "{limit}: {descriptors:?}");
        }
        assert_eq!(SHARES.map(|share| max_connections_of_one_port(share, Some(1_024))), [302, 302, 110]);
        assert_eq!(SHARES.map(|share| max_connections_of_one_port(share, None)), [4_096, 4_096, 1_024]);
        assert_eq!(
            SHARES.map(|share| max_connections_of_one_port(share, Some(1 << 19))),
            [4_096, 4_096, 1_024]
        );
        assert_eq!(SHARES.map(|share| max_connections_of_one_port(share, Some(10))), [1, 1, 1]);
    }

    #[test]
    fn several_data_ports_divide_one_share() {
        let max_connections = |ports| {
            let ports = NonZeroUsize::new(ports).expect("above 0");
            DescriptorShare::DataPort.max_connections_under(Some(1_024), ports)
        };
        assert_eq!([1, 2, 4, 100].map(max_connections), [302, 142, 62, 1]);
    }
}
