//! Period and jitter of a topic's messages. No I/O.

use peernet_clock::{MonoTime, Span};

/// Latest arrival and latest period of a topic's messages.
#[derive(Debug, Default)]
pub(super) struct Arrivals {
    latest_arrival: Option<MonoTime>,
    latest_period: Option<Span>,
}

/// Period and jitter at the arrival of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Arrival {
    /// Time since the previous message.
    pub(super) period: Option<Span>,
    /// Absolute difference between this period and the previous one.
    pub(super) jitter: Option<Span>,
}

impl Arrivals {
    /// Records the arrival of a message.
    pub(super) fn record(&mut self, at: MonoTime) -> Arrival {
        let period = self.latest_arrival.replace(at).map(|previous_arrival| at - previous_arrival);
        let previous_period = std::mem::replace(&mut self.latest_period, period);
        let jitter =
            period.zip(previous_period).map(|(period, previous_period)| (period - previous_period).abs());
        Arrival { period, jitter }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_and_their_differences_are_recorded() {
        let mut arrivals = Arrivals::default();
        let mut record = |millis: i64| arrivals.record(MonoTime::from_nanos(millis * 1_000_000));
        assert_eq!(record(0), Arrival::default());
        assert_eq!(record(20), Arrival { period: Some(Span::from_millis(20)), ..Arrival::default() });
        let early = record(35);
        assert_eq!((early.period, early.jitter), (Some(Span::from_millis(15)), Some(Span::from_millis(5))));
    }
}
