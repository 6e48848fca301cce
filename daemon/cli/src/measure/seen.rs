//! How far a run is, for whoever shows it.

use std::fmt;

use peernet_statistics::number;
use peernet_stream::Condition;
use serde::{Deserialize, Serialize};

use crate::foreground::{duration, told};

/// How far a run is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Seen {
    /// What it does.
    pub(crate) phase: Phase,
    /// Iterations that are over.
    pub(crate) done: u64,
    /// Of how many; `None` when time sets the end.
    pub(crate) of: Option<u64>,
    /// Iterations per second since the first.
    pub(crate) rate: f64,
    /// Median of the total so far, seconds.
    pub(crate) p50: Option<f64>,
    /// Its 99th percentile, once there are values enough for it.
    pub(crate) p99: Option<f64>,
    /// How long it will take still, seconds; `None` while nobody can tell.
    pub(crate) left_s: Option<f64>,
    /// What it waits for, where it should not have to.
    pub(crate) trouble: Option<String>,
}

impl fmt::Display for Seen {
    /// In words: `120 of 10005, 9.8 /s, total p50 101 ms, p99 104 ms, 17 min left`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.phase == Phase::Starting {
            return f.write_str("starting");
        }
        write!(f, "{}", self.done)?;
        if let Some(of) = self.of {
            write!(f, " of {of}")?;
        }
        write!(f, ", {} /s", number::fixed(self.rate, 1))?;
        // None while it warms up.
        if let Some(p50) = self.p50 {
            write!(f, ", total {}", told(p50, self.p99))?;
        }
        self.left_s.map_or(Ok(()), |left| write!(f, ", {} left", duration(left)))
    }
}

/// What a run does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Phase {
    /// Sensor and model are set up, the peer is asked.
    Starting,
    /// It measures what is left out of statistics.
    WarmUp,
    /// It measures.
    Measuring,
    /// It waits for a peer that went away.
    Waiting,
    /// It writes its files.
    Writing,
}

/// Whoever shows how far a run is.
pub(crate) trait Watcher {
    /// Is told what was found of the hosts when the run began.
    fn begun(&mut self, _conditions: &[Condition]) {}

    /// Is shown the state, several times a second.
    fn look(&mut self, seen: &Seen);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_is_told_in_one_line() {
        let seen = Seen {
            phase: Phase::Measuring,
            done: 120,
            of: Some(10_005),
            rate: 9.81,
            p50: Some(0.1012),
            p99: None,
            left_s: Some(1007.6),
            trouble: None,
        };
        assert_eq!(seen.to_string(), "120 of 10005, 9.8 /s, total p50 101 ms, 17 min left");
        let warming_up = Seen { done: 3, p50: None, ..seen };
        assert_eq!(warming_up.to_string(), "3 of 10005, 9.8 /s, 17 min left");
    }
}
