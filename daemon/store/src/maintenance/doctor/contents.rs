//! Reading of the tables' contents, except for the rows of the large tables.

use peernet_clock::{Span, WallTime};
use sqlx::{AssertSqlSafe, SqliteConnection};

use super::report::{OpenRun, Report, TableRows};
use crate::column::count;

/// Time of silence after which a host is considered to be no longer measuring.
const SILENCE_LIMIT: Span = Span::from_seconds(3_600);
/// Tables that are small enough to be counted.
const COUNTED_TABLES: [&str; 8] =
    ["host", "pipeline", "stream", "run", "name", "incident", "gap", "quarantine"];

const STREAMS: &str = "SELECT host.name AS host, stream.uuid AS stream, stream.stored, stream.previous, stream.last_seen_ns \
     FROM stream JOIN host ON host.id = stream.host ORDER BY stream.last_seen_ns DESC LIMIT 1000";
const GAPS: &str = "SELECT host.name AS host, gap.reason, count(*) AS gaps, sum(gap.count) AS events, \
     sum(gap.count = 0) AS uncounted, min(gap.from_ns) AS from_ns, max(gap.to_ns) AS to_ns \
     FROM gap JOIN host ON host.id = gap.host GROUP BY gap.host, gap.reason ORDER BY events DESC, gaps DESC LIMIT 1000";
const QUARANTINE: &str = "SELECT host.name AS host, quarantine.reason, count(*) AS batches, max(quarantine.received_ns) AS last_ns \
     FROM quarantine JOIN host ON host.id = quarantine.host \
     GROUP BY quarantine.host, quarantine.reason ORDER BY batches DESC";
/// Time ranges of the roll-ups, by width. The statement makes two look-ups for each run and width.
const ROLLUPS: &str = "SELECT width.column1 AS resolution_s, \
     min((SELECT min(bucket_s) FROM rollup WHERE rollup.run = run.number AND resolution_s = width.column1)) AS oldest_s, \
     max((SELECT max(bucket_s) FROM rollup WHERE rollup.run = run.number AND resolution_s = width.column1)) AS newest_s \
     FROM (VALUES (1), (10), (60), (3600)) AS width LEFT JOIN run GROUP BY width.column1 ORDER BY width.column1";
/// Maximum number of runs in the list of open runs.
const MAX_OPEN_RUNS: u32 = 1_000;
/// Runs without an end whose hosts were not seen since a time: ?1 this time, ?2 maximum number.
const OPEN_RUNS: &str = "SELECT run.number, pipeline.name AS pipeline, host.name AS host, host.last_seen_ns \
     FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
     WHERE run.ended_ns IS NULL AND host.last_seen_ns < ?1 ORDER BY run.number LIMIT ?2";
/// Estimates the numbers of stored iterations and nodes with a few lookups per run. The number of iterations of a run
/// is the range from the first stored number to the last, but at most the run's counter. The number of nodes per
/// iteration is the average of the newest 20 iterations.
const STORED_ROWS: &str = "WITH kept AS ( \
       SELECT number AS run, ok + failed + lost + timeout + warm_up AS counted, \
         (SELECT min(iteration.number) FROM iteration WHERE iteration.run = run.number) AS oldest, \
         (SELECT max(iteration.number) FROM iteration WHERE iteration.run = run.number) AS newest FROM run \
     ), sampled AS ( \
       SELECT min(newest - oldest + 1, counted) AS iterations, \
         (SELECT count(*) FROM iteration WHERE iteration.run = kept.run AND number > newest - 20) AS sample, \
         (SELECT count(*) FROM node WHERE node.run = kept.run AND iteration > newest - 20) AS nodes \
       FROM kept WHERE newest IS NOT NULL \
     ) SELECT coalesce(sum(iterations), 0), coalesce(sum(iterations * nodes / sample), 0) FROM sampled";
/// Numbers of iterations and rows of statistics that retention deleted before the end of their
/// retention period.
const EARLY_DELETIONS: &str = "SELECT what, count FROM retention_note";
/// Time and text of the last deletion by retention. All deletions of an hour share one incident, whose time is the time
/// of the first of these deletions.
const LAST_DELETION: &str = "SELECT strftime('%Y-%m-%d %H:%M:%S', at_ns / 1000000000, 'unixepoch'), text FROM incident INDEXED BY incident_of_aggregator \
     WHERE host IS NULL AND kind = 'retention' ORDER BY id DESC LIMIT 1";
/// Number of runs of an earlier version whose coarser roll-ups are still to be computed.
const DEBTS: &str = "SELECT count(*) FROM rollup_debt";

/// Reads the contents of the tables into the report, and adds findings.
pub(super) async fn read(report: &mut Report, connection: &mut SqliteConnection, now: WallTime) {
    count_rows(report, connection).await;
    let answer = sqlx::query_as(STREAMS).fetch_all(&mut *connection).await;
    report.streams = report.value_or_problem("the streams", answer);
    let answer = sqlx::query_as(GAPS).fetch_all(&mut *connection).await;
    report.gaps = report.value_or_problem("the gaps", answer);
    let answer = sqlx::query_as(QUARANTINE).fetch_all(&mut *connection).await;
    report.quarantine = report.value_or_problem("the quarantine", answer);
    let answer = sqlx::query_as(ROLLUPS).fetch_all(&mut *connection).await;
    report.rollups = report.value_or_problem("the roll-ups", answer);
    let query = sqlx::query_as(OPEN_RUNS).bind((now - SILENCE_LIMIT).unix_nanos()).bind(MAX_OPEN_RUNS);
    let answer = query.fetch_all(&mut *connection).await;
    let open: Vec<OpenRun> = report.value_or_problem("the open runs", answer);
    report.open_runs = open;
    let answer = sqlx::query_as(EARLY_DELETIONS).fetch_all(&mut *connection).await;
    let early_deletions: Vec<(String, i64)> = report.value_or_problem("what retention did", answer);
    let answer = sqlx::query_as(LAST_DELETION).fetch_optional(&mut *connection).await;
    let last_deletion: Option<(String, String)> =
        report.value_or_problem("what retention deleted last", answer);
    if let Some((at, text)) = last_deletion {
        report.notice(
            format!("retention {text}, in the hour that began at {at} UTC"),
            "no action is needed if this is intended; otherwise change [aggregator.retention], or pin runs that must stay",
        );
    }
    let answer = sqlx::query_scalar(DEBTS).fetch_one(connection).await;
    let debts: i64 = report.value_or_problem("what is left of the last update", answer);
    add_findings(report, &early_deletions, debts);
}

/// Reads the number of rows of each table.
async fn count_rows(report: &mut Report, connection: &mut SqliteConnection) {
    for table in COUNTED_TABLES {
        let statement = format!("SELECT count(*) FROM {table}");
        let answer = sqlx::query_scalar(AssertSqlSafe(statement)).fetch_one(&mut *connection).await;
        let rows: i64 = report.value_or_problem(&format!("the table {table}"), answer);
        report.tables.push(TableRows { table, rows: count(rows), estimated: false });
    }
    let answer = sqlx::query_as(STORED_ROWS).fetch_one(connection).await;
    let (iterations, nodes): (i64, i64) = report.value_or_problem("the iterations", answer);
    for (table, rows) in [("iteration", iterations), ("node", nodes)] {
        report.tables.push(TableRows { table, rows: count(rows), estimated: true });
    }
}

/// Adds findings for contents that need attention.
fn add_findings(report: &mut Report, early_deletions: &[(String, i64)], debts: i64) {
    let gaps: i64 = report.gaps.iter().map(|group| group.gaps).sum();
    // A host may have reported any number of lost events, so the sum could overflow.
    let events = report.gaps.iter().fold(0_i64, |events, group| events.saturating_add(group.events));
    if gaps > 0 {
        report.notice(
            format!("{gaps} gaps: at least {events} events never arrived"),
            "see the table of gaps for times and reasons; statistics of those times include only events that arrived",
        );
    }
    let quarantined: i64 = report.quarantine.iter().map(|group| group.batches).sum();
    if quarantined > 0 {
        report.notice(
            format!("{quarantined} batches could not be stored and were quarantined (table quarantine)"),
            "see the reasons in the table: an agent of another version, or a failing disk or memory",
        );
    }
    if let [first, ..] = report.open_runs.as_slice() {
        let runs = report.open_runs.len();
        let prefix = if runs < MAX_OPEN_RUNS as usize { "" } else { "at least " };
        let what = format!(
            "{prefix}{runs} runs have no end, and their hosts have been silent for an hour; the first is #{}",
            first.number
        );
        report.notice(what, "restart the agents: they end their runs and send the events in their spools");
    }
    for (what, items) in early_deletions {
        report.notice(
            format!("retention deleted {items} iterations and rows of statistics before the end of their retention period ({what})"),
            "raise [aggregator.retention] size_limit_bytes, or shorten the periods",
        );
    }
    if debts > 0 {
        report.notice(
            format!("{debts} runs of an older version have only roll-ups of 10 s"),
            "the aggregator computes the missing roll-ups at its next start",
        );
    }
}
