//! Event counts of a host, from the REST API.

use chrono::{DateTime, Utc};
use peernet_clock::WallTime;
use serde_json::Value;

use crate::process::poll;
use crate::time::wall;
use crate::{Api, TEST_TIMEOUT};

/// Event counts of a host: the counts that the agent reports, and the counts that the aggregator has stored.
#[derive(Clone, Debug)]
pub struct EventCounts {
    /// `true` if the host is connected to the aggregator.
    pub connected: bool,
    /// Time of its last report.
    pub last_seen: WallTime,
    /// Number of produced events.
    pub produced: u64,
    /// Number of produced events that are in the spool or stored.
    pub spooled: u64,
    /// Number of acknowledged events, according to the agent.
    pub acknowledged: u64,
    /// Number of events that wait on the agent.
    pub waiting: u64,
    /// Number of dropped events.
    pub dropped: u64,
    /// Number of reported gaps.
    pub gaps: u64,
    /// Reason why the spool fails; `None` while it works.
    pub trouble: Option<String>,
    /// Number of stored events, according to the aggregator.
    pub stored: u64,
    /// Number of events that are missing in gaps, according to the aggregator.
    pub missing: u64,
    /// Number of batches that were received a second time, and not stored again, since the aggregator started.
    pub duplicates: u64,
    /// Age of the newest live update, seconds, for a host that reads this machine's clock.
    pub live_lag_s: f64,
}

impl EventCounts {
    /// Reads the counts of a host; returns `None` if the aggregator does not answer or the host does not report.
    pub fn read(api: &Api, host: &str) -> Option<Self> {
        let (status, text) = api.get(&format!("/api/v1/hosts/{host}"))?;
        let host: Value = (status == 200).then(|| serde_json::from_str(&text).ok())??;
        let (live_state, stored) = (&host["now"], &host["stored"]);
        let events = &live_state["events"];
        let count = |object: &Value, key: &str| {
            object[key].as_u64().unwrap_or_else(|| panic!("{key} is not a count in {object} of {host}"))
        };
        if live_state.is_null() {
            return None;
        }
        let last_seen =
            host["last_seen"].as_str().and_then(|text| DateTime::parse_from_rfc3339(text).ok())?;
        let age_s = (DateTime::<Utc>::from_timestamp_nanos(wall().unix_nanos()) - last_seen.to_utc())
            .as_seconds_f64();
        // The host's clock when it sent the update, minus the aggregator's clock at the arrival. On one machine this is
        // the negative time that the update took.
        let ahead_s = live_state["clock_ahead_s"].as_f64().unwrap_or_default();
        Some(Self {
            connected: host["connected"] == true,
            last_seen: WallTime::from_unix_nanos(last_seen.timestamp_nanos_opt()?),
            produced: count(events, "produced"),
            spooled: count(events, "spooled"),
            acknowledged: count(events, "acknowledged"),
            waiting: count(events, "waiting"),
            dropped: count(events, "dropped"),
            gaps: count(events, "gaps"),
            trouble: events["trouble"].as_str().map(str::to_owned),
            stored: count(stored, "events"),
            missing: count(stored, "missing"),
            duplicates: count(stored, "duplicates"),
            live_lag_s: age_s - ahead_s.min(0.0),
        })
    }

    /// Waits until the counts of a connected host fulfil `condition`.
    ///
    /// # Panics
    /// If that takes longer than [`crate::TEST_TIMEOUT`].
    pub fn wait_until(
        api: &Api,
        host: &str,
        description: &str,
        mut condition: impl FnMut(&Self) -> bool,
    ) -> Self {
        let mut last = None;
        let counts = poll(|| {
            last = Self::read(api, host);
            last.clone().filter(|counts| counts.connected && condition(counts))
        });
        counts.unwrap_or_else(|| {
            panic!("timeout after {TEST_TIMEOUT:?} while waiting for {host}: {description}; now {last:?}")
        })
    }

    /// Waits until agent and aggregator agree that no event of a host waits. The host must not measure. Continues as long as
    /// more events are stored. Reports from before `since` are ignored.
    ///
    /// # Panics
    /// If no more events are stored for [`crate::TEST_TIMEOUT`].
    pub fn wait_until_at_rest(api: &Api, host: &str, since: WallTime) -> Self {
        let mut previous = None;
        loop {
            let counts = Self::wait_until(api, host, "more events are stored", |counts| {
                counts.last_seen > since
                    && (counts.is_at_rest() || Some((counts.acknowledged, counts.stored)) != previous)
            });
            if counts.is_at_rest() {
                return counts;
            }
            previous = Some((counts.acknowledged, counts.stored));
        }
    }

    fn is_at_rest(&self) -> bool {
        // Events that the agent delivered to another database, or to this database before it was restored from a backup, are
        // missing here.
        let stored_elsewhere = self.missing.saturating_sub(self.dropped);
        self.waiting == 0
            && (self.stored == self.acknowledged || self.stored + stored_elsewhere == self.acknowledged)
    }

    /// Asserts that every produced event is stored, waiting or dropped.
    ///
    /// # Panics
    /// If the counts do not add up.
    pub fn assert_balanced(&self) {
        assert_eq!(self.produced, self.acknowledged + self.waiting + self.dropped, "{self:?}");
    }
}
