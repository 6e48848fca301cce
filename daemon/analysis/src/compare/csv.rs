//! Comparisons as CSV, for programs.

use super::{Comparison, Difference, LATENCIES, Line, SCORES, csv_labels};
use crate::accuracy::{ACCURACIES, Accuracy};
use crate::actuator_results::{EpisodeReturn, SuccessRate};
use crate::deadline::Misses;
use crate::quality::QualityEstimate;
use crate::table::csv_text;

/// Names of the columns with the results of the actuator.
const ACTUATOR_COLUMNS: [&str; 8] = [
    "superseded",
    "success-rate",
    "success-rate-lo",
    "success-rate-hi",
    "success-episodes",
    "return-mean",
    "return-std",
    "return-episodes",
];

impl Comparison {
    /// Returns the names of the columns of the CSV after the axes.
    pub fn csv_columns() -> Vec<String> {
        // The column of failed iterations keeps its old name, `unanswered`, for the programs that read it.
        let mut header = Vec::from(["runs", "count", "unanswered", "best", "tie"].map(str::to_owned));
        header.extend(LATENCIES.iter().flat_map(|name| [format!("{name}-mean"), format!("{name}-std")]));
        header.push("edges".to_owned());
        header.extend(
            ACCURACIES
                .iter()
                .flat_map(|name| ["", "-lo", "-hi", "-unscored"].map(|end| format!("{name}{end}"))),
        );
        header.extend(["", "-lo", "-hi"].map(|end| format!("beyond-best{end}")));
        header.push("miss-rate".to_owned());
        header.extend(ACTUATOR_COLUMNS.map(str::to_owned));
        header.extend(["first-token-mean", "first-token-std"].map(str::to_owned));
        header.extend(
            SCORES
                .iter()
                .flat_map(|score| ["", "-lo", "-hi", "-count"].map(|end| format!("{}{end}", score.name()))),
        );
        header.push("replayed".to_owned());
        header
    }

    /// Returns CSV for programs: seconds, with all digits.
    pub fn csv(&self) -> String {
        let row = |(index, line): (usize, &Line)| {
            let flag = |value: bool| u8::from(value).to_string();
            let number = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
            let mut cells = csv_labels(&line.labels);
            cells.extend([line.repeats as u64, line.count, line.failed].map(|count| count.to_string()));
            let is_untested = self.untested.contains(&index);
            let tie = if is_untested || self.unranked.contains(&index) {
                String::new()
            } else {
                flag(self.ties.contains(&index))
            };
            cells.extend([flag(self.best == Some(index)), tie]);
            cells.extend(line.latencies.iter().flat_map(|latency| {
                [number(latency.map(|latency| latency.mean)), number(latency.and_then(|latency| latency.std))]
            }));
            cells.push(line.edges.to_string());
            cells.extend(line.accuracies.iter().flat_map(|accuracy| {
                let numbers = accuracy.map(|Accuracy { share, interval, unscored, .. }| {
                    [share, interval.0, interval.1, unscored as f64]
                });
                numbers.map_or([None; 4], |numbers| numbers.map(Some)).map(number)
            }));
            cells.extend(line.difference_to_best.map_or([None; 3], Difference::value_and_ends).map(number));
            cells.push(number(line.misses.and_then(Misses::rate)));
            let success = line.actuator.success.map(|SuccessRate { rate, interval: (lo, hi), episodes }| {
                [rate, lo, hi, episodes as f64].map(Some)
            });
            let episode_return = line.actuator.episode_return;
            let return_numbers = episode_return
                .map(|EpisodeReturn { mean, std, episodes }| [Some(mean), std, Some(episodes as f64)]);
            cells.push(line.actuator.superseded.to_string());
            cells.extend(success.unwrap_or_default().map(number));
            cells.extend(return_numbers.unwrap_or_default().map(number));
            cells.extend(
                [
                    line.first_token.map(|latency| latency.mean),
                    line.first_token.and_then(|latency| latency.std),
                ]
                .map(number),
            );
            cells.extend(line.scores.iter().flat_map(|score| {
                let numbers = score.map(|QualityEstimate { value, interval, count, .. }| {
                    [value, interval.0, interval.1, count as f64]
                });
                numbers.map_or([None; 4], |numbers| numbers.map(Some)).map(number)
            }));
            cells.push(flag(line.replayed.is_some()));
            cells
        };
        let rows: Vec<Vec<String>> = self.lines.iter().enumerate().map(row).collect();
        let columns = Self::csv_columns();
        csv_text(&self.axes.iter().chain(&columns).map(String::as_str).collect::<Vec<_>>(), &rows)
    }
}
