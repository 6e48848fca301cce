//! Runs for tests: noise that is the same each time, rows of it, and what a report says of them.

use peernet_stream::{Condition, Grade};

use super::Report;
use crate::rows::{Outcome, Row, Rows};

/// A generator of pseudo-random numbers (splitmix64, Steele et al. 2014).
pub(super) struct Noise(u64);

impl Noise {
    pub(super) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// From 0 to 1.
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal, mean 0, deviation 1 (Irwin–Hall of twelve).
    pub(super) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A row whose total is mostly inference.
pub(crate) fn row(iteration: u64, seconds: f64) -> Row {
    let values = [("inference", seconds * 0.99), ("total", seconds), ("unattributed", seconds * 0.01)];
    Row {
        iteration,
        at: iteration as f64,
        episode: 0,
        step: 0,
        warm_up: iteration <= 5,
        outcome: Outcome::Ok,
        reason: None,
        values: values.map(|(name, value)| (name.into(), value)).to_vec(),
        upload: None,
        download: None,
    }
}

pub(crate) fn rows(totals: impl IntoIterator<Item = f64>) -> Rows {
    (1..).zip(totals).map(|(iteration, seconds)| row(iteration, seconds)).collect()
}

/// 10 ms, give or take a per cent, none slow.
pub(crate) fn quiet(count: usize) -> Vec<f64> {
    let mut noise = Noise::new(7);
    (0..count).map(|_| 0.010 * (1.0 + 0.01 * noise.normal())).collect()
}

pub(crate) fn governor(grade: Grade) -> Condition {
    Condition {
        host: "robot".to_owned(),
        about: "CPU governor".to_owned(),
        found: "as it is".to_owned(),
        grade,
        advice: if grade > Grade::Unknown { "change it".to_owned() } else { String::new() },
    }
}

/// The grade and the text of what is said about a subject.
pub(crate) fn about<'a>(report: &'a Report, subject: &str) -> (Grade, &'a str) {
    let mut found = report.sentences.iter().filter(|sentence| sentence.about == subject);
    let sentence = found.next().unwrap_or_else(|| panic!("nothing about {subject}: {report:#?}"));
    assert!(found.next().is_none(), "more than one about {subject}");
    (sentence.grade, &sentence.text)
}
