//! Event counts of agents with a backlog or a failing disk.

use peernet_clock::{Span, WallTime};
use peernet_stream::Accounting;

/// Initial lag of storage, seconds.
const INITIAL_LAG_S: f64 = 14_400.0;
/// Seconds by which the lag falls per second.
const CATCH_UP_RATE: f64 = 48.0;
/// Events per second of measurement.
const EVENTS_PER_SECOND: f64 = 300.0;
/// Maximum number of waiting events that are in memory and not yet in the spool.
const MAX_EVENTS_IN_MEMORY: u64 = 120;
/// Maximum number of sent events that are not yet stored.
const MAX_EVENTS_IN_FLIGHT: u64 = 1_024;
const BYTES_PER_EVENT: u64 = 280;

/// Returns the event counts of the agent with this index. Since the time `since`, the second agent catches up with a
/// backlog, and the third agent has a failing disk. Without that time, all counts stay as they are.
pub(crate) fn add_backlog(
    account: Accounting,
    index: usize,
    since: Option<WallTime>,
    now: WallTime,
) -> Accounting {
    let Some(since) = since else { return account };
    let elapsed = (now - since).seconds();
    let behind = (INITIAL_LAG_S - CATCH_UP_RATE * elapsed).max(0.0);
    let waiting = (behind * EVENTS_PER_SECOND) as u64;
    let delivered = (INITIAL_LAG_S * EVENTS_PER_SECOND) as u64 - waiting;
    match index {
        1 => Accounting {
            produced: account.produced + delivered + waiting,
            spooled: account.spooled + delivered + waiting - waiting.min(MAX_EVENTS_IN_MEMORY),
            sent: account.sent + delivered + waiting.min(MAX_EVENTS_IN_FLIGHT),
            stored: account.stored + delivered,
            waiting: account.waiting + waiting,
            spool_bytes: waiting * BYTES_PER_EVENT,
            spool_limit_bytes: 2 << 30,
            memory_bytes: waiting.min(MAX_EVENTS_IN_MEMORY) * BYTES_PER_EVENT,
            oldest: (waiting > 0).then(|| now - Span::from_seconds_f64(behind)),
            compressed: waiting > 0,
            ..account
        },
        2 => Accounting {
            produced: account.produced + 12_050,
            waiting: account.waiting + 9_000,
            dropped: account.dropped + 3_050,
            gaps: account.gaps + 4,
            spool_bytes: 1_060_000_000,
            spool_limit_bytes: 1 << 30,
            memory_bytes: 2_520_000,
            oldest: Some(now - Span::from_seconds_f64(30.0)),
            trouble: Some("cannot write /var/lib/peernet/spool.sqlite: no space left on device".into()),
            ..account
        },
        _ => account,
    }
}
