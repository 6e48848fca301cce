//! Detects that the peer does not receive the messages that this host receives. No I/O.

use peernet_clock::{MonoTime, Span};

/// The silence is reported when the peer has received no pair of messages for this time.
const REPORT_AFTER: Span = Span::from_seconds(10);

/// Watches whether the peer receives the messages that are received here.
#[derive(Debug, Default)]
pub(super) struct SilenceWatch {
    /// Time at which the first pair of the current silence expired.
    since: Option<MonoTime>,
    is_reported: bool,
}

/// A change to report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SilenceReport {
    /// The peer received no pair of messages within the last ten seconds.
    Began,
    /// The peer receives the same messages again.
    Ended,
}

impl SilenceWatch {
    /// Records whether the peer received both messages of a pair. Returns a change to report.
    pub(super) fn record(&mut self, has_both: bool, now: MonoTime) -> Option<SilenceReport> {
        if has_both {
            self.since = None;
            return std::mem::take(&mut self.is_reported).then_some(SilenceReport::Ended);
        }
        let since = *self.since.get_or_insert(now);
        if self.is_reported || now - since < REPORT_AFTER {
            return None;
        }
        self.is_reported = true;
        Some(SilenceReport::Began)
    }

    /// Restarts the measurement of the silence, because the peer cannot answer without a connection. A reported silence
    /// lasts until the peer has received a pair.
    pub(super) const fn record_disconnect(&mut self) {
        self.since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_reported_once_until_it_ends() {
        let mut watch = SilenceWatch::default();
        let mut note =
            |has_both, seconds: i64| watch.record(has_both, MonoTime::from_nanos(seconds * 1_000_000_000));
        assert_eq!(note(false, 0), None);
        assert_eq!(note(true, 8), None, "one that is known begins anew");
        assert_eq!((note(false, 9), note(false, 18)), (None, None));
        assert_eq!((note(false, 19), note(false, 40)), (Some(SilenceReport::Began), None));
        assert_eq!((note(true, 41), note(true, 42)), (Some(SilenceReport::Ended), None));
    }

    #[test]
    fn time_without_connection_is_no_silence_of_the_peer() {
        let mut watch = SilenceWatch::default();
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        assert_eq!(watch.record(false, at(0)), None);
        watch.record_disconnect();
        assert_eq!((watch.record(false, at(60)), watch.record(false, at(69))), (None, None));
        assert_eq!(watch.record(false, at(70)), Some(SilenceReport::Began));
        watch.record_disconnect();
        assert_eq!((watch.record(false, at(99)), watch.record(false, at(200))), (None, None), "said already");
        assert_eq!(watch.record(true, at(201)), Some(SilenceReport::Ended));
    }
}
