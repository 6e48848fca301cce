//! Read-only connections for queries, few in number and with a time limit for each statement.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use futures::future::BoxFuture;
use peernet_clock::{SharedClock, Span};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use sqlx::{ConnectOptions, SqliteConnection, SqlitePool};

use super::integrity::Integrity;
use super::limits::BUSY_TIMEOUT;
use crate::database_error::DatabaseError;
use crate::error::StoreError;

/// Longest wait of a query for a connection.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(5);
/// Instructions of SQLite's virtual machine between two checks of the deadline: some tens of microseconds.
const INSTRUCTIONS_PER_CHECK: i32 = 2_000;
/// SQLite's code for an interrupted statement (SQLITE_INTERRUPT).
const INTERRUPTED: &str = "9";

/// Read-only connections, opened when needed.
///
/// SQLite's progress handler interrupts a statement that takes longer than the limit; the connection stays usable. It
/// also interrupts statements when the connections are to be closed.
#[derive(Clone, Debug)]
pub struct Readers {
    /// Closed while the database is closed.
    pool: Arc<RwLock<SqlitePool>>,
    /// Longest time of a statement.
    limit: Duration,
    /// True from the beginning of [`Self::close`] until [`Self::reopen`].
    is_closing: Arc<AtomicBool>,
    integrity: Integrity,
}

impl Readers {
    /// Prepares at most `connections` connections to the file. The file is opened at the first query.
    ///
    /// `limit` is the longest time of a statement, from the moment it gets the connection until its last row was read.
    /// Damage that a statement encounters is recorded in `integrity`.
    pub fn open(
        path: &Path,
        connections: u32,
        limit: Duration,
        clock: SharedClock,
        integrity: Integrity,
    ) -> Self {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .read_only(true)
            .busy_timeout(BUSY_TIMEOUT)
            .disable_statement_logging();
        let limit_span = Span::from_nanos(i64::try_from(limit.as_nanos()).unwrap_or(i64::MAX));
        // The deadline is set when a connection is opened, and again whenever the pool gives out the connection.
        let is_closing = Arc::new(AtomicBool::new(false));
        let deadline = Deadline { limit: limit_span, clock, is_closing: Arc::clone(&is_closing) };
        let renewed_deadline = deadline.clone();
        let pool = SqlitePoolOptions::new()
            .max_connections(connections)
            .acquire_timeout(ACQUIRE_TIMEOUT)
            // A connection to a file does not break while it is unused. A test before each use would cost time and find
            // nothing.
            .test_before_acquire(false)
            .after_connect(move |connection, _| deadline.clone().set(connection))
            .before_acquire(move |connection, _| {
                let setting = renewed_deadline.clone().set(connection);
                Box::pin(async move { setting.await.map(|()| true) })
            })
            .connect_lazy_with(options);
        Self { pool: Arc::new(RwLock::new(pool)), limit, is_closing, integrity }
    }

    /// Returns the current pool of connections.
    pub(super) fn pool(&self) -> SqlitePool {
        self.pool.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Stops the queries in progress and closes the connections; later queries are refused.
    pub(super) async fn close(&self) {
        self.is_closing.store(true, Ordering::Relaxed);
        self.pool().close().await;
    }

    /// Creates new connections in place of the closed connections.
    pub(super) fn reopen(&self) {
        let mut pool = self.pool.write().unwrap_or_else(PoisonError::into_inner);
        let options = pool.connect_options().as_ref().clone();
        self.is_closing.store(false, Ordering::Relaxed);
        *pool = pool.options().clone().connect_lazy_with(options);
    }

    /// Returns a function that turns the error of a statement into an error that names the requested data (`what`).
    pub(super) fn error_for(
        &self,
        what: &'static str,
    ) -> impl Fn(sqlx::Error) -> StoreError + Copy + use<'_> {
        let Self { limit, is_closing, integrity, .. } = self;
        let limit = *limit;
        move |source| match source {
            sqlx::Error::PoolTimedOut => StoreError::Busy { what },
            sqlx::Error::PoolClosed => StoreError::Closed { what },
            sqlx::Error::Database(error) if error.code().as_deref() == Some(INTERRUPTED) => {
                if is_closing.load(Ordering::Relaxed) {
                    StoreError::Closed { what }
                } else {
                    StoreError::TooLong { what, limit }
                }
            }
            error => {
                let source = DatabaseError::new(error);
                // Queries read pages that the writer may not read for a long time, so damage is recorded here, too.
                integrity.record_if_damage(&source);
                match integrity.damage_message().filter(|_| source.is_damage()) {
                    Some(damage) => StoreError::Damaged { what, damage },
                    None => StoreError::Database { what, source },
                }
            }
        }
    }
}

/// Time limit of a statement. The time counts from the moment at which the pool gives out the connection.
#[derive(Clone)]
struct Deadline {
    limit: Span,
    clock: SharedClock,
    is_closing: Arc<AtomicBool>,
}

impl Deadline {
    fn set(self, connection: &mut SqliteConnection) -> BoxFuture<'_, Result<(), sqlx::Error>> {
        Box::pin(async move {
            let Self { limit, clock, is_closing } = self;
            let start = clock.mono();
            let may_continue = move || clock.mono() - start < limit && !is_closing.load(Ordering::Relaxed);
            connection.lock_handle().await?.set_progress_handler(INSTRUCTIONS_PER_CHECK, may_continue);
            Ok(())
        })
    }
}
