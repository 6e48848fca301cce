//! Detects that the peer does not receive the messages that this host receives. No I/O.

use peernet_clock::{MonoTime, Span};

/// Time after which it is reported that the peer receives no pair of messages.
const REPORT_AFTER: Span = Span::from_seconds(10);

/// Watches whether the peer receives the messages that this host receives.
#[derive(Debug, Default)]
pub(super) struct ReceptionWatch {
    /// Time at which the first pair expired that the peer did not receive. Reset to `None` when the peer receives a
    /// pair, and when the connection is lost.
    no_reception_since: Option<MonoTime>,
    /// `true` if the missing reception was reported and has not ended.
    is_reported: bool,
}

/// A change to report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReceptionReport {
    /// The peer received no pair of messages within the last ten seconds.
    Stopped,
    /// The peer again receives the messages that this host receives.
    Resumed,
}

impl ReceptionWatch {
    /// Records whether the peer received both messages of a pair. Returns a change to report, if there is one.
    pub(super) fn record(&mut self, has_both: bool, now: MonoTime) -> Option<ReceptionReport> {
        if has_both {
            self.no_reception_since = None;
            return std::mem::take(&mut self.is_reported).then_some(ReceptionReport::Resumed);
        }
        let since = *self.no_reception_since.get_or_insert(now);
        if self.is_reported || now - since < REPORT_AFTER {
            return None;
        }
        self.is_reported = true;
        Some(ReceptionReport::Stopped)
    }

    /// Restarts the measurement of the time without reception, because the peer cannot answer without a connection. If
    /// missing reception was reported, it still ends only when the peer has received a pair.
    pub(super) const fn record_disconnect(&mut self) {
        self.no_reception_since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_reception_is_reported_once_until_reception_resumes() {
        let mut watch = ReceptionWatch::default();
        let mut record =
            |has_both, seconds: i64| watch.record(has_both, MonoTime::from_nanos(seconds * 1_000_000_000));
        assert_eq!(record(false, 0), None);
        assert_eq!(record(true, 8), None, "a received pair restarts the measurement");
        assert_eq!((record(false, 9), record(false, 18)), (None, None));
        assert_eq!((record(false, 19), record(false, 40)), (Some(ReceptionReport::Stopped), None));
        assert_eq!((record(true, 41), record(true, 42)), (Some(ReceptionReport::Resumed), None));
    }

    #[test]
    fn time_without_connection_is_not_counted() {
        let mut watch = ReceptionWatch::default();
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        assert_eq!(watch.record(false, at(0)), None);
        watch.record_disconnect();
        assert_eq!((watch.record(false, at(60)), watch.record(false, at(69))), (None, None));
        assert_eq!(watch.record(false, at(70)), Some(ReceptionReport::Stopped));
        watch.record_disconnect();
        assert_eq!(
            (watch.record(false, at(99)), watch.record(false, at(200))),
            (None, None),
            "already reported"
        );
        assert_eq!(watch.record(true, at(201)), Some(ReceptionReport::Resumed));
    }
}
