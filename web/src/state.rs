//! State that all handlers share.

use std::sync::{Arc, PoisonError};

use peernet_aggregator::{Aggregator, LiveState};
use peernet_clock::{LogThrottle, MonoTime, SharedClock, Span, WallTime};
use peernet_store::{IncidentFilter, IncidentRow, Store, StoreError};
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;

use crate::config::{WarnConfig, WebConfig};
use crate::server_names::ServerNames;
use crate::zone::Zone;

/// Shared by all handlers.
pub(crate) type App = Arc<AppState>;

/// The aggregator and how its answers are shown.
#[derive(Debug)]
pub(crate) struct AppState {
    pub aggregator: Aggregator,
    pub clock: SharedClock,
    pub zone: Zone,
    pub warn: WarnConfig,
    /// Names under which requests are answered.
    pub names: ServerNames,
    /// Time when serving began.
    pub since: WallTime,
    /// Cancelled when the server is to stop: streams end with it.
    pub stop: CancellationToken,
    incidents: Mutex<Option<(MonoTime, Arc<Vec<IncidentRow>>)>>,
    failures: std::sync::Mutex<LogThrottle>,
}

impl AppState {
    /// Number of incidents that a live page shows.
    const INCIDENTS: usize = 6;
    /// Number of newest incidents among which a live page finds its own.
    const RECENT: u32 = 200;
    const INCIDENTS_FRESH: Span = Span::from_seconds(2);

    pub(crate) fn new(
        config: &WebConfig,
        aggregator: Aggregator,
        clock: SharedClock,
        stop: CancellationToken,
    ) -> App {
        Arc::new(Self {
            aggregator,
            zone: config.time_zone,
            warn: config.warn,
            names: ServerNames::new(&config.server_names),
            since: clock.wall(),
            clock,
            stop,
            incidents: Mutex::new(None),
            failures: std::sync::Mutex::default(),
        })
    }

    /// Returns the live picture, now.
    pub(crate) fn picture(&self) -> Arc<LiveState> {
        Arc::clone(&self.aggregator.live().borrow())
    }

    /// Returns the store.
    pub(crate) fn store(&self) -> &Store {
        self.aggregator.store()
    }

    /// Counts a failure of a request. Returns how often it happened since it was last logged, or `None` when it need not be
    /// logged again yet.
    pub(crate) fn count_failure(&self, failure: &str) -> Option<u64> {
        let mut failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
        failures.count(failure, None, self.clock.mono())
    }

    /// Returns the newest incidents, as many as a live page shows.
    pub(crate) async fn newest_incidents(&self) -> Result<Vec<IncidentRow>, StoreError> {
        let recent = self.recent_incidents().await?;
        Ok(recent.iter().take(Self::INCIDENTS).cloned().collect())
    }

    /// Returns an answer of the store that a live page shows beside its figures. While the database is not open, the answer is empty: a
    /// banner on the page reports that.
    pub(crate) fn beside_live<T: Default>(answer: Result<T, StoreError>) -> Result<T, StoreError> {
        match answer {
            Err(StoreError::Closed { .. }) => Ok(T::default()),
            answer => answer,
        }
    }

    /// Returns the newest incidents. Every live page needs them four times a second, so they are read from the database once every two
    /// seconds for all pages.
    pub(crate) async fn recent_incidents(&self) -> Result<Arc<Vec<IncidentRow>>, StoreError> {
        let mut cached = self.incidents.lock().await;
        let now = self.clock.mono();
        if let Some((read, rows)) = &*cached
            && now - *read < Self::INCIDENTS_FRESH
        {
            return Ok(Arc::clone(rows));
        }
        let rows =
            Arc::new(Self::beside_live(self.store().incidents(&IncidentFilter::newest(Self::RECENT)).await)?);
        *cached = Some((now, Arc::clone(&rows)));
        Ok(rows)
    }
}
