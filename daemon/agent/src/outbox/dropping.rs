//! Decides when dropped events are logged: at the start of a period of losses, once a minute, and at its end.

use peernet_clock::{MonoTime, Span};

const REPORT_INTERVAL: Span = Span::from_seconds(60);
/// Time without a further dropped event after which a period of losses is over.
const MAX_QUIET_TIME: Span = Span::from_seconds(5);

/// Watches the number of dropped events.
#[derive(Debug, Default)]
pub(super) struct DroppingWatch {
    /// Total number of dropped events at the previous update.
    previous_total: Option<u64>,
    period: Option<DroppingPeriod>,
}

/// A period in which events are dropped.
#[derive(Clone, Copy, Debug)]
struct DroppingPeriod {
    /// Total number of dropped events before the period.
    total_before: u64,
    /// Time of the latest update with further dropped events.
    latest_drop: MonoTime,
    reported_at: MonoTime,
}

/// Report for the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DroppingReport {
    /// Events are being dropped; the number is the number of dropped events in this period so far.
    Dropping(u64),
    /// The period has ended; the number is the number of dropped events in the period.
    Ended(u64),
}

impl DroppingWatch {
    /// Updates the total number of dropped events (`dropped`) at `now`. Returns a report if a report is due.
    pub(super) fn update(&mut self, dropped: u64, now: MonoTime) -> Option<DroppingReport> {
        let previous_total = self.previous_total.replace(dropped).unwrap_or(dropped);
        match &mut self.period {
            None if dropped > previous_total => {
                self.period =
                    Some(DroppingPeriod { total_before: previous_total, latest_drop: now, reported_at: now });
                Some(DroppingReport::Dropping(dropped - previous_total))
            }
            None => None,
            Some(period) => {
                if dropped > previous_total {
                    period.latest_drop = now;
                }
                let count = dropped - period.total_before;
                if now - period.latest_drop >= MAX_QUIET_TIME {
                    self.period = None;
                    return Some(DroppingReport::Ended(count));
                }
                (now - period.reported_at >= REPORT_INTERVAL).then(|| {
                    period.reported_at = now;
                    DroppingReport::Dropping(count)
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropping_is_reported_at_begin_every_minute_and_at_end() {
        let at = |seconds: i64| MonoTime::from_nanos(0) + Span::from_seconds(seconds);
        let mut dropping = DroppingWatch::default();
        // Events that were dropped before the start are not reported.
        assert_eq!(dropping.update(7, at(0)), None);
        assert_eq!(dropping.update(9, at(1)), Some(DroppingReport::Dropping(2)));
        let reported: Vec<_> = (2..130).filter_map(|s| dropping.update(9 + s as u64, at(s))).collect();
        assert_eq!(reported, [DroppingReport::Dropping(63), DroppingReport::Dropping(123)]);
        assert_eq!(dropping.update(138, at(133)), None);
        assert_eq!(dropping.update(138, at(134)), Some(DroppingReport::Ended(131)));
        assert_eq!(dropping.update(138, at(500)), None);
    }
}
