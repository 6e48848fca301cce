//! What became of a host's events, as the API tells it.

use chrono::{DateTime, Utc};
use peernet_clock::WallTime;
use serde_json::Value;

use crate::process::patiently;
use crate::time::wall;
use crate::{Api, PATIENCE};

/// One host's account: the agent's own word, and what the aggregator stored of it.
#[derive(Clone, Debug)]
pub struct Account {
    /// Whether it reports now.
    pub connected: bool,
    /// When it was last heard of.
    pub seen: WallTime,
    /// Events that were handed in.
    pub produced: u64,
    /// Of those, in the spool or stored.
    pub spooled: u64,
    /// Acknowledged, by the agent's word.
    pub stored: u64,
    /// Waiting on the agent.
    pub waiting: u64,
    /// Dropped.
    pub dropped: u64,
    /// Gaps reported.
    pub gaps: u64,
    /// Why the spool fails, while it does.
    pub trouble: Option<String>,
    /// Stored, by the aggregator's word.
    pub events: u64,
    /// Events missing in gaps, by the aggregator's word.
    pub missing: u64,
    /// Batches that came again and were stored once, since the aggregator started.
    pub duplicates: u64,
    /// How far the live picture is behind the host, seconds: the age of the newest update, counted from the moment
    /// it was made. For a host that reads this machine's clock.
    pub live_lag_s: f64,
}

impl Account {
    /// The account of a host; `None` when the aggregator does not answer or the host does not report.
    pub fn of(api: &Api, host: &str) -> Option<Self> {
        let (status, text) = api.get(&format!("/api/v1/hosts/{host}"))?;
        let host: Value = (status == 200).then(|| serde_json::from_str(&text).ok())??;
        let (now, stored) = (&host["now"], &host["stored"]);
        let events = &now["events"];
        let count = |of: &Value, key: &str| {
            of[key].as_u64().unwrap_or_else(|| panic!("{key} is no count in {of} of {host}"))
        };
        if now.is_null() {
            return None;
        }
        let seen = host["last_seen"].as_str().and_then(|text| DateTime::parse_from_rfc3339(text).ok())?;
        let age =
            (DateTime::<Utc>::from_timestamp_nanos(wall().unix_nanos()) - seen.to_utc()).as_seconds_f64();
        let ahead = now["clock_ahead_s"].as_f64().unwrap_or_default();
        Some(Self {
            connected: host["connected"] == true,
            seen: WallTime::from_unix_nanos(seen.timestamp_nanos_opt()?),
            produced: count(events, "produced"),
            spooled: count(events, "spooled"),
            stored: count(events, "acknowledged"),
            waiting: count(events, "waiting"),
            dropped: count(events, "dropped"),
            gaps: count(events, "gaps"),
            trouble: events["trouble"].as_str().map(str::to_owned),
            events: count(stored, "events"),
            missing: count(stored, "missing"),
            duplicates: count(stored, "duplicates"),
            live_lag_s: age - ahead.min(0.0),
        })
    }

    /// Waits until the account of a connected host is as `holds` says.
    ///
    /// # Panics
    /// When that takes longer than [`crate::PATIENCE`].
    pub fn until(api: &Api, host: &str, what: &str, mut holds: impl FnMut(&Self) -> bool) -> Self {
        let mut last = None;
        let account = patiently(|| {
            last = Self::of(api, host);
            last.clone().filter(|account| account.connected && holds(account))
        });
        account.unwrap_or_else(|| panic!("waited {PATIENCE:?} in vain for {host}: {what}; now {last:?}"))
    }

    /// Waits until nothing waits on a host that measures nothing, however long, as long as there is progress, and
    /// until both ends say so. Only what the host told after `since` counts.
    ///
    /// # Panics
    /// When nothing more was stored for [`crate::PATIENCE`].
    pub fn at_rest(api: &Api, host: &str, since: WallTime) -> Self {
        let mut before = None;
        loop {
            let now = Self::until(api, host, "more is stored", |account| {
                account.seen > since && (account.rests() || Some((account.stored, account.events)) != before)
            });
            if now.rests() {
                return now;
            }
            before = Some((now.stored, now.events));
        }
    }

    fn rests(&self) -> bool {
        // What the agent delivered to another database, or to this one before it was restored, is missing here.
        let elsewhere = self.missing.saturating_sub(self.dropped);
        self.waiting == 0 && (self.events == self.stored || self.events + elsewhere == self.stored)
    }

    /// Checks that nothing is unaccounted for.
    ///
    /// # Panics
    /// When the sum is not right.
    pub fn balances(&self) {
        assert_eq!(self.produced, self.stored + self.waiting + self.dropped, "{self:?}");
    }
}
