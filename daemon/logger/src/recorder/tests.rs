use std::sync::Arc;

use peernet_clock::{ClockIdentity, ManualClock};

use super::*;
use crate::limits::{MAX_NODES, RESERVED_NODES};

fn recorder() -> (Arc<ManualClock>, Recorder) {
    let clock = Arc::new(ManualClock::new(WallTime::from_unix_nanos(1_000), ClockIdentity::new("b", "c")));
    let log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
    (clock, log)
}

/// Checks all nodes of a tree.
fn check_all(tree: &Tree) -> Result<(), TreeError> {
    let first_node = 0;
    tree.check(first_node)
}

fn parents_and_names(tree: &Tree) -> Vec<(Option<u32>, String)> {
    tree.nodes().iter().map(|node| (node.parent.map(|parent| parent.0), node.name.to_string())).collect()
}

#[test]
fn guards_close_their_nodes() {
    let (clock, mut log) = recorder();
    {
        let mut sensing = log.time(stage::SENSING);
        clock.advance(Span::from_nanos(3));
        {
            let mut model = sensing.container("model".into());
            let _capture = model.time(stage::CAPTURE);
            clock.advance(Span::from_nanos(4));
        }
        let queue = sensing.start(stage::QUEUE);
        clock.advance(Span::from_nanos(5));
        sensing.stop(queue);
        // A timer that is already closed keeps its end.
        sensing.stop(queue);
    }
    let open = log.start(stage::INFERENCE);
    let tree = log.finish();
    let expected = [
        (None, "iteration"),
        (Some(0), "sensing"),
        (Some(1), "model"),
        (Some(2), "capture"),
        (Some(1), "queue"),
        (Some(0), "inference"),
    ];
    assert_eq!(parents_and_names(&tree), expected.map(|(parent, name)| (parent, name.to_owned())));
    let seconds = |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value());
    assert_eq!(seconds(&["sensing"]), Some(Span::from_nanos(12).seconds()));
    assert_eq!(seconds(&["sensing", "model", "capture"]), Some(Span::from_nanos(4).seconds()));
    assert_eq!(seconds(&["sensing", "queue"]), Some(Span::from_nanos(5).seconds()));
    assert!(tree.get(open).is_some_and(|node| node.measure.is_open()));
    assert_eq!(check_all(&tree), Ok(()));
}

#[test]
fn token_count_and_time_to_first_token_are_recorded() {
    let (clock, mut log) = recorder();
    {
        let mut tokens = log.tokens("answer".into());
        clock.advance(Span::from_millis(400));
        tokens.add_tokens(1);
        clock.advance(Span::from_millis(100));
        tokens.add_tokens(4);
        clock.advance(Span::from_seconds(9));
    }
    drop(log.tokens("silence".into()));
    let tree = log.finish();
    let value = |path: &[&str]| tree.find(path).and_then(|(_, node)| node.measure.value());
    // The rate counts the time until the last tokens: 5 tokens in 0.5 s. The 9 s afterwards do not count.
    assert_eq!(value(&["answer"]), Some(10.0));
    assert_eq!(value(&["answer", "tokens"]), Some(5.0));
    assert_eq!(value(&["answer", "time-to-first-token"]), Some(0.4));
    assert_eq!((value(&["silence"]), value(&["silence", "tokens"])), (None, Some(0.0)));
    assert_eq!(tree.find(&["silence", "time-to-first-token"]), None);
}

#[test]
fn failed_reading_is_recorded_without_value() {
    struct BrokenMeter;
    impl Meter for BrokenMeter {
        fn kind(&self) -> Name {
            "energy".into()
        }
        fn unit(&self) -> Unit {
            Unit::JOULES
        }
        fn begin(&mut self) {}
        fn end(&mut self) -> f64 {
            f64::NAN
        }
    }
    let (_, mut log) = recorder();
    drop(log.measure("board".into(), BrokenMeter));
    let force = log.record_value("force".into(), f64::NAN, Unit::new("N"));
    let tree = log.finish();
    assert_eq!(check_all(&tree), Ok(()));
    let board = &tree.find(&["board"]).expect("recorded").1.measure;
    assert_eq!((board.value(), board.unit(), board.is_open()), (None, Unit::JOULES, true));
    let force = &tree.get(force).expect("recorded").measure;
    assert_eq!((force.kind().as_str(), force.value(), force.unit()), ("value", None, Unit::new("N")));
}

#[test]
fn tree_stays_within_limits_and_counts_skipped_nodes() {
    let (_, mut log) = recorder();
    for _ in 0..MAX_NODES {
        log.start(stage::CAPTURE);
    }
    let skipped_node = log.start(stage::CAPTURE);
    log.stop(skipped_node);
    let mut tree = log.finish();
    assert_eq!(skipped_node, NodeId::SKIPPED);
    let skipped = tree.find(&["skipped-nodes"]).and_then(|(_, node)| node.measure.value());
    // `MAX_NODES` + 1 nodes were started. The root and the reserved places leave room for
    // `MAX_NODES` - `RESERVED_NODES` - 1 of them.
    assert_eq!(skipped, Some((RESERVED_NODES + 2) as f64));
    // The node `skipped-nodes` takes the first of the reserved places. A child of a skipped node becomes a
    // child of the root.
    for _ in 1..RESERVED_NODES {
        tree.add(skipped_node, stage::TOTAL, Span::ZERO, Measure::Timer(None));
    }
    assert_eq!((tree.nodes().len(), check_all(&tree)), (MAX_NODES, Ok(())));
}

#[test]
fn nodes_deeper_than_limit_are_skipped() {
    fn descend(log: &mut Recorder, levels: usize) {
        if levels > 0 {
            let mut deeper = log.time("step".into());
            descend(&mut deeper, levels - 1);
        }
    }
    let (_, mut log) = recorder();
    descend(&mut log, MAX_DEPTH + 5);
    descend(&mut log, 1);
    let tree = log.finish();
    assert_eq!(check_all(&tree), Ok(()));
    let skipped = tree.find(&["skipped-nodes"]).and_then(|(_, node)| node.measure.value());
    // The root is the first level, so the first call of `descend` adds `MAX_DEPTH` - 1 nodes and skips 6.
    assert_eq!(skipped, Some(6.0));
    // These nodes, the root, the node of the second call of `descend`, and `skipped-nodes`.
    assert_eq!(tree.nodes().len(), MAX_DEPTH + 2);
    assert!(tree.nodes()[1..].iter().all(|node| !node.measure.is_open()));
}

/// Returns a tree of a worker on another host. The worker sent a request to a third host, which added nodes.
fn tree_of_other_host(third: HostId) -> Tree {
    let (clock, mut log) = recorder();
    clock.advance(Span::from_nanos(50));
    log.record_value("force".into(), 2.0, Unit::new("N"));
    let sent = log.clock().stamp();
    let upload = log.start_transit(stage::UPLOAD, sent);
    let tree = log.tree().clone();
    let mut remote =
        Recorder::resume(log.clock().clone(), third, tree, upload, sent).expect("the transit is open");
    remote.record_value("grip".into(), 3.0, Unit::new("N"));
    let delta = remote.into_tree_delta().expect("the tree was resumed");
    log.tree_mut().apply_delta(delta).expect("fits");
    log.finish()
}

#[test]
fn inserted_tree_keeps_shape_hosts_and_times() {
    let third = HostId::random();
    let other = tree_of_other_host(third);
    let (clock, _) = recorder();
    clock.advance(Span::from_nanos(7));
    // The inserting host is the third host, which the tree already contains.
    let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), third);
    let root = {
        let mut inference = log.container(stage::INFERENCE);
        inference.insert(&other).expect("fits")
    };
    let second_root = log.insert(&other).expect("fits");
    let tree = log.finish();
    assert_eq!(check_all(&tree), Ok(()));
    assert_eq!(tree.anchors().len(), 2);
    assert_eq!(tree.get(root).and_then(|node| node.parent), Some(NodeId(1)));
    assert_eq!(tree.get(second_root).and_then(|node| node.parent), Some(NodeId::ROOT));
    for (index, node) in other.nodes().iter().enumerate() {
        let inserted = &tree.nodes()[root.index() + index];
        assert_eq!((&inserted.name, &inserted.measure), (&node.name, &node.measure));
        assert_eq!(tree.wall_start(inserted), other.wall_start(node));
        let host = |tree: &Tree, node: &Node| tree.anchors()[usize::from(node.host.0)].host;
        assert_eq!(host(&tree, inserted), host(&other, node));
    }
}

#[test]
fn delta_contains_inserted_tree_with_its_hosts() {
    let other = tree_of_other_host(HostId::random());
    let (_, mut log) = recorder();
    let sent = log.clock().stamp();
    let upload = log.start_transit(stage::UPLOAD, sent);
    let tree = log.tree().clone();
    let mut remote = Recorder::resume(log.clock().clone(), HostId::random(), tree, upload, sent)
        .expect("the transit is open");
    remote.insert(&other).expect("fits");
    let delta = remote.into_tree_delta().expect("the tree was resumed");
    assert_eq!(delta.others.len(), 2);
    log.tree_mut().apply_delta(delta).expect("fits");
    let tree = log.finish();
    assert_eq!((tree.anchors().len(), check_all(&tree)), (4, Ok(())));
    assert!(tree.find(&["iteration", "grip"]).is_some());
}

#[test]
fn failed_insertion_leaves_tree_unchanged() {
    let (_, mut log) = recorder();
    // With the root, this leaves room for three nodes. The tree of the other host has four.
    for _ in 0..MAX_NODES - RESERVED_NODES - 4 {
        log.start(stage::CAPTURE);
    }
    let before = log.tree().clone();
    let other = tree_of_other_host(HostId::random());
    assert!(matches!(log.insert(&other), Err(TreeError::TooManyNodes(_))));
    assert_eq!(log.tree(), &before);

    let (_, mut log) = recorder();
    // Each inserted tree has two hosts of its own. Three trees leave room for one more host.
    for _ in 0..MAX_ANCHORS / 2 - 1 {
        log.insert(&tree_of_other_host(HostId::random())).expect("fits");
    }
    let before = log.tree().clone();
    assert_eq!(log.insert(&tree_of_other_host(HostId::random())), Err(TreeError::TooManyHosts(9)));
    assert_eq!(log.tree(), &before);
}

#[test]
fn open_transit_accepts_one_valid_delta() {
    let (_, mut log) = recorder();
    let sent = log.clock().stamp();
    let upload = log.start_transit(stage::UPLOAD, sent);
    let resume = |log: &Recorder, at: NodeId| {
        Recorder::resume(log.clock().clone(), HostId::random(), log.tree().clone(), at, sent)
    };
    assert!(matches!(resume(&log, NodeId::ROOT), Err(TreeError::NotInFlight(0))));
    assert!(matches!(resume(&log, NodeId::SKIPPED), Err(TreeError::NotInFlight(_))));
    let delta =
        resume(&log, upload).expect("the transit is open").into_tree_delta().expect("the tree was resumed");
    let mut invalid_delta = delta.clone();
    invalid_delta.nodes.push(Node {
        parent: Some(NodeId(9)),
        name: stage::QUEUE,
        host: HostIndex(1),
        start: Span::ZERO,
        measure: Measure::Container,
    });
    let before = log.tree().clone();
    assert_eq!(log.tree_mut().apply_delta(invalid_delta), Err(TreeError::Order(2)));
    assert_eq!(log.tree(), &before);
    assert_eq!(log.tree_mut().apply_delta(delta.clone()), Ok(()));
    assert_eq!(log.tree_mut().apply_delta(delta), Err(TreeError::NotInFlight(1)));
}
