//! What an agent said is in its spool, read from its log: true even when the next moment killed it.

use std::collections::BTreeMap;

/// One line: the iterations of one run in one batch.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Spooled {
    /// The run's id.
    pub run: String,
    /// The batch's number in its stream.
    pub batch: u64,
    /// Number of the first iteration.
    pub first: u64,
    /// Number of the last.
    pub last: u64,
    /// How many.
    pub count: u64,
}

/// `[log] level` of an agent that says what it spooled.
pub(crate) const TELLS_SPOOLED: &str = "info,peernet_agent::outbox::spool=debug";

impl Spooled {
    /// Reads `… spooled batch=7 run=UUID first=1 last=90 count=90`; `None` for any other line and for one that
    /// was torn off when its writer was killed.
    pub fn parse(line: &str) -> Option<Self> {
        let (_, said) = line.split_once("spooled batch=")?;
        let said = format!("batch={said}");
        let fields: BTreeMap<&str, &str> =
            said.split_whitespace().filter_map(|field| field.split_once('=')).collect();
        let number = |key: &str| fields.get(key)?.parse().ok();
        // It ends with the count: a torn one would lack it, or digits of it, which only the line's end rules out.
        let run = fields.get("run").filter(|run| run.len() == 36)?;
        let spooled = Self {
            run: (*run).to_owned(),
            batch: number("batch")?,
            first: number("first")?,
            last: number("last")?,
            count: number("count")?,
        };
        (spooled.first <= spooled.last && spooled.count <= spooled.last - spooled.first + 1)
            .then_some(spooled)
    }

    /// All lines of a log. The last line counts only when something follows it: it may be torn.
    pub fn all(log: &str) -> Vec<Self> {
        let whole = log.rsplit_once('\n').map_or("", |(whole, _)| whole);
        whole.lines().filter_map(Self::parse).collect()
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
    fn a_line_is_read_and_others_are_not() {
        let read = Spooled { run: RUN.to_owned(), batch: 7, first: 1, last: 90, count: 90 };
        assert_eq!(Spooled::parse(&line("90")), Some(read));
        for other in ["ready", "spooled batch=7 run=x first=1 last=2 count=2", &line(""), &line("91")] {
            assert_eq!(Spooled::parse(other), None, "{other}");
        }
    }

    #[test]
    fn what_may_be_torn_does_not_count() {
        let log = format!("{}\n{}\n{}", line("90"), line("90"), line("9"));
        assert_eq!(Spooled::all(&log).len(), 2);
        assert_eq!(Spooled::all(&line("90")), []);
    }
}
