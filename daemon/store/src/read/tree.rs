//! Trees made from their rows.

use peernet_clock::{OneWayDelay, RawTime, Span, WallTime};
use peernet_logger::{
    Anchor, HostIndex, Measure, Name, Node, NodeId, Rate, RawStamps, Slug, Transit, Tree, Unit,
};
use sqlx::FromRow;

use super::{StoredDelay, corrupt_data, parse, parse_name, sql, wall};
use crate::error::StoreError;
use crate::readers::Readers;

/// Name of the requested data in errors.
const WHAT: &str = "an iteration's tree";

#[derive(FromRow)]
struct NodeRow {
    iteration: i64,
    node: u32,
    parent: Option<u32>,
    host: u8,
    start_ns: i64,
    value: Option<f64>,
    lo: Option<f64>,
    hi: Option<f64>,
    #[sqlx(rename = "text")]
    name: String,
    kind: String,
    custom: bool,
    unit: String,
}

#[derive(FromRow)]
struct TransitRow {
    iteration: i64,
    node: u32,
    sent_ns: i64,
    received_ns: Option<i64>,
    raw_ns: Option<i64>,
    source: Option<u8>,
    verdict: Option<u8>,
    sent_raw_ns: Option<i64>,
    received_raw_ns: Option<i64>,
}

impl TransitRow {
    fn raw_stamps(&self) -> Option<RawStamps> {
        let (sent, received) = self.sent_raw_ns.zip(self.received_raw_ns)?;
        Some(RawStamps { sent: RawTime::from_nanos(sent), received: RawTime::from_nanos(received) })
    }
}

#[derive(FromRow)]
struct AnchorRow {
    iteration: i64,
    uuid: String,
    name: Option<String>,
    wall_ns: i64,
}

/// The edge of a run, and the name of its cloud, which is the second host of the run's trees.
#[derive(FromRow)]
struct TreeHosts {
    uuid: String,
    name: Option<String>,
    /// The cloud's name, as the edge reported it.
    peer: Option<String>,
}

/// A tree with the names of its anchors' hosts.
pub(super) type StoredTree = (Tree, Vec<Option<Slug>>);

/// Returns the trees of iterations, as the agent sent them, with the names of their hosts.
///
/// `iterations` has the number and the start of each iteration, in ascending order. The result is `None` for an
/// iteration that was deleted meanwhile.
pub(super) async fn trees(
    readers: &Readers,
    run: i64,
    iterations: &[(i64, WallTime)],
) -> Result<Vec<Option<StoredTree>>, StoreError> {
    let numbers: Vec<i64> = iterations.iter().map(|(number, _)| *number).collect();
    let numbers = serde_json::to_string(&numbers).map_err(|error| corrupt_data(WHAT, error))?;
    let tree_hosts: TreeHosts = sqlx::query_as(sql::TREE_HOSTS)
        .bind(run)
        .fetch_one(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let anchors: Vec<AnchorRow> = sqlx::query_as(sql::ANCHORS)
        .bind(run)
        .bind(&numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let transits: Vec<TransitRow> = sqlx::query_as(sql::TRANSITS)
        .bind(run)
        .bind(&numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    // The nodes are read last. If retention deletes an iteration between the statements, the iteration has no nodes and
    // is reported as deleted. It cannot have nodes without their stamps.
    let nodes: Vec<NodeRow> = sqlx::query_as(sql::NODES)
        .bind(run)
        .bind(&numbers)
        .fetch_all(&readers.pool())
        .await
        .map_err(readers.error_for(WHAT))?;
    let (mut anchors, mut nodes, mut transits) = (&anchors[..], &nodes[..], &transits[..]);
    let mut trees = Vec::with_capacity(iterations.len());
    for (number, started) in iterations {
        // The table `anchor` has the anchors of all hosts except the edge.
        let (other_anchors, nodes, transits) = (
            take_while(&mut anchors, |row| row.iteration == *number),
            take_while(&mut nodes, |row| row.iteration == *number),
            take_while(&mut transits, |row| row.iteration == *number),
        );
        let exists = !nodes.is_empty();
        let tree = exists.then(|| tree(&tree_hosts, *started, other_anchors, nodes, transits));
        trees.push(tree.transpose()?);
    }
    Ok(trees)
}

/// Removes and returns the rows before the first row for which `predicate` is false.
fn take_while<'a, T>(rows: &mut &'a [T], predicate: impl Fn(&T) -> bool) -> &'a [T] {
    let (taken, rest) = rows.split_at(rows.iter().take_while(|row| predicate(row)).count());
    *rows = rest;
    taken
}

/// Makes a tree from its rows. The edge's anchor is not stored, because this anchor is the start of the iteration.
fn tree(
    tree_hosts: &TreeHosts,
    started: WallTime,
    other_anchors: &[AnchorRow],
    nodes: &[NodeRow],
    transits: &[TransitRow],
) -> Result<StoredTree, StoreError> {
    let mut anchors = vec![Anchor { host: parse(WHAT, &tree_hosts.uuid)?, wall: started }];
    let mut hosts = vec![parse_name(WHAT, tree_hosts.name.as_deref())?];
    for (index, anchor) in other_anchors.iter().enumerate() {
        anchors.push(Anchor { host: parse(WHAT, &anchor.uuid)?, wall: wall(anchor.wall_ns) });
        // A cloud that never introduced itself to this aggregator has no name in the table `host`. The edge reported a
        // name for it.
        let peer = tree_hosts.peer.as_ref().filter(|_| index == 0);
        hosts.push(parse_name(WHAT, anchor.name.as_ref().or(peer).map(String::as_str))?);
    }
    let mut tree_nodes = Vec::with_capacity(nodes.len());
    for row in nodes {
        let transit = transits.iter().find(|transit| transit.node == row.node);
        tree_nodes.push(Node {
            parent: row.parent.map(NodeId),
            name: row.name.as_str().into(),
            host: HostIndex(row.host),
            start: Span::from_nanos(row.start_ns),
            measure: measure(row, transit)?,
        });
    }
    let tree = Tree::from_parts(anchors, tree_nodes).map_err(|error| corrupt_data(WHAT, error))?;
    Ok((tree, hosts))
}

/// Returns the measure of a node. Seconds are converted to nanoseconds without loss for durations up to 17 days.
fn measure(row: &NodeRow, transit: Option<&TransitRow>) -> Result<Measure, StoreError> {
    let unit = || Unit::new(&row.unit);
    // SQLite stores not-a-number as NULL.
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
                transit.ok_or_else(|| corrupt_data(WHAT, format_args!("node {} has no stamps", row.node)))?;
            Measure::Transit(Box::new(Transit {
                sent: wall(stamps.sent_ns),
                received: stamps.received_ns.map(WallTime::from_unix_nanos),
                delay: delay(row, stamps)?,
                raw_stamps: stamps.raw_stamps(),
            }))
        }
        kind => {
            return Err(corrupt_data(
                WHAT,
                format_args!("node {} is of an unknown kind, {kind:?}", row.node),
            ));
        }
    })
}

fn delay(row: &NodeRow, stamps: &TransitRow) -> Result<Option<OneWayDelay>, StoreError> {
    let TransitRow { raw_ns, source, verdict, .. } = *stamps;
    let stored = StoredDelay { raw_ns, source, verdict, value: row.value, bounds: row.lo.zip(row.hi) };
    stored.into_delay(WHAT)
}
