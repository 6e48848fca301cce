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

/// The state that all handlers share.
pub(crate) type App = Arc<AppState>;

/// The aggregator, and the settings of the pages that show its data.
#[derive(Debug)]
pub(crate) struct AppState {
    pub aggregator: Aggregator,
    pub clock: SharedClock,
    pub zone: Zone,
    pub warn: WarnConfig,
    /// Names under which requests are answered.
    pub server_names: ServerNames,
    /// Time at which the server started.
    pub started_at: WallTime,
    /// Cancelled when the server is to stop; live streams end then.
    pub stop: CancellationToken,
    /// The newest incidents, and the time at which they were read; `None` before the first query.
    incident_cache: Mutex<Option<(MonoTime, Arc<Vec<IncidentRow>>)>>,
    /// Counts equal failures, so that each is logged at most once a minute.
    failure_log: std::sync::Mutex<LogThrottle>,
}

impl AppState {
    /// Number of incidents that a live page shows.
    const SHOWN_INCIDENTS: usize = 6;
    /// Number of newest incidents that are cached. Live pages filter them by host or pipeline.
    const CACHED_INCIDENTS: u32 = 200;
    /// Maximum age of the cached incidents.
    const INCIDENT_CACHE_AGE: Span = Span::from_seconds(2);

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
            server_names: ServerNames::new(&config.server_names),
            started_at: clock.wall(),
            clock,
            stop,
            incident_cache: Mutex::new(None),
            failure_log: std::sync::Mutex::default(),
        })
    }

    /// Returns the newest snapshot of the live state.
    pub(crate) fn live_state(&self) -> Arc<LiveState> {
        Arc::clone(&self.aggregator.live().borrow())
    }

    /// Returns the store.
    pub(crate) fn store(&self) -> &Store {
        self.aggregator.store()
    }

    /// Counts a failure of a request. Returns how often this failure occurred since it was last logged, or `None` if it was logged less than
    /// a minute ago.
    pub(crate) fn count_failure(&self, failure: &str) -> Option<u64> {
        let mut failure_log = self.failure_log.lock().unwrap_or_else(PoisonError::into_inner);
        let address = None;
        failure_log.count_event(failure, address, self.clock.mono())
    }

    /// Returns the [`Self::SHOWN_INCIDENTS`] newest incidents, for the list of a live page.
    pub(crate) async fn shown_incidents(&self) -> Result<Vec<IncidentRow>, StoreError> {
        let cached = self.cached_incidents().await?;
        Ok(cached.iter().take(Self::SHOWN_INCIDENTS).cloned().collect())
    }

    /// Replaces the error of a closed database by an empty answer, for live pages. The live figures of these pages need no database, and a
    /// banner reports that the database is closed.
    pub(crate) fn empty_if_store_is_closed<T: Default>(
        answer: Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        match answer {
            Err(StoreError::Closed { .. }) => Ok(T::default()),
            answer => answer,
        }
    }

    /// Returns the [`Self::CACHED_INCIDENTS`] newest incidents, as they were at most [`Self::INCIDENT_CACHE_AGE`] ago.
    pub(crate) async fn cached_incidents(&self) -> Result<Arc<Vec<IncidentRow>>, StoreError> {
        // Every live page needs the incidents four times a second, so one query serves all pages. The lock is held during the query:
        // pages that need the incidents meanwhile wait for its result instead of sending a query of their own.
        let mut cached = self.incident_cache.lock().await;
        let now = self.clock.mono();
        if let Some((read_at, rows)) = &*cached
            && now - *read_at < Self::INCIDENT_CACHE_AGE
        {
            return Ok(Arc::clone(rows));
        }
        let rows = Arc::new(Self::empty_if_store_is_closed(
            self.store().incidents(&IncidentFilter::newest(Self::CACHED_INCIDENTS)).await,
        )?);
        *cached = Some((now, Arc::clone(&rows)));
        Ok(rows)
    }
}
