//! Rate limit of log lines about refused probes, with advice for each reason. No sender can fill the log.

use peernet_clock::{MonoTime, Span};

use crate::Refusal;

/// Shortest interval between two log lines with the same reason, for all sources together.
const LOG_INTERVAL: Span = Span::from_seconds(60);

/// State of the log lines about refused probes.
#[derive(Debug)]
pub(crate) struct RefusalLog {
    /// `true` if the reflector has a key. The advice is different then.
    has_key: bool,
    /// For each reason, the time of its last log line and the number of probes refused for it since then.
    reasons: [(Option<MonoTime>, u64); Refusal::ALL.len()],
}

impl RefusalLog {
    /// Creates the state for a reflector with or without a key.
    pub(crate) fn new(has_key: bool) -> Self {
        Self { has_key, reasons: [(None, 0); Refusal::ALL.len()] }
    }

    /// Counts a refused probe. If a log line is due, returns the number of probes refused for this reason since the
    /// last line, and the advice.
    pub(crate) fn record(&mut self, reason: Refusal, now: MonoTime) -> Option<(u64, &'static str)> {
        let (last_line_at, count) = &mut self.reasons[reason as usize];
        *count += 1;
        if last_line_at.is_some_and(|last_line_at| now - last_line_at < LOG_INTERVAL) {
            return None;
        }
        *last_line_at = Some(now);
        let count = std::mem::take(count);
        let advice = match (reason, self.has_key) {
            (Refusal::Short, true) => {
                "the probe was probably sent without a key; with [probes] key_file both ends need the same key"
            }
            (Refusal::Unauthenticated, _) => {
                "the sender of the probe has another key or none; with [probes] key_file both ends need the same key"
            }
            (Refusal::TooOften, _) => {
                "raise [probes] max_per_source_hz on this host, or lower [probes] rate_hz on the source of the probes"
            }
            (Refusal::TooMany, _) => {
                "peers with a session are still answered; check which hosts send too many probes, or raise [probes] max_per_source_hz"
            }
            (Refusal::Short, false) | (Refusal::NoPort | Refusal::Reply, _) => {
                "the packet is not a probe of a peer; check which program sends it"
            }
            (Refusal::NotSent, _) => {
                "check that the network and the firewall of this machine let UDP packets out"
            }
        };
        Some((count, advice))
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{Clock, ClockIdentity, ManualClock, WallTime};

    use super::*;

    #[test]
    fn each_reason_is_logged_once_a_minute() {
        let clock = ManualClock::new(WallTime::from_unix_nanos(0), ClockIdentity::new("boot", "clock"));
        let mut refusal_log = RefusalLog::new(true);
        let mut logged = Vec::new();
        for _ in 0..1_210 {
            logged.extend(refusal_log.record(Refusal::Short, clock.mono()));
            clock.advance(Span::from_millis(100));
        }
        let counts: Vec<u64> = logged.iter().map(|(count, _)| *count).collect();
        assert_eq!(counts, [1, 600, 600], "{logged:?}");
        assert!(logged.iter().all(|(_, advice)| advice.contains("key_file")), "{logged:?}");
        assert!(refusal_log.record(Refusal::Unauthenticated, clock.mono()).is_some(), "another reason");
        assert!(
            refusal_log
                .record(Refusal::TooOften, clock.mono())
                .is_some_and(|(_, advice)| !advice.contains("key"))
        );
        let advice = RefusalLog::new(false).record(Refusal::Short, clock.mono());
        assert!(advice.is_some_and(|(_, advice)| !advice.contains("key")), "{advice:?}");
    }
}
