//! Study of a sensor alone: its rate, its jitter, and its dropped samples.

use peernet_statistics::Moments;
use peernet_statistics::number::{counted, fixed, milliseconds, significant};

use crate::order::{MIN_VALUES_FOR_P95, SortedValues};
use crate::rows::{Outcome, RowRef, Rows};
use crate::table::Table;

/// Suffix of the columns in which sensors report their dropped samples.
const DROPPED_SAMPLES_SUFFIX: &str = "dropped-samples";

/// Periods and jitter of a sensor, from the samples of a run. Seconds, and samples per second.
///
/// A sample's moment is when it was ready: the start of its iteration plus its `sensing`. A period lies between the moments of two samples
/// that follow each other; warm-up is left out. The jitter of a period is its distance from the median period, in either direction.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorStudy {
    /// Samples that the sensor returned.
    pub samples: u64,
    /// Iterations in which it failed to return a sample.
    pub failed: u64,
    /// Samples per second: one over the mean period.
    pub rate: f64,
    /// Mean period.
    pub period: f64,
    /// Sample standard deviation of the periods; `None` below two.
    pub period_std: Option<f64>,
    /// Median period.
    pub median: f64,
    /// Percentiles of the jitter; `None` below 60 and 300 periods.
    pub jitter_p95: Option<f64>,
    /// 99th percentile of the jitter, like `jitter_p95`.
    pub jitter_p99: Option<f64>,
    /// Median jitter.
    pub jitter_median: f64,
    /// The longest time without a sample, failed iterations included.
    pub longest_gap: f64,
    /// Iteration that ended this gap.
    pub longest_gap_at: u64,
    /// Median time from asking for a sample to having it.
    pub sensing: f64,
    /// Samples that the sensor reports as dropped; `None` without such a report.
    pub dropped: Option<u64>,
}

/// Sample of the sensor: its iteration and its moment.
#[derive(Clone, Copy, Debug)]
struct SampleTime {
    iteration: u64,
    at: f64,
}

impl SensorStudy {
    /// Returns the study of these rows, in any order; `None` with fewer than two samples that follow each other.
    pub fn from_rows(rows: &Rows) -> Option<Self> {
        let measured = || rows.iter().filter(|row| !row.warm_up());
        let mut taken: Vec<SampleTime> = measured().filter_map(taken).collect();
        taken.sort_unstable_by_key(|taken| taken.iteration);
        let follow = |pair: &&[SampleTime]| pair[1].iteration == pair[0].iteration + 1;
        let length = |pair: &[SampleTime]| pair[1].at - pair[0].at;
        let periods: SortedValues = taken.windows(2).filter(follow).map(length).collect();
        let median = periods.median()?;
        let mut moments = Moments::default();
        periods.values().iter().for_each(|period| moments.record(*period));
        let jitter: SortedValues = periods.values().iter().map(|period| (period - median).abs()).collect();
        let gap = taken.windows(2).max_by(|a, b| length(a).total_cmp(&length(b)))?;
        let sensing: SortedValues = measured().filter_map(|row| row.value("sensing")).collect();
        Some(Self {
            samples: taken.len() as u64,
            failed: measured().filter(|row| row.outcome() != Outcome::Ok).count() as u64,
            rate: 1.0 / moments.mean,
            period: moments.mean,
            period_std: moments.std(),
            median,
            jitter_p95: jitter.p95(),
            jitter_p99: jitter.p99(),
            jitter_median: jitter.median()?,
            longest_gap: length(gap),
            longest_gap_at: gap[1].iteration,
            sensing: sensing.median()?,
            dropped: dropped(rows),
        })
    }

    /// Returns the results in sentences.
    pub fn sentences(&self) -> Vec<String> {
        let mut said = vec![format!(
            "The sensor ran at {} samples per second: one every {} ms{}, over {}.",
            significant(self.rate),
            milliseconds(self.period),
            self.period_std.map_or_else(String::new, |std| format!(" ± {} ms", milliseconds(std))),
            counted(self.samples, "sample"),
        )];
        let tail = self.jitter_p99.map(|p99| ("99", p99)).or(self.jitter_p95.map(|p95| ("95", p95)));
        said.push(match tail {
            Some((percent, value)) => format!(
                "Its period was within {} ms of the median ({} ms) for half of the samples, and within {} ms for {percent} %.",
                milliseconds(self.jitter_median),
                milliseconds(self.median),
                milliseconds(value),
            ),
            None => format!(
                "Its period was within {} ms of the median ({} ms) for half of the samples; {MIN_VALUES_FOR_P95} are needed to \
                 say more.",
                milliseconds(self.jitter_median),
                milliseconds(self.median),
            ),
        });
        said.push(format!(
            "The longest time without a sample was {} ms, before iteration {}.",
            milliseconds(self.longest_gap),
            self.longest_gap_at
        ));
        said.push(match self.dropped {
            None => "It does not number its samples, so whether it dropped any is not known.".to_owned(),
            Some(0) => "It dropped no sample.".to_owned(),
            Some(dropped) => {
                let share = dropped as f64 / (dropped + self.samples) as f64 * 100.0;
                format!("It dropped {}, {} % of all.", counted(dropped, "sample"), significant(share))
            }
        });
        if self.failed > 0 {
            said.push(format!("It failed to give a sample {}.", counted(self.failed, "time")));
        }
        said
    }

    /// Returns the sentences, one on a line, and the table.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.sentences().join("\n"), self.table().text())
    }

    /// Returns the table of figures.
    pub fn table(&self) -> Table {
        let unknown = || "—".to_owned();
        let ms = |value: Option<f64>| value.map_or_else(unknown, milliseconds);
        let count = |value: u64| fixed(value as f64, 0);
        let rows = [
            ("samples", count(self.samples), ""),
            ("rate", significant(self.rate), "/s"),
            ("period, mean", milliseconds(self.period), "ms"),
            ("period, std", ms(self.period_std), "ms"),
            ("period, median", milliseconds(self.median), "ms"),
            ("jitter, median", milliseconds(self.jitter_median), "ms"),
            ("jitter, p95", ms(self.jitter_p95), "ms"),
            ("jitter, p99", ms(self.jitter_p99), "ms"),
            ("longest gap", milliseconds(self.longest_gap), "ms"),
            ("sensing, median", milliseconds(self.sensing), "ms"),
            ("dropped samples", self.dropped.map_or_else(unknown, count), ""),
            ("failed", count(self.failed), ""),
        ];
        Table {
            header: ["quantity", "value", "unit"].map(str::to_owned).into(),
            labels: 1,
            rows: rows.map(|(name, value, unit)| vec![name.to_owned(), value, unit.to_owned()]).into(),
            marked: Vec::new(),
        }
    }
}

fn taken(row: RowRef<'_>) -> Option<SampleTime> {
    let at = row.value("at").filter(|_| row.outcome() == Outcome::Ok)?;
    // An iteration with a planned start begins late by its lateness; one without a plan has none.
    let at = at + row.value("lateness").unwrap_or(0.0) + row.value("sensing")?;
    Some(SampleTime { iteration: row.iteration(), at })
}

fn dropped(rows: &Rows) -> Option<u64> {
    let columns = rows.names().iter().filter(|column| column.ends_with(DROPPED_SAMPLES_SUFFIX));
    let measured = || rows.iter().filter(|row| !row.warm_up());
    let told = columns.flat_map(|column| measured().filter_map(move |row| row.value(column)));
    told.reduce(|sum, value| sum + value).map(|sum| sum.max(0.0).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Row;

    /// Returns a sample each 20 ms, every fourth one 8 ms late, ready 5 ms after its request.
    fn rows(count: u64) -> Vec<Row> {
        let row = |iteration: u64| {
            let late = if iteration.is_multiple_of(4) { 0.008 } else { 0.0 };
            Row {
                iteration,
                at: 1000.0 + iteration as f64 * 0.02 + late,
                episode: 0,
                step: 0,
                warm_up: iteration <= 3,
                outcome: Outcome::Ok,
                reason: None,
                values: vec![("sensing".into(), 0.005)],
                upload: None,
                download: None,
            }
        };
        (1..=count).map(row).collect()
    }

    fn study(rows: Vec<Row>) -> Option<SensorStudy> {
        SensorStudy::from_rows(&rows.into_iter().collect())
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-6
    }

    #[test]
    fn study_has_rate_period_and_jitter() {
        let study = study(rows(403)).expect("samples");
        assert_eq!((study.samples, study.failed, study.dropped), (400, 0, None));
        assert!(close(study.median, 0.02) && (study.rate - 50.0).abs() < 0.1, "{study:?}");
        assert!(close(study.jitter_median, 0.004) || close(study.jitter_median, 0.0), "{study:?}");
        assert!(close(study.jitter_p99.expect("enough"), 0.008), "{study:?}");
        assert!(close(study.longest_gap, 0.028) && close(study.sensing, 0.005));
        assert!(study.sentences()[0].contains("one every 20"), "{:?}", study.sentences());
        assert!(study.text().contains("longest gap"), "{}", study.text());
    }

    #[test]
    fn failed_sample_is_gap_without_period() {
        let mut rows = rows(20);
        rows[9].outcome = Outcome::Failed;
        let study = study(rows).expect("samples");
        assert_eq!((study.failed, study.samples, study.longest_gap_at), (1, 16, 11));
        assert!(close(study.longest_gap, 0.04));
        assert!(study.jitter_p95.is_none(), "too few");
    }

    #[test]
    fn reported_dropped_samples_are_summed() {
        let mut rows = rows(103);
        for row in &mut rows {
            let dropped = if row.iteration.is_multiple_of(10) { 3.0 } else { 0.0 };
            row.values.push(("sensing_capture_dropped-samples".into(), dropped));
        }
        let study = study(rows).expect("samples");
        assert_eq!(study.dropped, Some(30));
        assert!(study.sentences().iter().any(|said| said.contains("30 samples")), "{:?}", study.sentences());
    }

    #[test]
    fn fewer_than_two_samples_give_no_study() {
        assert_eq!(study(rows(4)), None);
        assert_eq!(study(Vec::new()), None);
    }
}
