//! Event counts of agents with a backlog or a failing disk.

use peernet_clock::{Span, WallTime};
use peernet_stream::Accounting;

/// Initial lag of storage, seconds.
const INITIAL_LAG_S: f64 = 14_400.0;
/// Seconds by which the lag falls per second.
const RATE: f64 = 48.0;
/// Events per second of measurement.
const HZ: f64 = 300.0;

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
    let behind = (INITIAL_LAG_S - RATE * elapsed).max(0.0);
    let waiting = (behind * HZ) as u64;
    let delivered = (INITIAL_LAG_S * HZ) as u64 - waiting;
    match index {
        1 => Accounting {
            produced: account.produced + delivered + waiting,
            spooled: account.spooled + delivered + waiting - waiting.min(120),
            sent: account.sent + delivered + waiting.min(1_024),
            stored: account.stored + delivered,
            waiting: account.waiting + waiting,
            spool_bytes: waiting * 280,
            spool_limit_bytes: 2 << 30,
            memory_bytes: waiting.min(120) * 280,
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
