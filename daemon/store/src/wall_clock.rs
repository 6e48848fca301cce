//! Detection of steps of the aggregator's wall clock. Free of I/O: the readings of the clocks are arguments.

use peernet_clock::{Span, Stamp, WallTime};

/// Smallest step that is reported. No step deletes data. A smaller step shifts the times on pages by only a few seconds,
/// so it is not reported.
const MIN_STEP: Span = Span::from_seconds(10);

/// Comparison of the wall clock with the monotonic clock, which no program can step.
#[derive(Debug)]
pub(super) struct WallClockWatch {
    /// Readings of the clocks at the last check.
    last: Stamp,
}

impl WallClockWatch {
    /// Starts watching.
    pub(super) const fn new(now: Stamp) -> Self {
        Self { last: now }
    }

    /// Returns a description if the wall clock shows an earlier time than `last_stored`, its reading at the last commit
    /// to the database. Differences below [`MIN_STEP`] are ignored.
    pub(super) fn compare_with_last_commit(now: Stamp, last_stored: WallTime) -> Option<String> {
        let step = now.wall - last_stored;
        (step <= -MIN_STEP).then(|| {
            format!(
                "this aggregator's wall clock shows {} less than when the aggregator last stored something: the clock was \
                 set back while the aggregator did not run, or the clock was wrong before",
                format_span(step)
            )
        })
    }

    /// Returns a description if the wall clock was stepped since the last call.
    pub(super) fn check_step(&mut self, now: Stamp) -> Option<String> {
        let step = (now.wall - self.last.wall) - (now.mono - self.last.mono);
        self.last = now;
        (step.abs() >= MIN_STEP).then(|| {
            let direction = if step.is_negative() { "back" } else { "forward" };
            let cause = if step.is_negative() { "" } else { ", or the machine slept" };
            format!("this aggregator's wall clock was set {direction} by {}{cause}", format_span(step))
        })
    }
}

/// Formats a length of time without its sign.
fn format_span(span: Span) -> String {
    let seconds = span.abs().seconds();
    match seconds {
        172_800.0.. => format!("{:.1} days", seconds / 86_400.0),
        7_200.0.. => format!("{:.1} h", seconds / 3_600.0),
        _ => format!("{seconds:.1} s"),
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{MonoTime, RawTime};

    use super::*;

    const fn stamp(wall_s: i64, mono_s: i64) -> Stamp {
        Stamp {
            wall: WallTime::from_unix_nanos(wall_s * 1_000_000_000),
            mono: MonoTime::from_nanos(mono_s * 1_000_000_000),
            raw: RawTime::from_nanos(mono_s * 1_000_000_000),
        }
    }

    #[test]
    fn step_is_reported_once_with_amount_and_direction() {
        let mut watch = WallClockWatch::new(stamp(1_000, 0));
        // The wall clock advanced 9 s more than the monotonic clock: too little for a step, although the last check was
        // long ago.
        assert_eq!(watch.check_step(stamp(9_000_009, 9_000_000 - 1_000)), None);
        let month = 30 * 86_400;
        let forward = watch.check_step(stamp(9_000_010 + month, 9_000_001 - 1_000)).expect("a step");
        assert!(forward.contains("set forward by 30.0 days"), "{forward}");
        assert_eq!(watch.check_step(stamp(9_000_011 + month, 9_000_002 - 1_000)), None);
        let back = watch.check_step(stamp(9_000_012 - 60, 9_000_003 - 1_000)).expect("a step");
        assert!(back.contains("set back by 30.0 days"), "{back}");
    }

    #[test]
    fn start_before_stored_time_is_reported() {
        assert_eq!(WallClockWatch::compare_with_last_commit(stamp(1_000, 0), stamp(1_009, 0).wall), None);
        assert_eq!(WallClockWatch::compare_with_last_commit(stamp(9_000_000, 0), stamp(1_000, 0).wall), None);
        let text = WallClockWatch::compare_with_last_commit(stamp(1_000, 0), stamp(1_000 + 10_800, 0).wall)
            .expect("a step");
        assert!(text.contains("3.0 h less"), "{text}");
    }
}
