//! Outcomes of iterations.

use peernet_statistics::number::count;
use peernet_stream::OutcomeCounts;
use serde::{Deserialize, Serialize};

use crate::rows::{Outcome, RowRef, Rows};

/// Number of iterations by outcome. Warm-up iterations are counted separately, with any outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Counts {
    /// Number of successful iterations. Statistics are computed from these iterations.
    pub ok: u64,
    /// Number of iterations whose sample, model or actuator failed.
    pub failed: u64,
    /// Number of iterations whose connection broke.
    pub lost: u64,
    /// Number of iterations without an answer in time.
    pub timeout: u64,
    /// Number of warm-up iterations.
    pub warm_up: u64,
    /// Number of iterations that were measured, but that this program was too busy to receive.
    pub unseen: u64,
}

impl Counts {
    /// Returns the numbers of rows by outcome. `unseen` is the number of iterations that were measured but have no row.
    pub fn from_rows<'a>(rows: impl IntoIterator<Item = RowRef<'a>>, unseen: u64) -> Self {
        let mut counts = Self { unseen, ..Self::default() };
        rows.into_iter().for_each(|row| counts.add(row.outcome(), row.warm_up()));
        counts
    }

    /// Counts an iteration.
    pub fn add(&mut self, outcome: impl Into<Outcome>, warm_up: bool) {
        let count = match outcome.into() {
            _ if warm_up => &mut self.warm_up,
            Outcome::Ok => &mut self.ok,
            Outcome::Failed => &mut self.failed,
            Outcome::Lost => &mut self.lost,
            Outcome::Timeout => &mut self.timeout,
        };
        *count += 1;
    }

    /// Returns the number of iterations of all outcomes, without the warm-up and without the iterations in
    /// [`unseen`](Self::unseen).
    pub const fn measured(&self) -> u64 {
        self.outcomes().total()
    }

    /// Returns the number of iterations of all outcomes with the warm-up, but without the iterations in
    /// [`unseen`](Self::unseen).
    pub fn measured_with_warm_up(&self) -> u64 {
        let counts = [self.ok, self.failed, self.lost, self.timeout, self.warm_up];
        // Counts from a file can be any numbers.
        counts.into_iter().fold(0, u64::saturating_add)
    }

    /// Returns the number of iterations whose outcome is not `ok`, without the warm-up.
    pub const fn all_failed(&self) -> u64 {
        self.outcomes().all_failed()
    }

    /// Returns the numbers of iterations by outcome, without the warm-up.
    pub const fn outcomes(&self) -> OutcomeCounts {
        OutcomeCounts { ok: self.ok, failed: self.failed, lost: self.lost, timeout: self.timeout }
    }
}

/// Returns the number of warm-up iterations whose outcome is not `ok`. [`Counts`] has these iterations in `warm_up`
/// only.
pub fn failed_in_warm_up(rows: &Rows) -> u64 {
    rows.iter().filter(|row| is_failed_warm_up(row.outcome(), row.warm_up())).count() as u64
}

/// Returns whether an iteration is a warm-up iteration whose outcome is not `ok`.
pub fn is_failed_warm_up(outcome: Outcome, warm_up: bool) -> bool {
    warm_up && outcome != Outcome::Ok
}

/// Returns the share of the iterations whose outcome is not `ok`, 0 to 1; `None` without iterations.
pub fn failed_share(counts: &OutcomeCounts) -> Option<f64> {
    let total = counts.total();
    (total > 0).then(|| counts.all_failed() as f64 / total as f64)
}

/// Returns a text for each outcome other than `ok` that occurred: its number of iterations and its name, such as
/// `2 lost`.
pub fn failed_texts(counts: &OutcomeCounts) -> Vec<String> {
    let outcomes = [
        (counts.failed, "with an error of sensor, model or actuator"),
        (counts.lost, Outcome::Lost.display_name()),
        (counts.timeout, Outcome::Timeout.display_name()),
    ];
    let occurred = outcomes.into_iter().filter(|(number, _)| *number > 0);
    occurred.map(|(number, outcome)| format!("{} {outcome}", count(number))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_losses_and_timeouts_count_as_failed() {
        let counts = OutcomeCounts { ok: 15, failed: 1, lost: 2, timeout: 2 };
        assert_eq!(failed_share(&counts), Some(0.25));
        assert_eq!(failed_share(&OutcomeCounts::default()), None);
        let texts = ["1 with an error of sensor, model or actuator", "2 lost", "2 timed out"];
        assert_eq!(failed_texts(&counts), texts);
        assert!(failed_texts(&OutcomeCounts { ok: 3, ..OutcomeCounts::default() }).is_empty());
    }
}
