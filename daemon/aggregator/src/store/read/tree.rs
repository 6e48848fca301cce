//! From rows back to a tree.

use peernet_clock::{OneWayDelay, Span, WallTime};
use peernet_logger::{Anchor, HostIndex, Measure, Name, Node, NodeId, Rate, Slug, Transit, Tree, Unit};
use sqlx::FromRow;

use super::{StoredDelay, corrupt, name, parse, sql, wall};
use crate::error::StoreError;
use crate::store::readers::Readers;

const WHAT: &str = "an iteration's tree";

#[derive(FromRow)]
struct NodeRow {
    node: u32,
    parent: Option<u32>,
    host: u8,
    start_ns: i64,
    value: Option<f64>,
    lo: Option<f64>,
    hi: Option<f64>,
    text: String,
    kind: String,
    custom: bool,
    unit: String,
}

#[derive(FromRow)]
struct TransitRow {
    node: u32,
    sent_ns: i64,
    received_ns: Option<i64>,
    raw_ns: Option<i64>,
    source: Option<u8>,
    verdict: Option<u8>,
}

/// The tree of an iteration as it was sent, and the names of its hosts.
pub(super) async fn tree(
    readers: &Readers,
    run: i64,
    iteration: i64,
    started: WallTime,
) -> Result<(Tree, Vec<Option<Slug>>), StoreError> {
    let (anchors, hosts) = anchors(readers, run, iteration, started).await?;
    let nodes: Vec<NodeRow> = sqlx::query_as(sql::NODES)
        .bind(run)
        .bind(iteration)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    let transits: Vec<TransitRow> = sqlx::query_as(sql::TRANSITS)
        .bind(run)
        .bind(iteration)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    let mut nodes_again = Vec::with_capacity(nodes.len());
    for row in nodes {
        let transit = transits.iter().find(|transit| transit.node == row.node);
        nodes_again.push(Node {
            parent: row.parent.map(NodeId),
            name: row.text.as_str().into(),
            host: HostIndex(row.host),
            start: Span::from_nanos(row.start_ns),
            measure: measure(&row, transit)?,
        });
    }
    let tree = Tree::from_parts(anchors, nodes_again).map_err(|error| corrupt(WHAT, error))?;
    Ok((tree, hosts))
}

async fn anchors(
    readers: &Readers,
    run: i64,
    iteration: i64,
    started: WallTime,
) -> Result<(Vec<Anchor>, Vec<Option<Slug>>), StoreError> {
    let edge: (String, Option<String>) =
        sqlx::query_as(sql::EDGE).bind(run).fetch_one(&readers.pool).await.map_err(readers.failed(WHAT))?;
    let others: Vec<(String, Option<String>, i64)> = sqlx::query_as(sql::ANCHORS)
        .bind(run)
        .bind(iteration)
        .fetch_all(&readers.pool)
        .await
        .map_err(readers.failed(WHAT))?;
    let mut anchors = vec![Anchor { host: parse(WHAT, &edge.0)?, wall: started }];
    let mut hosts = vec![name(WHAT, edge.1.as_deref())?];
    for (uuid, text, wall_ns) in others {
        anchors.push(Anchor { host: parse(WHAT, &uuid)?, wall: wall(wall_ns) });
        hosts.push(name(WHAT, text.as_deref())?);
    }
    Ok((anchors, hosts))
}

/// What was measured. Seconds go back to nanoseconds without loss for durations up to 17 days.
fn measure(row: &NodeRow, transit: Option<&TransitRow>) -> Result<Measure, StoreError> {
    let unit = || Unit::new(&row.unit);
    // SQLite keeps not-a-number as NULL.
    let number = || row.value.unwrap_or(f64::NAN);
    if row.custom {
        return Ok(Measure::Custom(Name::from(row.kind.as_str()), unit(), row.value));
    }
    Ok(match row.kind.as_str() {
        "container" => Measure::Container,
        "timer" => Measure::Timer(row.value.map(Span::from_seconds_f64)),
        "value" => Measure::Value(number(), unit()),
        "throughput" => Measure::Throughput(Rate { value: row.value, bounds: row.lo.zip(row.hi) }),
        "token-rate" => Measure::TokenRate(row.value),
        "transit" => {
            let stamps =
                transit.ok_or_else(|| corrupt(WHAT, format_args!("node {} has no stamps", row.node)))?;
            Measure::Transit(Box::new(Transit {
                sent: wall(stamps.sent_ns),
                received: stamps.received_ns.map(WallTime::from_unix_nanos),
                delay: delay(row, stamps)?,
            }))
        }
        kind => return Err(corrupt(WHAT, format_args!("node {} is of an unknown kind, {kind:?}", row.node))),
    })
}

fn delay(row: &NodeRow, stamps: &TransitRow) -> Result<Option<OneWayDelay>, StoreError> {
    let TransitRow { raw_ns, source, verdict, .. } = *stamps;
    let stored = StoredDelay { raw_ns, source, verdict, value: row.value, bounds: row.lo.zip(row.hi) };
    stored.judged(WHAT)
}
