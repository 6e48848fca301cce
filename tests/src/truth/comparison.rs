//! Comparison of reported delays with true delays.

use std::collections::BTreeMap;

use peernet_clock::{RawTime, Span};

use super::{Delay, HostClock, Iteration};

/// Reported delays of one direction, compared with the truth.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// Number of delays with a value.
    pub compared: usize,
    /// Descriptions of the delays without a value.
    pub without_value: Vec<String>,
    /// Descriptions of the delays whose interval does not contain the truth.
    pub outside: Vec<String>,
    verdicts: BTreeMap<String, usize>,
    errors: Vec<Span>,
    widths: Vec<Span>,
    truths: Vec<Span>,
}

/// Largest error of the computed truth: the inverse of each clock's drift is rounded, and so are stored values.
const MAX_TRUTH_ERROR: Span = Span::from_nanos(3);

/// Compares the uploads and the downloads.
pub fn compare(iterations: &[Iteration], edge: &HostClock, cloud: &HostClock) -> (Comparison, Comparison) {
    let (mut up, mut down) = (Comparison::default(), Comparison::default());
    for iteration in iterations {
        up.add(iteration, &iteration.up, edge, cloud);
        down.add(iteration, &iteration.down, cloud, edge);
    }
    for comparison in [&mut up, &mut down] {
        comparison.errors.sort();
        comparison.widths.sort();
        comparison.truths.sort();
    }
    (up, down)
}

impl Comparison {
    fn add(&mut self, iteration: &Iteration, delay: &Delay, sender: &HostClock, receiver: &HostClock) {
        let truth = true_delay(delay, sender, receiver);
        self.truths.push(truth);
        let Iteration { run, number, .. } = iteration;
        *self.verdicts.entry(delay.verdict.clone()).or_default() += 1;
        let (Some(value), Some((lo, hi))) = (delay.value, delay.bounds) else {
            self.without_value.push(format!("run {run}, iteration {number}: {} of {truth}", delay.verdict));
            return;
        };
        self.compared += 1;
        self.errors.push((value - truth).abs());
        self.widths.push(hi - lo);
        if truth + MAX_TRUTH_ERROR < lo || hi + MAX_TRUTH_ERROR < truth {
            self.outside.push(format!(
                "run {run}, iteration {number}: {truth} is not in [{lo}, {hi}], {}",
                delay.verdict
            ));
        }
    }

    /// Returns the mean of the absolute errors.
    pub fn mean_error(&self) -> Span {
        mean(&self.errors)
    }

    /// Returns a quantile of the absolute errors.
    pub fn error_quantile(&self, share: f64) -> Span {
        quantile(&self.errors, share)
    }

    /// Returns a quantile of the intervals' widths.
    pub fn width_quantile(&self, share: f64) -> Span {
        quantile(&self.widths, share)
    }

    /// Returns a quantile of the true delays.
    pub fn truth_quantile(&self, share: f64) -> Span {
        quantile(&self.truths, share)
    }

    /// Formats all statistics in one line.
    pub fn summary(&self) -> String {
        format!(
            "{} compared, {} without a value, {} outside; true delay p50 {} p99 {}; error mean {} p50 {} p99 {} max {}; \
             interval's width p50 {} p99 {}; {:?}",
            self.compared,
            self.without_value.len(),
            self.outside.len(),
            self.truth_quantile(0.5),
            self.truth_quantile(0.99),
            self.mean_error(),
            self.error_quantile(0.5),
            self.error_quantile(0.99),
            self.error_quantile(1.0),
            self.width_quantile(0.5),
            self.width_quantile(0.99),
            self.verdicts,
        )
    }
}

/// Returns the true delay, by the stamps of the free-running clocks.
///
/// # Panics
/// If one of the clocks never showed its stamp, or if there are no such stamps.
pub fn true_delay(delay: &Delay, sender: &HostClock, receiver: &HostClock) -> Span {
    let (sent, received) = true_times(delay, sender, receiver);
    received - sent
}

/// Returns the true times of departure and arrival, by the kernel's free-running clock. A clock that was set back
/// shows some times twice; the pair with the shortest delay is the right one, because delays are much shorter than
/// steps.
///
/// # Panics
/// As [`true_delay`].
pub fn true_times(delay: &Delay, sender: &HostClock, receiver: &HostClock) -> (RawTime, RawTime) {
    let (sent, received) = delay.raw.unwrap_or_else(|| panic!("no stamps of free-running clocks: {delay:?}"));
    let arrivals = receiver.raw_truths(received);
    let times = sender.raw_truths(sent).into_iter().flat_map(|sent| {
        let arrivals = arrivals.iter();
        arrivals.map(move |received| (sent, *received))
    });
    times
        .min_by_key(|(sent, received)| (*received - *sent).abs())
        .unwrap_or_else(|| panic!("stamps that were never shown: {delay:?}"))
}

fn mean(spans: &[Span]) -> Span {
    let nanos: i64 = spans.iter().map(|span| span.nanos()).sum();
    Span::from_nanos(nanos / i64::try_from(spans.len().max(1)).unwrap_or(1))
}

/// Returns a quantile of sorted spans; zero if there are none.
fn quantile(sorted: &[Span], share: f64) -> Span {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use peernet_clock::WallTime;

    use super::*;

    #[test]
    fn interval_without_truth_is_detected() {
        let wall_at = WallTime::from_unix_nanos;
        let delay = |raw: i64, lo, hi| Delay {
            sent: wall_at(1_000),
            received: wall_at(1_000 + raw),
            raw: Some((RawTime::from_nanos(500), RawTime::from_nanos(500 + raw))),
            value: Some(Span::from_nanos(150)),
            bounds: Some((Span::from_nanos(lo), Span::from_nanos(hi))),
            verdict: "ok".into(),
            source: "in-band".into(),
        };
        let iteration = |number, up, down| Iteration { run: 1, number, up, down };
        let mut unknown = delay(150, 0, 0);
        unknown.bounds = None;
        let iterations = [
            iteration(1, delay(150, 100, 200), delay(204, 100, 200)),
            iteration(2, delay(110, 100, 200), delay(96, 100, 200)),
            iteration(3, unknown, delay(203, 100, 200)),
        ];
        let of_kernel = HostClock::of_kernel();
        let (up, down) = compare(&iterations, &of_kernel, &of_kernel);
        assert_eq!((up.compared, up.without_value.len(), up.outside.len()), (2, 1, 0));
        assert_eq!((up.mean_error(), up.error_quantile(1.0)), (Span::from_nanos(20), Span::from_nanos(40)));
        assert_eq!((down.compared, down.outside.len()), (3, 2));
        assert_eq!(
            (down.width_quantile(0.5), up.truth_quantile(1.0)),
            (Span::from_nanos(100), Span::from_nanos(150))
        );
    }
}
