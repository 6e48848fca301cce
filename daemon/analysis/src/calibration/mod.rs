//! Calibration of a link: one-way delay against size, the intercept of the linear fit, and the bounds that the clocks
//! allow.
//!
//! The paper's study (IROS 2024, section on network timing) sent payloads of several sizes and fitted a line to the
//! differences of the two hosts' stamps. The study took the intercept of the line, −2.01 ms, as the error of every
//! delay. This module fits a line to corrected delays and compares its intercept with the bounds that the clock
//! relation allows. If the clocks are right, the intercept is the real delay of an empty message. It is then not
//! negative and lies within the bounds that follow from the clock bounds of the smallest payload's delay.

mod clocks;
mod direction;
mod failures;
mod passage;
mod sample;
mod tables;
mod verdict;

pub use clocks::Clocks;
pub use direction::{AllowedDelays, DirectionStudy, FitPair, Fits, Throughput, median_delay};
pub use failures::Failures;
pub use passage::Passage;
pub use sample::Sample;
pub use verdict::{Verdict, VerdictKind};

use std::path::{Path, PathBuf};

use peernet_clock::Direction;
use peernet_stream::ClockSample;
use serde::Serialize;

use crate::{WriteError, outcomes, write_file};

/// Setting of a study, as given by the program that made the study.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Setting {
    /// Address of the peer.
    pub peer: String,
    /// Name of the host that sent the payloads.
    pub edge: String,
    /// Name of the host that answered, as that host reports it; `None` if it never answered.
    pub cloud: Option<String>,
    /// Kind of network.
    pub network: String,
    /// Start of the study, RFC 3339.
    pub started: String,
    /// Version of the program.
    pub version: String,
    /// Payload sizes, bytes.
    pub sizes_bytes: Vec<u64>,
    /// Planned number of times that each size is sent.
    pub repeats: u64,
    /// True if the study ended early.
    pub interrupted: bool,
    /// Reason for an early end, as text; `None` if the study was complete or the user ended it.
    #[serde(rename = "ended")]
    pub end_reason: Option<String>,
    /// Number of times that the peer went away and came back with the same clock. The clocks were related again each
    /// time.
    pub reconnections: u64,
    /// True if the clock of one of the hosts was made wrong on purpose.
    #[serde(rename = "rehearsed")]
    pub has_clock_fault: bool,
}

/// Number of iterations by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Number of answered iterations, without the warm-up. All results are computed from these iterations.
    pub measured: u64,
    /// Number of iterations of the warm-up.
    pub warm_up: u64,
    /// Number of iterations that have no answer, without the warm-up.
    pub failed: u64,
}

/// Complete result of a calibration. The units are seconds, bytes and bits per second.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Setting of the study.
    pub setting: Setting,
    /// Number of iterations by outcome.
    pub counts: Counts,
    /// Numbers of payloads without an answer, by outcome.
    pub failures: Vec<Failures>,
    /// State of the clocks during the study.
    pub clocks: Clocks,
    /// Results from edge to cloud.
    pub up: DirectionStudy,
    /// Results from cloud to edge.
    pub down: DirectionStudy,
    /// Verdict on the delays of the link.
    pub verdict: Verdict,
    /// All iterations, in order.
    #[serde(skip)]
    pub samples: Vec<Sample>,
}

impl Study {
    /// Makes a study from all iterations, which sent payloads of several sizes, and from the samples of the clock
    /// relation during these iterations, one per second.
    pub fn new(setting: Setting, samples: Vec<Sample>, clocks: &[ClockSample]) -> Self {
        let mut by_outcome = outcomes::Counts::default();
        samples.iter().for_each(|sample| by_outcome.add(sample.outcome, sample.warm_up));
        let (measured, failed) = (by_outcome.ok, by_outcome.all_failed());
        let counts = Counts { measured, warm_up: by_outcome.warm_up, failed };
        let up = DirectionStudy::new(Direction::Up, &samples);
        let down = DirectionStudy::new(Direction::Down, &samples);
        let clocks = Clocks::new(clocks, &samples);
        let verdict = Verdict::new(&up, &down, &clocks).with_reconnections(setting.reconnections);
        Self { failures: Failures::by_outcome(&samples), setting, counts, clocks, up, down, verdict, samples }
    }

    /// Writes `samples.csv`, `summary.csv` and `calibration.json` into an existing folder. Returns the paths of the
    /// files.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<Vec<PathBuf>, WriteError> {
        let files =
            vec![folder.join("samples.csv"), folder.join("summary.csv"), folder.join("calibration.json")];
        tables::write_samples(&self.samples, &files[0])?;
        tables::write_summary(self, &files[1])?;
        let json = serde_json::to_vec_pretty(self).map_err(WriteError::at(&files[2]))?;
        write_file(&files[2], &json)?;
        Ok(files)
    }

    /// Returns the text for a terminal: a table of sizes, a table of fits, reasons for payloads without an answer, and
    /// the verdict.
    pub fn text(&self) -> String {
        let fault_note = "clock fault injection: the clock of one of the hosts was made wrong on purpose";
        let fault_note = if self.setting.has_clock_fault { fault_note } else { "" };
        let failures = failures::sentence(&self.failures, self.counts.measured + self.counts.failed);
        let (sizes, fits) = (tables::sizes_text(self), tables::fits_text(self));
        let paragraphs = [&sizes, &fits, &failures, fault_note, &self.verdict.sentence];
        paragraphs.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("\n\n")
    }

    /// Returns both directions, edge to cloud first.
    pub fn directions(&self) -> [&DirectionStudy; 2] {
        [&self.up, &self.down]
    }
}

#[cfg(test)]
mod tests;
