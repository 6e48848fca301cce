//! Comparisons as tables.

use peernet_sample::printable_line;
use peernet_statistics::number::{
    column_decimals, count, decimals, fixed, fixed_mean_std_ms, join_ends, join_mean_std, percent, range_ms,
    share,
};

use super::difference_table::MAX_MS_DECIMALS;
use super::{Comparison, EMPTY_CELL, LATENCIES, Latency, Line, MIN_VALUES, SCORES};
use crate::accuracy::{ACCURACIES, ACCURACY_TITLES, Accuracy, UnknownLabels};
use crate::actuator_results::EPISODES_SEPARATOR;
use crate::deadline::Misses;
use crate::quality::Quality;
use crate::table::Table;
use crate::total_column::TotalColumn;

const HEADINGS: [&str; LATENCIES.len()] =
    ["sensing", "upload", "inference", "download", "total (stages)", "total (measured)"];

impl Comparison {
    /// Returns the text for a terminal.
    pub fn text(&self) -> String {
        format!("{}\n\n{}", self.table().text(), self.notes("*").join("\n"))
    }

    /// Returns Markdown.
    pub fn markdown(&self) -> String {
        format!("{}\n{}\n", self.table().markdown(), self.notes("Bold").join("\n"))
    }

    /// Returns LaTeX for the package booktabs.
    pub fn latex(&self) -> String {
        self.table().latex(&self.notes("Bold").join(" "))
    }

    fn table(&self) -> Table {
        let mut columns = Columns { lines: &self.lines, columns: Vec::new() };
        for (index, axis) in self.axes.iter().enumerate() {
            columns.add(axis, |line| Some(line.labels[index].clone()));
        }
        columns.add_if(|line| line.repeats > 1, "runs", |line| Some(count(line.repeats as u64)));
        columns.add_if(|line| line.edges > 1, "edges", |line| Some(count(line.edges as u64)));
        columns.add("count", |line| Some(count(line.count)));
        columns.add_if(|line| line.failed > 0, "failed", |line| Some(count(line.failed)));
        columns.add_if(
            |line| line.misses.is_some(),
            "missed (%)",
            |line| line.misses.and_then(Misses::rate).map(percent),
        );
        let mut best_cell = None;
        for (index, heading) in HEADINGS.into_iter().enumerate() {
            if LATENCIES[index] == self.total_column.name() {
                best_cell = self.best.map(|row| (row, columns.columns.len()));
            }
            let decimals = self.decimals(|line| line.latencies[index]);
            columns.add(heading, |line| Some(latency_cell(line.latencies[index]?, decimals)));
        }
        let decimals = self.decimals(|line| line.first_token);
        columns.add_known("first token", |line| Some(latency_cell(line.first_token?, decimals)));
        let heading = |(title, unit): (&str, &str)| match unit {
            "" => title.to_owned(),
            unit => format!("{title} ({unit})"),
        };
        for (index, title) in ACCURACY_TITLES.into_iter().enumerate() {
            columns.add_known(&heading((title, "%")), |line| {
                let accuracy = line.accuracies[index]?;
                Some(share_text(accuracy.share, accuracy.interval))
            });
        }
        for (index, score) in SCORES.into_iter().enumerate() {
            columns.add_known(&heading(score.title()), |line| {
                let score = line.scores[index]?;
                let value = share(score.value);
                Some(score.known_interval().map_or(value, |interval| share_text(score.value, interval)))
            });
        }
        columns.add_if(
            |line| line.actuator.superseded > 0,
            "superseded",
            |line| Some(count(line.actuator.superseded)),
        );
        columns.add_if(
            |line| line.actuator.episodes_text().is_some(),
            "episodes",
            |line| line.actuator.episodes_text(),
        );
        columns.add_known(&heading(Quality::Success.title()), |line| {
            let success = line.actuator.success?;
            Some(share_text(success.rate, success.interval))
        });
        columns
            .add_known(&heading(Quality::Return.title()), |line| Some(line.actuator.episode_return?.text()));
        let (header, cells): (Vec<String>, Vec<Vec<String>>) = columns.columns.into_iter().unzip();
        let row = |index: usize| cells.iter().map(|column| column[index].clone()).collect();
        let rows = (0..self.lines.len()).map(row).collect();
        Table { header, label_columns: self.axes.len(), rows, marked: best_cell }
    }

    /// Returns the number of decimals of a column of latencies. It is the same for all rows, so that the numbers are
    /// easy to compare.
    fn decimals(&self, latency: impl Fn(&Line) -> Option<Latency>) -> usize {
        let latencies = self.lines.iter().filter_map(latency);
        column_decimals(latencies.map(|latency| latency.std))
    }

    /// Returns the notes below the table: the meaning of its numbers, and what the table does not show. `mark` says how
    /// the table marks the smallest mean total: `*` or `Bold`.
    fn notes(&self, mark: &str) -> Vec<String> {
        let mut notes: Vec<String> =
            self.best.map(|_| format!("{mark}: smallest mean total.")).into_iter().collect();
        notes.push(
            "Latencies: mean ± standard deviation in ms over all successful iterations after the warm-up. Total (stages) \
             is the sum of all stages, including stages without a column; the paper calls it Total."
                .to_owned(),
        );
        let hidden: Vec<String> = self.lines.iter().filter_map(Line::hidden_stages_text).collect();
        if !hidden.is_empty() {
            notes.push(format!("Stages without a column, means per iteration in ms: {}.", hidden.join("; ")));
        }
        if self.lines.iter().any(|line| line.failed > 0) {
            let text = "Failed: iterations after the warm-up without an answer, or with an answer that the actuator failed to act on.";
            notes.push(text.to_owned());
        }
        if self.lines.iter().any(|line| line.first_token.is_some()) {
            let text = "First token: from the request to a language model until the first token of its answer, a part of inference.";
            notes.push(text.to_owned());
        }
        let is_known =
            |(index, _): &(usize, &str)| self.lines.iter().any(|line| line.accuracies[*index].is_some());
        let accuracies = ACCURACY_TITLES.into_iter().enumerate().filter(is_known);
        let accuracies: Vec<&str> = accuracies.map(|(_, name)| name).collect();
        if !accuracies.is_empty() {
            notes.push(format!(
                "{}: right answers in %, with the 95 % confidence interval (Wilson), which assumes that the iterations are \
                 independent.",
                accuracies.join(" and ")
            ));
        }
        if self.lines.iter().any(|line| line.scores.iter().any(Option::is_some)) {
            let text = "mAP@0.5 and mean IoU: mean of the values of single pictures in %, with its 95 % confidence interval, which assumes \
                        that the iterations are independent; peernet models check scores all pictures together.";
            notes.push(text.to_owned());
        }
        notes.extend(self.actuator_notes());
        let unscored: Vec<String> = self.lines.iter().flat_map(Line::unscored_texts).collect();
        if !unscored.is_empty() {
            notes.push(format!(
                "Iterations without a valid score, excluded from the accuracy: {}.",
                unscored.join("; ")
            ));
        }
        if self.lines.iter().any(|line| line.misses.is_some()) {
            let text = "Missed: the share of iterations that took longer than their deadline or failed.";
            notes.push(text.to_owned());
        }
        notes.extend(self.unknown_label_notes());
        notes.extend(self.ranking_sentence());
        notes.extend(self.other_differences.iter().cloned());
        let edges: Vec<String> = self
            .lines
            .iter()
            .filter(|line| line.edges > 1)
            .map(|line| line.with_name(&format!("{} edges", line.edges)))
            .collect();
        if !edges.is_empty() {
            notes.push(format!(
                "Edges that measured at the same time are pooled, with all iterations after the warm-up of each edge, even those \
                 during which another edge did not measure: {}.",
                edges.join("; ")
            ));
        }
        let repeat_range: Vec<String> = self.lines.iter().filter_map(Line::repeat_range_text).collect();
        if !repeat_range.is_empty() {
            notes.push(format!("Repeats are pooled; their mean totals: {} ms.", repeat_range.join("; ")));
        }
        let known_shares: Vec<String> = self.lines.iter().flat_map(Line::known_share_texts).collect();
        if !known_shares.is_empty() {
            let shares = known_shares.join("; ");
            notes.push(format!("Delays are known for only a part of the iterations: {shares}."));
        }
        notes.extend(self.caveats.iter().cloned());
        notes.iter().map(|note| printable_line(note).into_owned()).collect()
    }

    /// Returns what the columns of the actuator mean.
    fn actuator_notes(&self) -> Vec<String> {
        let any = |condition: fn(&Line) -> bool| self.lines.iter().any(condition);
        let notes = [
            any(|line| line.actuator.superseded > 0).then_some(
                "Superseded: answers that were not acted on, because a newer answer had been acted on or the episode had ended.",
            ),
            any(|line| line.actuator.episodes_text().is_some_and(|text| text.contains(EPISODES_SEPARATOR))).then_some(
                "Episodes: the number with a success or failure, and the number with rewards.",
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

    /// Returns the notes on samples whose label is not a class of the model. Lines with the same reason share a note.
    fn unknown_label_notes(&self) -> Vec<String> {
        let mut reasons: Vec<(String, Vec<String>)> = Vec::new();
        for line in &self.lines {
            let Some(unknown) = &line.unknown_labels else { continue };
            let text = line.with_name(&unknown.iterations(line.count));
            match reasons.iter_mut().find(|(reason, _)| *reason == unknown.reason()) {
                Some((_, texts)) => texts.push(text),
                None => reasons.push((unknown.reason(), vec![text])),
            }
        }
        let sentence =
            |(reason, lines): (String, Vec<String>)| format!("Not scored: {}, {reason}.", lines.join("; "));
        reasons.into_iter().map(sentence).collect()
    }

    /// Returns the sentence about the best line, the lines that cannot be distinguished from it, and the lines that were
    /// not compared with it. If no line is the best, returns the sentence about the lines that are not ranked; `None`
    /// without such lines.
    fn ranking_sentence(&self) -> Option<String> {
        let names = |lines: &[usize]| {
            lines.iter().map(|line| self.lines[*line].name.as_str()).collect::<Vec<_>>().join("; ")
        };
        let unranked = (!self.unranked.is_empty())
            .then(|| format!("not ranked, because the model computes nothing: {}", names(&self.unranked)));
        let Some(best) = self.best.map(|best| &self.lines[best]) else {
            let unranked = unranked?;
            let ranked: Vec<usize> =
                (0..self.lines.len()).filter(|index| !self.unranked.contains(index)).collect();
            let reason = match ranked.as_slice() {
                [_] => format!("only {} is ranked", names(&ranked)),
                _ => "no ranked line has a total".to_owned(),
            };
            return Some(format!("No line has the smallest mean total, because {reason}; {unranked}."));
        };
        let others = self.lines.len() - 1 - self.unranked.len();
        let tested = others - self.untested.len();
        let mut clauses = Vec::new();
        if !self.ties.is_empty() {
            clauses
                .push(format!("with 95 % confidence it cannot be distinguished from {}", names(&self.ties)));
        } else if tested == others && others > 0 {
            let ranked = if self.unranked.is_empty() { "" } else { "ranked " };
            let quantifier = if others == 1 { "the" } else { "every" };
            clauses.push(format!("{quantifier} other {ranked}line differs from it with 95 % confidence"));
        }
        if !self.untested.is_empty() {
            // Each edge has its own results, so each edge needs enough iterations.
            let lines = self.untested.iter().map(|line| &self.lines[*line]).chain([best]);
            let each = if lines.into_iter().any(|line| line.edges > 1) { "edge in each run" } else { "run" };
            clauses.push(format!(
                "too few iterations to tell whether it differs from {} ({MIN_VALUES} of each {each} are needed)",
                names(&self.untested)
            ));
        }
        clauses.extend(unranked);
        let clauses = clauses.join("; ");
        Some(format!("Smallest mean total ({}): {}; {clauses}.", self.total_word(), best.name))
    }

    /// Returns the word for the column of totals that determines the best line: `measured` or `stages`.
    pub(super) fn total_word(&self) -> &'static str {
        match self.total_column {
            TotalColumn::Measured => "measured",
            TotalColumn::SumOfStages => "stages",
        }
    }
}

impl Line {
    /// Puts the name of the line before a text about the line: `name: text`.
    pub(super) fn with_name(&self, text: &str) -> String {
        with_name(&self.name, text)
    }

    /// Returns the text with the stages that have no column; `None` if no such stage takes a notable part of the sum of
    /// all stages.
    fn hidden_stages_text(&self) -> Option<String> {
        let stage = |(name, seconds): &(&str, f64)| {
            let ms = seconds * 1e3;
            format!("{name} {}", fixed(ms, decimals(ms, 3).min(MAX_MS_DECIMALS)))
        };
        let stages: Vec<String> = self.hidden_stages.iter().map(stage).collect();
        (!stages.is_empty()).then(|| self.with_name(&stages.join(", ")))
    }

    /// Returns the text with the smallest and the largest mean of the repeats; `None` for a single repeat.
    fn repeat_range_text(&self) -> Option<String> {
        (self.repeats > 1).then_some(())?;
        let means =
            self.repeat_moments.iter().filter(|moments| moments.count > 0).map(|moments| moments.mean);
        let means: Vec<f64> = means.collect();
        let ends = (means.iter().copied().reduce(f64::min)?, means.iter().copied().reduce(f64::max)?);
        Some(self.with_name(&range_ms(ends)))
    }

    /// Returns the texts on iterations without a score, one for each accuracy. Iterations whose label is not a class of
    /// the model are not included: [`Comparison::unknown_label_notes`] returns the note on them.
    fn unscored_texts(&self) -> Vec<String> {
        let unscored_text = |(name, accuracy): (&str, &Option<Accuracy>)| {
            let unscored = UnknownLabels::other_unscored(self.unknown_labels.as_ref(), (*accuracy)?.unscored);
            let text = || format!("{name} of {}: {} of {}", self.name, count(unscored), count(self.count));
            (unscored > 0).then(text)
        };
        ACCURACIES.into_iter().zip(&self.accuracies).filter_map(unscored_text).collect()
    }

    /// Returns the texts on delays that are known for only a part of the iterations, one for each direction.
    fn known_share_texts(&self) -> Vec<String> {
        let known_share = |name: &str| {
            let share = percent(self.small_known_share(name)?);
            Some(format!("{name} of {}: {share} %", self.name))
        };
        LATENCIES.into_iter().filter_map(known_share).collect()
    }
}

/// Puts a name before a text: `name: text`. If the name is empty, because there is only one line, returns the text
/// alone.
pub(super) fn with_name(name: &str, text: &str) -> String {
    if name.is_empty() { text.to_owned() } else { format!("{name}: {text}") }
}

/// Returns the cell of a latency: mean ± standard deviation in ms.
fn latency_cell(latency: Latency, decimals: usize) -> String {
    join_mean_std(fixed_mean_std_ms(latency.mean, latency.std, decimals))
}

/// Returns a share in per cent with its interval.
fn share_text(value: f64, (lo, hi): (f64, f64)) -> String {
    format!("{} ({})", share(value), join_ends([share(lo), share(hi)]))
}

/// Columns of a table, from left to right.
struct Columns<'a> {
    lines: &'a [Line],
    /// Title of each column, and its cells in the order of the lines.
    columns: Vec<(String, Vec<String>)>,
}

impl Columns<'_> {
    /// Adds a column; a line without a text has an empty cell.
    fn add(&mut self, title: &str, text: impl Fn(&Line) -> Option<String>) {
        let cells = self.lines.iter().map(|line| text(line).unwrap_or_else(|| EMPTY_CELL.to_owned()));
        self.columns.push((title.to_owned(), cells.collect()));
    }

    /// Adds a column if at least one line needs it.
    fn add_if(
        &mut self,
        is_needed: impl Fn(&Line) -> bool,
        title: &str,
        text: impl Fn(&Line) -> Option<String>,
    ) {
        if self.lines.iter().any(is_needed) {
            self.add(title, text);
        }
    }

    /// Adds a column if at least one line has a text for it.
    fn add_known(&mut self, title: &str, text: impl Fn(&Line) -> Option<String>) {
        self.add_if(|line| text(line).is_some(), title, &text);
    }
}
