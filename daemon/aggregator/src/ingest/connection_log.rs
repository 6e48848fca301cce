//! Selects which statistics of connections are stored: one sample per minute, and the last sample of a connection that
//! has ended.
//!
//! The samples come from the live state. Agents do not send the samples as events, because an older aggregator could
//! not read such an event. A missed sample loses no totals, because the totals are cumulative and the next sample
//! contains them.

use std::collections::HashMap;

use peernet_clock::{MonoTime, Span};
use peernet_logger::{HostId, Slug};
use peernet_store::writing::ConnectionSample;
use peernet_stream::NetworkName;

use crate::live_state::LiveState;

/// Interval of storing the statistics of an open connection.
const INTERVAL: Span = Span::from_seconds(60);

/// Identity of a connection: edge, cloud, pipeline, network name and the edge's local address.
type ConnectionKey = (HostId, HostId, Slug, NetworkName, Option<String>);

/// The open connections with their latest statistics.
#[derive(Debug, Default)]
pub(super) struct ConnectionLog {
    open: HashMap<ConnectionKey, OpenConnection>,
}

/// An open connection.
#[derive(Debug)]
struct OpenConnection {
    sample: ConnectionSample,
    /// Time of the last stored sample, or of the first observation.
    stored_at: MonoTime,
}

impl ConnectionLog {
    /// Updates the open connections from a snapshot. Returns the samples to be stored.
    pub(super) fn observe(&mut self, snapshot: &LiveState, now: MonoTime) -> Vec<ConnectionSample> {
        let mut due_samples = Vec::new();
        let mut previously_open = std::mem::take(&mut self.open);
        for link in snapshot.links.iter().filter(|link| link.connected) {
            for connection in &link.live.connections {
                let (edge, cloud) = (link.edge, link.live.peer);
                let (pipeline, network) = (connection.pipeline.clone(), connection.network.clone());
                let key = (edge, cloud, pipeline, network, connection.local.clone());
                // A new connection is first stored after a whole interval, or when it ends.
                let mut stored_at = previously_open.remove(&key).map_or(now, |previous| previous.stored_at);
                let sample = ConnectionSample {
                    edge,
                    cloud,
                    at: link.live.latest_sample.at,
                    connection: connection.clone(),
                };
                if now - stored_at >= INTERVAL {
                    stored_at = now;
                    due_samples.push(sample.clone());
                }
                self.open.insert(key, OpenConnection { sample, stored_at });
            }
        }
        // The remaining connections have ended: the snapshot does not contain them any more.
        due_samples.extend(previously_open.into_values().map(|ended| ended.sample));
        due_samples
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ExchangeCounts, WallTime};
    use peernet_stream::{
        ClockSample, Connection, ConnectionStatistics, DirectionStatistics, LinkLive, ProbeCounts, Probing,
    };

    use super::*;
    use crate::live_state::{LinkSnapshot, Totals};

    fn slug(text: &str) -> Slug {
        text.parse().expect("a name")
    }

    fn after(seconds: i64) -> MonoTime {
        MonoTime::from_nanos(7) + Span::from_seconds(seconds)
    }

    fn connection(local: &str, bytes: u64) -> Connection {
        Connection {
            pipeline: slug("line"),
            network: NetworkName::default(),
            local: Some(local.into()),
            remote: None,
            interface: None,
            statistics: ConnectionStatistics {
                sent: DirectionStatistics { bytes, ..DirectionStatistics::default() },
                ..ConnectionStatistics::default()
            },
            cloud: None,
        }
    }

    /// Returns a live state with one link.
    fn snapshot(connected: bool, connections: Vec<Connection>) -> LiveState {
        let (at, peer) = (WallTime::from_unix_nanos(9), HostId::from_bytes([9; 16]));
        let latest_sample = ClockSample {
            network: NetworkName::default(),
            basis: None,
            peer,
            peer_name: slug("cloud"),
            at,
            relation_period: 7,
            max_drift_ppm: 50.0,
            upper: None,
            lower: None,
            offset: None,
            probes: ProbeCounts::default(),
            exchanges: ExchangeCounts::default(),
            round_trip: None,
            up: None,
            down: None,
        };
        let live = LinkLive {
            peer,
            peer_name: slug("cloud"),
            networks: Vec::new(),
            pipelines: Vec::new(),
            same_clock: false,
            probing: Probing::Off("a test".into()),
            edge: None,
            cloud: None,
            latest_sample,
            connections,
            reflector: None,
        };
        let (edge, history) = (HostId::from_bytes([1; 16]), Vec::new());
        let link = LinkSnapshot { edge, edge_name: slug("edge"), connected, last_seen: at, live, history };
        LiveState {
            at,
            aggregator: slug("base"),
            listening: String::new(),
            hosts: Vec::new(),
            pipelines: Vec::new(),
            links: vec![Arc::new(link)],
            refused: Vec::new(),
            absent: 0,
            totals: Totals::default(),
        }
    }

    fn bytes(samples: &[ConnectionSample]) -> Vec<u64> {
        samples.iter().map(|sample| sample.connection.statistics.sent.bytes).collect()
    }

    #[test]
    fn open_connection_is_stored_once_a_minute() {
        let mut log = ConnectionLog::default();
        let stored: Vec<u64> = (0..=150)
            .flat_map(|second: i64| {
                let snapshot = snapshot(true, vec![connection("10.0.0.2:1", second.unsigned_abs())]);
                bytes(&log.observe(&snapshot, after(second)))
            })
            .collect();
        assert_eq!(stored, [60, 120]);
    }

    #[test]
    fn ended_connection_is_stored_with_its_last_totals() {
        let mut log = ConnectionLog::default();
        let open = |local, bytes| snapshot(true, vec![connection(local, bytes)]);
        assert_eq!(bytes(&log.observe(&open("10.0.0.2:1", 5), after(0))), [0; 0]);
        // The connection was reopened from another port.
        assert_eq!(bytes(&log.observe(&open("10.0.0.2:2", 1), after(1))), [5]);
        // The edge disconnected.
        let gone = snapshot(false, vec![connection("10.0.0.2:2", 1)]);
        assert_eq!(bytes(&log.observe(&gone, after(2))), [1]);
        assert_eq!(bytes(&log.observe(&gone, after(3))), [0; 0]);
    }
}
