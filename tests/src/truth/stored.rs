//! Delays in an aggregator's database.

use std::path::Path;
use std::process::Command;

use peernet_clock::{RawTime, Span, WallTime};

/// Stored delay.
#[derive(Clone, Debug)]
pub struct Delay {
    /// Departure, by the sender's wall clock.
    pub sent: WallTime,
    /// Arrival, by the receiver's wall clock.
    pub received: WallTime,
    /// Departure and arrival, by the free-running clocks of sender and receiver.
    pub raw: Option<(RawTime, RawTime)>,
    /// Reported delay.
    pub value: Option<Span>,
    /// Reported lower and upper bound.
    pub bounds: Option<(Span, Span)>,
    /// Reported verdict.
    pub verdict: String,
    /// Reported source.
    pub source: String,
}

/// Iteration that was answered.
#[derive(Clone, Debug)]
pub struct Iteration {
    /// Number of its run.
    pub run: u64,
    /// Number of the iteration.
    pub number: u64,
    /// Delay from edge to cloud.
    pub up: Delay,
    /// Delay from cloud to edge.
    pub down: Delay,
}

const DELAYS: &str = "
SELECT t.run, t.iteration, name.text, t.sent_ns, t.received_ns,
       CAST(round(node.value * 1e9) AS INTEGER), CAST(round(node.lo * 1e9) AS INTEGER),
       CAST(round(node.hi * 1e9) AS INTEGER), t.sent_raw_ns, t.received_raw_ns,
       coalesce(verdict.text, ''), coalesce(source.text, '')
FROM transit AS t
JOIN node USING (run, iteration, node)
JOIN name ON name.id = node.name
LEFT JOIN verdict ON verdict.id = t.verdict
LEFT JOIN source ON source.id = t.source
WHERE t.received_ns IS NOT NULL AND name.text IN ('upload', 'download')
ORDER BY t.run, t.iteration, name.text DESC";

/// Reads all answered iterations of an aggregator's database.
///
/// # Panics
/// As [`query_database`].
pub fn iterations(database: &Path) -> Vec<Iteration> {
    let text = query_database(database, DELAYS);
    let rows: Vec<(u64, u64, &str, Delay)> =
        text.lines().map(|line| parse_row(line).expect("twelve columns")).collect();
    // Of an iteration's rows, `upload` precedes `download`, because the query sorts names in descending
    // order. An iteration that lacks one of them is left out.
    let pairs = rows.windows(2).filter_map(|pair| {
        let [(run, number, "upload", up), (next_run, next_number, "download", down)] = pair else {
            return None;
        };
        ((run, number) == (next_run, next_number)).then(|| Iteration {
            run: *run,
            number: *number,
            up: up.clone(),
            down: down.clone(),
        })
    });
    pairs.collect()
}

/// Runs an SQL query on a database. Returns one line per row, with columns separated by `|`.
///
/// # Panics
/// If the database cannot be read.
pub fn query_database(database: &Path, sql: &str) -> String {
    let output = Command::new("sqlite3")
        .args(["-readonly", "-batch", "-noheader", "-list"])
        .arg(database)
        .arg(sql)
        .output()
        .expect("sqlite3 is installed: run `deploy/install-tools.sh test`");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("sqlite3 prints UTF-8")
}

fn parse_row(line: &str) -> Option<(u64, u64, &str, Delay)> {
    let mut columns = line.split('|');
    let (run, number) = (columns.next()?.parse().ok()?, columns.next()?.parse().ok()?);
    let name = columns.next()?;
    let mut nanos = || columns.next().map(|text| text.parse::<i64>().ok());
    let (sent, received) = (nanos()??, nanos()??);
    let (value, lo, hi) = (nanos()?, nanos()?, nanos()?);
    let raw = nanos()?.zip(nanos()?);
    let delay = Delay {
        sent: WallTime::from_unix_nanos(sent),
        received: WallTime::from_unix_nanos(received),
        raw: raw.map(|(sent, received)| (RawTime::from_nanos(sent), RawTime::from_nanos(received))),
        value: value.map(Span::from_nanos),
        bounds: lo.zip(hi).map(|(lo, hi)| (Span::from_nanos(lo), Span::from_nanos(hi))),
        verdict: columns.next()?.to_owned(),
        source: columns.next()?.to_owned(),
    };
    Some((run, number, name, delay))
}
