//! Spooled batches, read from an agent's log. A logged batch is in the spool even if the agent is killed in the next
//! moment.

use std::collections::BTreeMap;

/// One log line: the iterations of one run in one batch.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SpooledIterations {
    /// Id of the run.
    pub run: String,
    /// Number of the batch in its stream.
    pub batch: u64,
    /// Number of the first iteration.
    pub first: u64,
    /// Number of the last iteration.
    pub last: u64,
    /// Number of iterations.
    pub count: u64,
}

/// Value of `[log] level` for an agent that logs its spooled batches.
pub(crate) const SPOOL_LOG_LEVEL: &str = "info,peernet_agent::outbox::spool=debug";

impl SpooledIterations {
    /// Parses `… spooled batch=7 run=UUID first=1 last=90 count=90`; returns `None` for any other line and for a
    /// line that lacks a field.
    pub fn parse_line(line: &str) -> Option<Self> {
        let (_, rest) = line.split_once("spooled batch=")?;
        let fields = format!("batch={rest}");
        let fields: BTreeMap<&str, &str> =
            fields.split_whitespace().filter_map(|field| field.split_once('=')).collect();
        let number = |key: &str| fields.get(key)?.parse().ok();
        // The id of a run is a UUID.
        let run = fields.get("run").filter(|run| run.len() == 36)?;
        let spooled = Self {
            run: (*run).to_owned(),
            batch: number("batch")?,
            first: number("first")?,
            last: number("last")?,
            // The count is the last field, so a truncated line lacks the count or some of its digits. Missing digits
            // are not visible here. `parse_log` therefore ignores a line without a line feed.
            count: number("count")?,
        };
        (spooled.first <= spooled.last && spooled.count <= spooled.last - spooled.first + 1)
            .then_some(spooled)
    }

    /// Parses all lines of a log. The last line counts only if a line feed follows, because it may be truncated.
    pub fn parse_log(log: &str) -> Vec<Self> {
        let complete_lines = log.rsplit_once('\n').map_or("", |(lines, _)| lines);
        complete_lines.lines().filter_map(Self::parse_line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUN: &str = "0b9c1d9e-2f6a-4a57-9c0e-9d2f1b1c8f11";

    fn line(count: &str) -> String {
        format!("2026-11-20T15:00:00Z DEBUG agent: spooled batch=7 run={RUN} first=1 last=90 count={count}")
    }

    #[test]
    fn spool_line_is_parsed_others_are_ignored() {
        let expected = SpooledIterations { run: RUN.to_owned(), batch: 7, first: 1, last: 90, count: 90 };
        assert_eq!(SpooledIterations::parse_line(&line("90")), Some(expected));
        for line in ["ready", "spooled batch=7 run=x first=1 last=2 count=2", &line(""), &line("91")] {
            assert_eq!(SpooledIterations::parse_line(line), None, "{line}");
        }
    }

    #[test]
    fn last_line_counts_only_with_line_feed() {
        let log = format!("{}\n{}\n{}", line("90"), line("90"), line("9"));
        assert_eq!(SpooledIterations::parse_log(&log).len(), 2);
        assert_eq!(SpooledIterations::parse_log(&line("90")), []);
        assert_eq!(SpooledIterations::parse_log(&format!("{}\n", line("90"))).len(), 1);
    }
}
