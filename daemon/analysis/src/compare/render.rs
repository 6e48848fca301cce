//! Comparisons as tables.

use peernet_sample::printable_line;
use peernet_statistics::number::{column_decimals, decimals, fixed, percent, range_ms};

use super::difference_table::{MAX_MS_DECIMALS, in_milliseconds};
use super::{Comparison, Difference, EMPTY_CELL, LATENCIES, Latency, Line, MIN_KNOWN_SHARE, MIN_VALUES};
use crate::accuracy::{ACCURACIES, Accuracy};
use crate::actuator_results::{EpisodeReturn, SuccessRate};
use crate::deadline::Misses;
use crate::table::{Table, csv_text, interval};
use crate::total_column::TotalColumn;

const HEADINGS: [&str; LATENCIES.len()] =
    ["sensing", "upload", "inference", "download", "total (stages)", "total (measured)"];
/// Columns of the actuator in CSV.
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
const ACCURACY_HEADINGS: [&str; ACCURACIES.len()] = ["Top-1 (%)", "Top-5 (%)"];

impl Comparison {
    /// Returns the text for a terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.table().text(), self.notes().join("\n"))
    }

    /// Returns Markdown.
    pub fn markdown(&self) -> String {
        format!("{}\n{}\n", self.table().markdown(), self.notes().join("\n"))
    }

    /// Returns LaTeX, with booktabs.
    pub fn latex(&self) -> String {
        self.table().latex(&self.notes().join(" "))
    }

    /// Returns CSV for programs: seconds, with all digits.
    pub fn csv(&self) -> String {
        let mut header: Vec<String> = self.axes.clone();
        header.extend(["runs", "count", "unanswered", "best", "tie"].map(str::to_owned));
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
        let row = |(index, line): (usize, &Line)| {
            let flag = |value: bool| u8::from(value).to_string();
            let number = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
            let label = |label: &String| if label == EMPTY_CELL { String::new() } else { label.clone() };
            let mut cells: Vec<String> = line.labels.iter().map(label).collect();
            cells.extend([line.repeats as u64, line.count, line.unanswered].map(|count| count.to_string()));
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
            cells.extend(line.difference_to_best.map_or([None; 3], Difference::ends).map(number));
            cells.push(number(line.misses.and_then(Misses::rate)));
            let success = line.actuator.success.map(|SuccessRate { rate, interval: (lo, hi), episodes }| {
                [rate, lo, hi, episodes as f64].map(Some)
            });
            let episode_return = line.actuator.episode_return;
            let of_return = episode_return
                .map(|EpisodeReturn { mean, std, episodes }| [Some(mean), std, Some(episodes as f64)]);
            cells.push(line.actuator.superseded.to_string());
            cells.extend(success.unwrap_or_default().map(number));
            cells.extend(of_return.unwrap_or_default().map(number));
            cells.extend(
                [
                    line.first_token.map(|latency| latency.mean),
                    line.first_token.and_then(|latency| latency.std),
                ]
                .map(number),
            );
            cells
        };
        let rows: Vec<Vec<String>> = self.lines.iter().enumerate().map(row).collect();
        csv_text(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
    }

    fn table(&self) -> Table {
        let has_repeats = self.lines.iter().any(|line| line.repeats > 1);
        let has_edges = self.lines.iter().any(|line| line.edges > 1);
        let has_unanswered = self.lines.iter().any(|line| line.unanswered > 0);
        let mut header = self.axes.clone();
        header.extend(has_repeats.then(|| "runs".to_owned()));
        header.extend(has_edges.then(|| "edges".to_owned()));
        header.push("count".to_owned());
        header.extend(has_unanswered.then(|| "unanswered".to_owned()));
        let has_deadlines = self.lines.iter().any(|line| line.misses.is_some());
        header.extend(has_deadlines.then(|| "missed (%)".to_owned()));
        header.extend(HEADINGS.map(str::to_owned));
        let has_tokens = self.lines.iter().any(|line| line.first_token.is_some());
        header.extend(has_tokens.then(|| "first token".to_owned()));
        let accuracies: Vec<usize> = (0..ACCURACIES.len())
            .filter(|index| self.lines.iter().any(|line| line.accuracies[*index].is_some()))
            .collect();
        header.extend(accuracies.iter().map(|index| ACCURACY_HEADINGS[*index].to_owned()));
        let has_superseded = self.lines.iter().any(|line| line.actuator.superseded > 0);
        let has_success = self.lines.iter().any(|line| line.actuator.success.is_some());
        let has_returns = self.lines.iter().any(|line| line.actuator.episode_return.is_some());
        header.extend(has_superseded.then(|| "superseded".to_owned()));
        header.extend(has_success.then(|| "success (%)".to_owned()));
        header.extend(has_returns.then(|| "return".to_owned()));
        let decimals =
            HEADINGS.iter().enumerate().map(|(index, _)| self.decimals(|line| line.latencies[index]));
        let decimals: Vec<usize> = decimals.collect();
        let token_decimals = self.decimals(|line| line.first_token);
        let row = |line: &Line| {
            let mut cells = line.labels.clone();
            cells.extend(has_repeats.then(|| count(line.repeats as u64)));
            cells.extend(has_edges.then(|| count(line.edges as u64)));
            cells.push(count(line.count));
            cells.extend(has_unanswered.then(|| count(line.unanswered)));
            let miss_rate = line.misses.and_then(Misses::rate);
            let missed = miss_rate.map_or_else(|| EMPTY_CELL.to_owned(), |rate| fixed(rate * 100.0, 2));
            cells.extend(has_deadlines.then_some(missed));
            cells.extend(
                line.latencies.iter().zip(&decimals).map(|(latency, decimals)| cell(*latency, *decimals)),
            );
            cells.extend(has_tokens.then(|| cell(line.first_token, token_decimals)));
            cells.extend(
                accuracies.iter().map(|index| share(line.accuracies[*index].map(share_and_interval))),
            );
            let results = line.actuator;
            cells.extend(has_superseded.then(|| count(results.superseded)));
            cells.extend(
                has_success.then(|| share(results.success.map(|success| (success.rate, success.interval)))),
            );
            let or_empty = |cell: Option<String>| cell.unwrap_or_else(|| EMPTY_CELL.to_owned());
            let episode_return = results.episode_return.map(|found| found.text());
            cells.extend(has_returns.then(|| or_empty(episode_return)));
            cells
        };
        let rows = self.lines.iter().map(row).collect();
        Table { header, labels: self.axes.len(), rows, marked: self.best.into_iter().collect() }
    }

    /// Returns the number of decimals of a latency, which is the same for all rows, so that the numbers are easy to compare.
    fn decimals(&self, latency: impl Fn(&Line) -> Option<Latency>) -> usize {
        let latencies = self.lines.iter().filter_map(latency);
        latencies.map(|latency| column_decimals(latency.std)).max().unwrap_or_default()
    }

    /// Returns the notes below the table: the meaning of its numbers, and what the table does not show.
    fn notes(&self) -> Vec<String> {
        let mut notes = vec![
            "Latencies: mean ± standard deviation in ms over all counted iterations. Total (stages) is the sum of all \
             stages, including stages without a column; the paper calls it Total."
                .to_owned(),
        ];
        let hidden: Vec<String> = self.lines.iter().filter_map(Line::hidden_stages_text).collect();
        if !hidden.is_empty() {
            notes.push(format!("Stages without a column, means in ms: {}.", hidden.join("; ")));
        }
        if self.lines.iter().any(|line| line.first_token.is_some()) {
            let text = "First token: from the request to a language model until the first token of its answer, a part of inference.";
            notes.push(text.to_owned());
        }
        if self.lines.iter().any(|line| line.accuracies.iter().any(Option::is_some)) {
            let text = "Top-1 and Top-5: right answers in %, with the 95 % confidence interval (Wilson), which assumes that the \
                        iterations are independent.";
            notes.push(text.to_owned());
        }
        notes.extend(self.actuator_notes());
        let unscored: Vec<String> = self.lines.iter().flat_map(Line::unscored).collect();
        if !unscored.is_empty() {
            notes.push(format!(
                "Iterations without a valid score, excluded from the accuracy: {}.",
                unscored.join("; ")
            ));
        }
        if self.lines.iter().any(|line| line.misses.is_some()) {
            let text =
                "Missed: the share of iterations that took longer than their deadline or have no answer.";
            notes.push(text.to_owned());
        }
        notes.extend(self.unknown_labels());
        notes.extend(self.verdict());
        notes.extend(self.other_differences.iter().cloned());
        let edges: Vec<String> = self
            .lines
            .iter()
            .filter(|line| line.edges > 1)
            .map(|line| line.with_name(&format!("{} edges", line.edges)))
            .collect();
        if !edges.is_empty() {
            notes.push(format!("Edges that measured at the same time are pooled: {}.", edges.join("; ")));
        }
        let repeat_range: Vec<String> = self.lines.iter().filter_map(Line::repeat_range).collect();
        if !repeat_range.is_empty() {
            notes.push(format!("Repeats are pooled; their mean totals: {} ms.", repeat_range.join("; ")));
        }
        let known_shares: Vec<String> = self.lines.iter().flat_map(Line::known_shares).collect();
        if !known_shares.is_empty() {
            let shares = known_shares.join("; ");
            notes.push(format!("Delays are known for only a part of the iterations: {shares}."));
        }
        notes.extend(self.caveats.iter().cloned());
        notes.iter().map(|note| printable_line(note).into_owned()).collect()
    }

    /// Returns what the columns of the actuator mean.
    fn actuator_notes(&self) -> Vec<String> {
        let any = |has: fn(&Line) -> bool| self.lines.iter().any(has);
        let notes = [
            any(|line| line.actuator.superseded > 0).then_some(
                "Superseded: answers that were not acted on, because a newer answer had been acted on or the episode had ended.",
            ),
            any(|line| line.actuator.success.is_some()).then_some(
                "Success: episodes that were a success in %, with the 95 % confidence interval (Wilson), which assumes that the \
                 episodes are independent.",
            ),
            any(|line| line.actuator.episode_return.is_some())
                .then_some("Return: mean ± standard deviation of the sum of the rewards of an episode."),
        ];
        notes.into_iter().flatten().map(str::to_owned).collect()
    }

    /// Returns the notes on lines with labels that are not classes of the model, one for each reason.
    fn unknown_labels(&self) -> Vec<String> {
        let mut reasons: Vec<(String, Vec<String>)> = Vec::new();
        for line in &self.lines {
            let Some(unknown) = &line.unknown_labels else { continue };
            let text = line.with_name(&format!("{} of {}", count(unknown.count), count(line.count)));
            match reasons.iter_mut().find(|(reason, _)| *reason == unknown.reason()) {
                Some((_, texts)) => texts.push(text),
                None => reasons.push((unknown.reason(), vec![text])),
            }
        }
        let sentence =
            |(reason, lines): (String, Vec<String>)| format!("Not scored, {reason}: {}.", lines.join("; "));
        reasons.into_iter().map(sentence).collect()
    }

    /// Returns the sentence about the best line, and about the lines that do not differ from it or were not compared with it.
    fn verdict(&self) -> Option<String> {
        let best = &self.lines[self.best?];
        let names = |lines: &[usize]| {
            lines.iter().map(|line| self.lines[*line].name()).collect::<Vec<_>>().join("; ")
        };
        let others = self.lines.len() - 1 - self.unranked.len();
        let tested = others - self.untested.len();
        let mut clauses = Vec::new();
        if !self.ties.is_empty() {
            clauses
                .push(format!("with 95 % confidence it cannot be distinguished from {}", names(&self.ties)));
        } else if tested == others && others > 0 {
            let subject = if others == 1 { "the other line" } else { "every other line" };
            clauses.push(format!("{subject} differs from it with 95 % confidence"));
        }
        if !self.untested.is_empty() {
            clauses.push(format!(
                "too few iterations to tell whether it differs from {} ({MIN_VALUES} of each run are needed)",
                names(&self.untested)
            ));
        }
        if !self.unranked.is_empty() {
            clauses
                .push(format!("not ranked, because the model computes nothing: {}", names(&self.unranked)));
        }
        let verdicts = clauses.join("; ");
        Some(format!("Smallest mean total ({}): {}; {verdicts}.", self.total(), best.name()))
    }

    /// Returns the word for the column of totals that determines the best line: `measured` or `stages`.
    pub(super) fn total(&self) -> &'static str {
        match self.total_column {
            TotalColumn::Measured => "measured",
            TotalColumn::SumOfStages => "stages",
        }
    }
}

impl Line {
    /// Returns the labels of the line as one text.
    pub fn name(&self) -> String {
        let labels: Vec<&str> =
            self.labels.iter().map(String::as_str).filter(|label| *label != EMPTY_CELL).collect();
        labels.join(", ")
    }

    /// Returns a text about the line after the name of the line.
    pub(super) fn with_name(&self, text: &str) -> String {
        with_name(&self.name(), text)
    }

    /// Returns the text with the stages that have no column; `None` if they take no notable part of the sum of all stages.
    fn hidden_stages_text(&self) -> Option<String> {
        let stage = |(name, seconds): &(&str, f64)| {
            let ms = seconds * 1e3;
            format!("{name} {}", fixed(ms, decimals(ms, 3).min(MAX_MS_DECIMALS)))
        };
        let stages: Vec<String> = self.hidden_stages.iter().map(stage).collect();
        (!stages.is_empty()).then(|| self.with_name(&stages.join(", ")))
    }

    /// Returns the text with the smallest and the largest mean of the repeats; `None` for a single repeat.
    fn repeat_range(&self) -> Option<String> {
        (self.repeats > 1).then_some(())?;
        let means =
            self.repeat_moments.iter().filter(|moments| moments.count > 0).map(|moments| moments.mean);
        let means: Vec<f64> = means.collect();
        let ends = (means.iter().copied().reduce(f64::min)?, means.iter().copied().reduce(f64::max)?);
        Some(self.with_name(&range_ms(ends)))
    }

    /// Returns the texts on iterations without a score, one for each accuracy. Iterations whose label is not a class of the model have their own
    /// note and are not counted here.
    fn unscored(&self) -> Vec<String> {
        let with_unknown_label = self.unknown_labels.as_ref().map_or(0, |unknown| unknown.count);
        let unscored_text = |(name, accuracy): (&str, &Option<Accuracy>)| {
            let left_out = (*accuracy)?.unscored.saturating_sub(with_unknown_label);
            let text = || format!("{name} of {}: {} of {}", self.name(), count(left_out), count(self.count));
            (left_out > 0).then(text)
        };
        ACCURACIES.into_iter().zip(&self.accuracies).filter_map(unscored_text).collect()
    }

    /// Returns the texts on delays that are known for only a part of the iterations, one for each direction.
    fn known_shares(&self) -> Vec<String> {
        let share_text = |name: &str| {
            let share = self.latency(name)?.count as f64 / self.count as f64;
            (share < MIN_KNOWN_SHARE).then(|| format!("{name} of {}: {} %", self.name(), percent(share)))
        };
        ["upload", "download"].into_iter().filter_map(share_text).collect()
    }
}

/// Returns a text after a name. If the name is empty, because there is only one line, returns the text alone.
pub(super) fn with_name(name: &str, text: &str) -> String {
    if name.is_empty() { text.to_owned() } else { format!("{name}: {text}") }
}

fn count(count: u64) -> String {
    fixed(count as f64, 0)
}

/// Returns the cell of a latency: mean ± standard deviation in ms.
fn cell(latency: Option<Latency>, decimals: usize) -> String {
    let ms = |seconds: f64| in_milliseconds(seconds, decimals);
    match latency {
        None => EMPTY_CELL.to_owned(),
        Some(Latency { mean, std: None, .. }) => ms(mean),
        Some(Latency { mean, std: Some(std), .. }) => format!("{} ± {}", ms(mean), ms(std)),
    }
}

const fn share_and_interval(accuracy: Accuracy) -> (f64, (f64, f64)) {
    (accuracy.share, accuracy.interval)
}

/// Returns a share in per cent with its interval.
fn share(known: Option<(f64, (f64, f64))>) -> String {
    let percent = |share: f64| fixed(share * 100.0, 1);
    known.map_or_else(
        || EMPTY_CELL.to_owned(),
        |(share, (lo, hi))| format!("{} ({})", percent(share), interval([percent(lo), percent(hi)])),
    )
}
