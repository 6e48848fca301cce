//! The kernel's claim about the wall clock, `adjtimex(2)`, which time daemons maintain.

use std::io;

use peernet_clock::{DelaySource, Interval, MonoTime, Span};

use super::claim::{Claim, FREQUENCY_TOLERANCE_PPM, SourceReport};
use super::timex::{self, Timex};

/// Microseconds that the kernel adds to its bound each second (`MAXFREQ`) until a daemon sets the bound again.
const KERNEL_GROWTH_US: i64 = 500;

/// Queries the kernel and returns its report.
pub(super) fn query(now: MonoTime) -> SourceReport {
    report_from(timex::read(), now)
}

fn report_from(state: io::Result<Timex>, now: MonoTime) -> SourceReport {
    let (bound, text) = match state {
        Err(error) => (None, format!("kernel: adjtimex: {error}")),
        Ok(state) => error_bound(state),
    };
    let claim = bound.map(|bound| Claim {
        at: now,
        error: Interval { lo: -bound, hi: bound },
        growth_ppm: FREQUENCY_TOLERANCE_PPM,
    });
    SourceReport { source: DelaySource::Kernel, claim, text }
}

/// Returns the bound of the error, and the state as a text.
fn error_bound(state: Timex) -> (Option<Span>, String) {
    let Timex { is_synchronised, max_error_us, estimated_error_us } = state;
    if !is_synchronised {
        return (None, "kernel, not synchronised".to_owned());
    }
    // chrony, ntpd and ntpd-rs set both `maxerror` and `esterror`. If `maxerror` consists of the kernel's own growth
    // only, the daemon states no error.
    if max_error_us % KERNEL_GROWTH_US != 0 {
        return (Some(Span::from_micros(max_error_us)), "kernel, synchronised".to_owned());
    }
    if estimated_error_us == 0 {
        // systemd-timesyncd sets both fields to zero, whether the error is microseconds or tens of milliseconds.
        return (None, "kernel, synchronised by a daemon that states no error".to_owned());
    }
    // phc2sys sets only `maxerror` to zero, at each update, once a second or more often. Zero is no bound, so the
    // kernel's growth in one second is the smallest bound.
    let bound = max_error_us.max(KERNEL_GROWTH_US);
    (Some(Span::from_micros(bound)), "kernel, synchronised, probably by PTP".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bound_and_text(
        is_synchronised: bool,
        max_error_us: i64,
        estimated_error_us: i64,
    ) -> (Option<Span>, String) {
        let state = Timex { is_synchronised, max_error_us, estimated_error_us };
        let report = report_from(Ok(state), MonoTime::from_nanos(0));
        (report.claim.map(|claim| claim.error.hi), report.text)
    }

    #[test]
    fn stated_bound_of_daemon_is_used() {
        assert_eq!(
            bound_and_text(true, 27_503, 311),
            (Some(Span::from_micros(27_503)), "kernel, synchronised".to_owned())
        );
    }

    #[test]
    fn unsynchronised_kernel_claims_nothing() {
        assert_eq!(
            bound_and_text(false, 16_000_000, 16_000_000),
            (None, "kernel, not synchronised".to_owned())
        );
    }

    #[test]
    fn kernel_growth_without_estimate_of_daemon_is_no_bound() {
        let (bound, text) = bound_and_text(true, 123_000, 0);
        assert_eq!(bound, None);
        assert!(text.contains("states no error"), "{text}");
    }

    #[test]
    fn ptp_clock_has_bound_of_one_second_of_growth() {
        // phc2sys has just set `maxerror` to zero.
        assert_eq!(bound_and_text(true, 0, 16_000_000).0, Some(Span::from_micros(500)));
        // The kernel has already added the growth of two seconds.
        assert_eq!(bound_and_text(true, 1000, 16_000_000).0, Some(Span::from_micros(1000)));
    }

    #[test]
    fn kernel_of_this_machine_answers() {
        let report = query(MonoTime::from_nanos(0));
        assert!(report.text.starts_with("kernel, "), "{}", report.text);
    }
}
