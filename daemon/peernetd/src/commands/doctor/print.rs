//! Text form of an examination.

use peernet_analysis::table::text;
use peernet_cli::output::print_to_stdout;
use peernet_clock::WallTime;
use peernet_statistics::number::{bytes, fixed};
use peernet_store::maintenance::{Report, Severity};

use super::ExaminationResult;
use super::spool::SpoolReport;

/// Maximum number of lines of a printed table; the JSON form has all lines.
const MAX_TABLE_LINES: usize = 20;
/// Maximum number of printed findings, and of printed problems from SQLite's check.
const MAX_FINDINGS: usize = 10;

/// Prints the result of an examination as text.
pub(super) fn print(result: &ExaminationResult, now: WallTime) {
    if let Some(report) = &result.database {
        print_database(report, now);
    }
    if let Some(report) = &result.spool {
        print_spool(report, now);
    }
    for finding in result.findings().take(MAX_FINDINGS) {
        let severity = match finding.severity {
            Severity::Problem => "PROBLEM",
            Severity::Notice => "notice",
        };
        print_to_stdout(format_args!("{severity}: {}\n  → {}", finding.what, finding.advice));
    }
    let hidden = result.findings().count().saturating_sub(MAX_FINDINGS);
    if hidden > 0 {
        print_to_stdout(format_args!("… and {hidden} more (--json shows all)"));
    }
    let problems = result.findings().filter(|finding| finding.severity == Severity::Problem).count();
    let notices = result.findings().count() - problems;
    match (problems, result.unavailable.is_empty()) {
        (0, true) if notices == 0 => print_to_stdout("healthy"),
        (0, true) => print_to_stdout("healthy; see the notices above"),
        // `print_result` prints the errors about the files that could not be examined.
        (0, false) => {}
        (1, _) => print_to_stdout("1 problem"),
        (n, _) => print_to_stdout(format_args!("{n} problems")),
    }
}

fn print_database(report: &Report, now: WallTime) {
    let file = &report.file;
    print_to_stdout(format_args!(
        "database {}\n  {}, of which {} are free for reuse; write-ahead log {}; free disk space {}",
        report.database.display(),
        format_size(file.bytes),
        format_size(file.free_bytes),
        format_size(file.wal_bytes),
        format_size(file.disk_free_bytes)
    ));
    if let Some(schema) = report.schema {
        print_to_stdout(format_args!("  schema {} (this program supports {})", schema.found, schema.known));
    }
    let check = if report.integrity.full { "full check" } else { "quick check" };
    let result = match report.integrity.problems.as_slice() {
        [] if report.is_healthy() => "ok".to_owned(),
        [] => "no damage; the problems below are of another kind".to_owned(),
        problems if problems.len() > MAX_FINDINGS => {
            let more = problems.len() - MAX_FINDINGS;
            format!("{}\n    … and {more} more (--json shows all)", problems[..MAX_FINDINGS].join("\n    "))
        }
        problems => problems.join("\n    "),
    };
    print_to_stdout(format_args!("  {check}: {result}\n"));
    let rows = report.tables.iter().map(|table| {
        let about = if table.estimated { "about " } else { "" };
        vec![table.table.to_owned(), format!("{about}{}", fixed(table.rows as f64, 0))]
    });
    print_table(&["table", "rows"], rows);
    let rows = report.streams.iter().map(|stream| {
        let host = stream.host.clone().unwrap_or_else(|| "unknown".to_owned());
        vec![
            host,
            stream.stream.clone(),
            fixed(stream.stored as f64, 0),
            format_age(stream.last_seen_ns, now),
        ]
    });
    print_table(&["host", "stream", "stored up to batch", "last seen"], rows);
    let rows = report.rollups.iter().map(|extent| {
        let age = |unix_s: Option<i64>| {
            unix_s.map_or_else(
                || "—".to_owned(),
                |unix_s| format_age(unix_s.saturating_mul(1_000_000_000), now),
            )
        };
        vec![
            format!("{} s", fixed(extent.resolution_s as f64, 0)),
            age(extent.oldest_s),
            age(extent.newest_s),
        ]
    });
    print_table(&["roll-up interval", "oldest starts", "newest starts"], rows);
    let rows = report.gaps.iter().map(|gap| {
        let host = gap.host.clone().unwrap_or_else(|| "unknown".to_owned());
        // A gap whose events were not counted adds nothing to `gap.events`.
        let events = if gap.uncounted > 0 { format!("≥ {}", gap.events) } else { gap.events.to_string() };
        vec![gap.reason.clone(), host, gap.gaps.to_string(), events, format_age(gap.to_ns, now)]
    });
    print_table(&["reason of gaps", "host", "gaps", "events", "last ended"], rows);
    let rows = report.quarantine.iter().map(|group| {
        let host = group.host.clone().unwrap_or_else(|| "unknown".to_owned());
        vec![group.reason.clone(), host, group.batches.to_string(), format_age(group.last_ns, now)]
    });
    print_table(&["reason of quarantine", "host", "batches", "last received"], rows);
    let rows = report.open_runs.iter().map(|run| {
        let host = run.host.clone().unwrap_or_else(|| "unknown".to_owned());
        vec![
            format!("#{}", run.number),
            format!("{host}/{}", run.pipeline),
            format_age(run.last_seen_ns, now),
        ]
    });
    print_table(&["unfinished run", "pipeline", "host last seen"], rows);
}

fn print_spool(report: &SpoolReport, now: WallTime) {
    print_to_stdout(format_args!(
        "spool {}\n  {}; free disk space {}",
        report.spool.display(),
        format_size(report.file_bytes),
        format_size(report.disk_free_bytes)
    ));
    let inspection = &report.inspection;
    // The stream is empty if it could not be read. A finding gives the reason.
    if inspection.stream.is_empty() {
        return print_to_stdout("");
    }
    print_to_stdout(format_args!(
        "  stream {} of host {}\n  stored by the aggregator up to batch {}\n  {} events produced, {} lost",
        inspection.stream,
        inspection.host,
        fixed(inspection.acknowledged as f64, 0),
        fixed(inspection.produced as f64, 0),
        fixed(inspection.dropped as f64, 0)
    ));
    match (inspection.waiting_range, inspection.oldest_ns) {
        (Some((first, last)), Some(oldest)) => print_to_stdout(format_args!(
            "  waiting: batches {first} to {last}, {} events, {}, the oldest from {}\n",
            fixed(inspection.events as f64, 0),
            format_size(inspection.bytes),
            format_age(oldest, now)
        )),
        _ => print_to_stdout("  no events wait\n"),
    }
}

/// Prints a table with an empty line after it; prints nothing if there are no rows.
fn print_table(header: &[&str], rows: impl Iterator<Item = Vec<String>>) {
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        return;
    }
    let hidden = rows.len().saturating_sub(MAX_TABLE_LINES);
    print_to_stdout(text(header, &rows[..rows.len() - hidden]));
    if hidden > 0 {
        print_to_stdout(format_args!("… and {hidden} more (--json shows all)"));
    }
    print_to_stdout("");
}

fn format_size(size: u64) -> String {
    bytes(size as f64).plain()
}

/// Formats an age such as `3 min ago`: below 100 s in seconds, below 100 min in minutes, below 48 h in hours, else in
/// days.
fn format_age(nanos: i64, now: WallTime) -> String {
    let seconds = (now - WallTime::from_unix_nanos(nanos)).seconds();
    let (value, unit) = match seconds.abs() {
        s if s < 100.0 => (s, "s"),
        s if s < 6_000.0 => (s / 60.0, "min"),
        s if s < 172_800.0 => (s / 3_600.0, "h"),
        s => (s / 86_400.0, "days"),
    };
    // The clock of another host may be ahead of this machine's clock.
    let direction = if seconds < -1.0 { "ahead" } else { "ago" };
    format!("{value:.0} {unit} {direction}")
}
