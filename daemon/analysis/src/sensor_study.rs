//! Study of a sensor alone: its rate, its jitter, and its dropped samples.

use peernet_logger::stage;
use peernet_statistics::number::{NONE, count, counted, milliseconds, percent, rate};
use peernet_statistics::{MIN_VALUES_FOR_P95, Moments};

use crate::order::SortedValues;
use crate::outcomes::Counts;
use crate::rows::{Outcome, RowRef, Rows};
use crate::table::Table;

/// Rate, periods and jitter of a sensor, from the samples of a run. Times are in seconds.
///
/// The time of a sample is the time at which it was ready: the start of its iteration plus its `sensing`. A period is
/// the time between two consecutive samples, without the warm-up. The jitter of a period is its absolute difference
/// from the median period.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorStudy {
    /// Number of samples that the sensor returned.
    pub samples: u64,
    /// Number of iterations in which the sensor failed to return a sample.
    pub failed: u64,
    /// Samples per second: 1 / mean period.
    pub rate: f64,
    /// Mean period.
    pub period: f64,
    /// Sample standard deviation of the periods; `None` for a single period.
    pub period_std: Option<f64>,
    /// Median period.
    pub median: f64,
    /// 95th percentile of the jitter; `None` below 60 periods.
    pub jitter_p95: Option<f64>,
    /// 99th percentile of the jitter; `None` below 300 periods.
    pub jitter_p99: Option<f64>,
    /// Median jitter.
    pub jitter_median: f64,
    /// Longest time between two successive samples. Failed iterations may lie between these samples.
    pub longest_gap: f64,
    /// Number of the iteration whose sample ended the longest gap.
    pub longest_gap_at: u64,
    /// Median time from the request for a sample until the sample was ready.
    pub sensing: f64,
    /// Number of samples that the sensor reports as dropped; `None` if the sensor does not report them.
    pub dropped: Option<u64>,
}

/// Iteration and time of a sample of the sensor.
#[derive(Clone, Copy, Debug)]
struct SampleTime {
    iteration: u64,
    at: f64,
}

impl SensorStudy {
    /// Returns the study of these rows, which may be in any order. `None` if no two consecutive iterations have a
    /// sample.
    // A time across a failed iteration is no period of the sensor: it would contain the failure.
    pub fn from_rows(rows: &Rows) -> Option<Self> {
        let measured = rows.iter().filter(|row| !row.warm_up());
        let mut sample_times: Vec<SampleTime> = measured.filter_map(sample_time).collect();
        sample_times.sort_unstable_by_key(|sample| sample.iteration);
        let are_consecutive = |pair: &&[SampleTime]| pair[1].iteration == pair[0].iteration + 1;
        let length = |pair: &[SampleTime]| pair[1].at - pair[0].at;
        let periods: SortedValues = sample_times.windows(2).filter(are_consecutive).map(length).collect();
        let median = periods.median()?;
        let mut moments = Moments::default();
        periods.values().iter().for_each(|period| moments.record(*period));
        let jitter: SortedValues = periods.values().iter().map(|period| (period - median).abs()).collect();
        let gap = sample_times.windows(2).max_by(|a, b| length(a).total_cmp(&length(b)))?;
        // Failed iterations are left out: they measured how long the sensor failed, such as a time limit, and not how
        // long a sample took.
        let sensing: SortedValues = rows.values_in_statistics("sensing").collect();
        Some(Self {
            samples: sample_times.len() as u64,
            failed: Counts::from_rows(rows, 0).all_failed(),
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
            dropped: dropped_samples(rows),
        })
    }

    /// Returns the results in sentences.
    pub fn sentences(&self) -> Vec<String> {
        let mut sentences = vec![format!(
            "The sensor ran at {} samples per second: one every {} ms{}, over {}.",
            rate(self.rate),
            milliseconds(self.period),
            self.period_std.map_or_else(String::new, |std| format!(" ± {} ms", milliseconds(std))),
            counted(self.samples, "sample"),
        )];
        let tail = self.jitter_p99.map(|p99| ("99", p99)).or(self.jitter_p95.map(|p95| ("95", p95)));
        sentences.push(match tail {
            Some((percent, value)) => format!(
                "Half of the periods were within {} ms of the median ({} ms), and {percent} % were within {} ms.",
                milliseconds(self.jitter_median),
                milliseconds(self.median),
                milliseconds(value),
            ),
            None => format!(
                "Half of the periods were within {} ms of the median ({} ms); the 95th percentile needs {MIN_VALUES_FOR_P95} \
                 periods.",
                milliseconds(self.jitter_median),
                milliseconds(self.median),
            ),
        });
        sentences.push(format!(
            "The longest time without a sample was {} ms, before iteration {}.",
            milliseconds(self.longest_gap),
            self.longest_gap_at
        ));
        sentences.push(match self.dropped {
            None => {
                "The sensor does not report dropped samples, so it is not known whether samples were dropped."
                    .to_owned()
            }
            Some(0) => "The sensor dropped no sample.".to_owned(),
            Some(dropped) => {
                let share = dropped as f64 / (dropped + self.samples) as f64;
                format!(
                    "The sensor dropped {}, {} % of all samples.",
                    counted(dropped, "sample"),
                    percent(share)
                )
            }
        });
        if self.failed > 0 {
            sentences.push(format!(
                "The sensor failed to return a sample {}. The rate is computed from samples without a failure between them.",
                counted(self.failed, "time")
            ));
        }
        sentences
    }

    /// Returns the sentences, each on its own line, and the table.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.sentences().join("\n"), self.table().text())
    }

    /// Returns the table of all quantities.
    pub fn table(&self) -> Table {
        let unknown = || NONE.to_owned();
        let ms = |value: Option<f64>| value.map_or_else(unknown, milliseconds);
        let rows = [
            ("samples", count(self.samples), ""),
            ("rate", rate(self.rate), "/s"),
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
            label_columns: 1,
            rows: rows.map(|(name, value, unit)| vec![name.to_owned(), value, unit.to_owned()]).into(),
            marked: None,
        }
    }
}

/// Returns the time at which the sample of an iteration was ready; `None` if the iteration has none.
fn sample_time(row: RowRef<'_>) -> Option<SampleTime> {
    let at = row.value("at").filter(|_| row.outcome() == Outcome::Ok)?;
    // `at` is the intended start, and the sensor is asked `lateness` later. A closed loop has no lateness.
    let at = at + row.value("lateness").unwrap_or(0.0) + row.value("sensing")?;
    Some(SampleTime { iteration: row.iteration(), at })
}

/// Returns the number of dropped samples that the sensor reported; `None` if no column reports any.
fn dropped_samples(rows: &Rows) -> Option<u64> {
    let columns = rows.names().iter().filter(|column| column.ends_with(&*stage::DROPPED_SAMPLES));
    let measured = || rows.iter().filter(|row| !row.warm_up());
    let dropped_counts = columns.flat_map(|column| measured().filter_map(move |row| row.value(column)));
    dropped_counts.reduce(|sum, value| sum + value).map(|sum| sum.max(0.0).round() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Row;
    use crate::summary::Summary;

    /// Returns a sample every 20 ms, ready 5 ms after its request. Every fourth sample is 8 ms late.
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
        let study = study(rows(403)).expect("a study");
        assert_eq!((study.samples, study.failed, study.dropped), (400, 0, None));
        assert!(close(study.median, 0.02) && (study.rate - 50.0).abs() < 0.1, "{study:?}");
        // 200 of the 399 periods equal the median, so the median jitter is 0.
        assert!(close(study.jitter_median, 0.0), "{study:?}");
        assert!(close(study.jitter_p99.expect("300 periods"), 0.008), "{study:?}");
        assert!(close(study.longest_gap, 0.028) && close(study.sensing, 0.005));
        assert!(study.sentences()[0].contains("one every 20"), "{:?}", study.sentences());
        assert!(study.text().contains("longest gap"), "{}", study.text());
    }

    #[test]
    fn time_across_failed_iteration_is_no_period() {
        let mut rows = rows(20);
        rows[9].outcome = Outcome::Failed;
        // The sensor failed after a time limit.
        rows[9].values = vec![("sensing".into(), 1.0)];
        let rows_of_run: Rows = rows.iter().cloned().collect();
        let study = study(rows).expect("samples");
        let of_summary = Summary::from_rows(&rows_of_run).quantity("sensing").map(|sensing| sensing.median);
        assert_eq!(of_summary, Some(study.sensing), "`summary.*` and pages leave out failed iterations, too");
        assert_eq!((study.failed, study.samples, study.longest_gap_at), (1, 16, 11));
        assert!(close(study.longest_gap, 0.04));
        assert!(study.jitter_p95.is_none(), "fewer than 60 periods");
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
        assert!(study.sentences().iter().any(|text| text.contains("30 samples")), "{:?}", study.sentences());
    }

    #[test]
    fn fewer_than_two_samples_give_no_study() {
        assert_eq!(study(rows(4)), None);
        assert_eq!(study(Vec::new()), None);
    }
}
