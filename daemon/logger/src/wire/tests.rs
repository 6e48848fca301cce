use peernet_clock::{DelaySource, Interval, OneWayDelay, RawTime, Span, Verdict};
use proptest::prelude::*;

use super::*;
use crate::limits::{MAX_ANCHORS, MAX_DEPTH, MAX_NAME_BYTES, MAX_NODES};
use crate::{Anchor, HostId, HostIndex, Measure, Name, Node, Rate, RawStamps, Transit, Unit, stage};

fn name() -> impl Strategy<Value = Name> {
    let standard = prop::sample::select(stage::ORDER.to_vec());
    prop_oneof![standard, "\\PC{0,40}".prop_map(|name| Name::from(name.as_str()))]
}

fn unit() -> impl Strategy<Value = Unit> {
    prop_oneof![Just(Unit::BYTES), Just(Unit::NONE), "\\PC{1,8}".prop_map(|symbol| Unit::new(&symbol))]
}

fn number() -> impl Strategy<Value = f64> {
    let whole = (-1_i64 << 60..1 << 60).prop_map(|whole| whole as f64);
    prop_oneof![prop::num::f64::ANY.prop_filter("a number", |value| !value.is_nan()), whole, Just(-0.0)]
}

fn span() -> impl Strategy<Value = Span> {
    prop_oneof![any::<i64>(), 0_i64..1 << 34].prop_map(Span::from_nanos)
}

fn ordered_pair<T: Clone + PartialOrd + std::fmt::Debug>(
    bound: impl Strategy<Value = T> + Clone,
) -> impl Strategy<Value = Option<(T, T)>> {
    prop::option::of((bound.clone(), bound).prop_map(|(a, b)| if a <= b { (a, b) } else { (b, a) }))
}

fn delay() -> impl Strategy<Value = OneWayDelay> {
    let source = prop::sample::select(DelaySource::ALL.to_vec());
    let verdict = prop::sample::select(Verdict::ALL.to_vec());
    let bounds = ordered_pair(any::<i64>().prop_map(Span::from_nanos))
        .prop_map(|bounds| bounds.map(|(lo, hi)| Interval { lo, hi }));
    (span(), prop::option::of(span()), bounds, source, verdict)
        .prop_map(|(raw, value, bounds, source, verdict)| OneWayDelay { raw, value, bounds, source, verdict })
}

fn measure() -> impl Strategy<Value = Measure> {
    let wall = || any::<i64>().prop_map(WallTime::from_unix_nanos);
    let raw = || any::<i64>().prop_map(RawTime::from_nanos);
    let raw_stamps = prop::option::of((raw(), raw()))
        .prop_map(|stamps| stamps.map(|(sent, received)| RawStamps { sent, received }));
    let transit = (wall(), prop::option::of(wall()), prop::option::of(delay()), raw_stamps);
    let rate = (prop::option::of(number()), ordered_pair(any::<i32>().prop_map(f64::from)));
    prop_oneof![
        Just(Measure::Container),
        prop::option::of(span()).prop_map(Measure::Timer),
        transit.prop_map(|(sent, received, delay, raw_stamps)| Measure::Transit(Box::new(Transit {
            sent,
            received,
            delay,
            raw_stamps,
        }))),
        (number(), unit()).prop_map(|(value, unit)| Measure::Value(value, unit)),
        rate.prop_map(|(value, bounds)| Measure::Throughput(Rate { value, bounds })),
        prop::option::of(number()).prop_map(Measure::TokenRate),
        (name(), unit(), prop::option::of(number()))
            .prop_map(|(kind, unit, value)| Measure::Custom(kind, unit, value)),
    ]
}

fn anchor() -> impl Strategy<Value = Anchor> {
    let wall = any::<i64>().prop_map(WallTime::from_unix_nanos);
    (any::<[u8; 16]>(), wall).prop_map(|(id, wall)| Anchor { host: HostId::from_bytes(id), wall })
}

fn tree() -> impl Strategy<Value = Tree> {
    let node = (any::<prop::sample::Index>(), name(), any::<prop::sample::Index>(), span(), measure());
    (prop::collection::vec(anchor(), 1..=MAX_ANCHORS), prop::collection::vec(node, 1..60)).prop_map(
        |(anchors, nodes)| {
            let hosts = anchors.len();
            let mut tree_nodes: Vec<Node> = Vec::new();
            for (index, (parent, name, host, start, measure)) in nodes.into_iter().enumerate() {
                // All parents are near the root, so that no branch exceeds the largest depth.
                let parent = (index > 0).then(|| NodeId(parent.index(index.min(MAX_DEPTH - 1)) as u32));
                let host = HostIndex(host.index(hosts) as u8);
                tree_nodes.push(Node { parent, name, host, start, measure });
            }
            Tree::from_parts(anchors, tree_nodes).expect("within the limits")
        },
    )
}

fn encode_to_bytes(tree: &Tree) -> Vec<u8> {
    let mut out = Vec::new();
    encode(tree, &mut out);
    out
}

fn delta_of(tree: &Tree, anchor: Anchor) -> TreeDelta {
    let (nodes, closed) = (tree.nodes().to_vec(), (NodeId(3), anchor.wall));
    TreeDelta { base: 7, others: tree.anchors()[1..].to_vec(), anchor, closed, nodes }
}

proptest! {
    #[test]
    fn trees_and_deltas_round_trip_in_every_form(tree in tree(), anchor in anchor()) {
        let bytes = encode_to_bytes(&tree);
        let decoded = decode(&bytes).expect("the written form is valid");
        prop_assert_eq!(&decoded, &tree);
        // Equality does not distinguish the signs of zero.
        prop_assert_eq!(encode_to_bytes(&decoded), bytes);
        let packed = rmp_serde::to_vec(&tree).expect("a tree can be serialised");
        prop_assert_eq!(&rmp_serde::from_slice::<Tree>(&packed).expect("the written form is valid"), &tree);

        let delta = delta_of(&tree, anchor);
        let mut bytes = Vec::new();
        encode_tree_delta(&delta, &mut bytes);
        prop_assert_eq!(&decode_tree_delta(&bytes), &Ok(delta.clone()));
        let packed = rmp_serde::to_vec(&delta).expect("a delta can be serialised");
        prop_assert_eq!(&rmp_serde::from_slice::<TreeDelta>(&packed).expect("the written form is valid"), &delta);
    }

    #[test]
    fn truncated_bytes_are_refused(tree in tree(), end: prop::sample::Index) {
        let bytes = encode_to_bytes(&tree);
        prop_assert!(decode(&bytes[..end.index(bytes.len())]).is_err());
        prop_assert_eq!(decode(&[&bytes[..], &[0]].concat()), Err(WireError::Trailing(1)));
    }

    #[test]
    fn damaged_bytes_are_refused_or_decode_to_valid_tree(
        tree in tree(), damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = encode_to_bytes(&tree);
        for (index, byte) in damage {
            let index = index.index(bytes.len());
            bytes[index] = byte;
        }
        if let Ok(tree) = decode(&bytes) {
            prop_assert_eq!(decode(&encode_to_bytes(&tree)), Ok(tree));
        }
        let _ = decode_tree_delta(&bytes);
    }

    #[test]
    fn decoding_of_arbitrary_bytes_does_not_panic(bytes: Vec<u8>) {
        let _ = (decode(&bytes), decode_tree_delta(&bytes));
    }
}

#[test]
fn json_form_of_tree_is_object_and_is_checked() {
    let mut tree = Tree::new(stage::ITERATION, Anchor { host: HostId::random(), wall: WallTime::default() });
    tree.add(NodeId::ROOT, stage::INFERENCE, Span::ZERO, Measure::Timer(Some(Span::from_nanos(5))));
    let text = serde_json::to_string(&tree).expect("a tree can be serialised");
    assert!(text.contains("\"inference\""), "{text}");
    assert_eq!(serde_json::from_str::<Tree>(&text).expect("the written form is valid"), tree);
    let own_parent = text.replace("\"parent\":0", "\"parent\":1");
    let error = serde_json::from_str::<Tree>(&own_parent).expect_err("a node is its own parent").to_string();
    assert!(error.contains("precedes its parent"), "{error}");
}

/// Returns the wire form of a tree from encoded nodes. The result may be invalid, unlike the output of the writer.
fn encode_by_hand(anchors: usize, nodes: &[&[u8]]) -> Vec<u8> {
    let mut out = vec![0x93, 1];
    writer::array(&mut out, anchors as u32);
    for _ in 0..anchors {
        writer::anchor(&mut out, &Anchor { host: HostId::from_bytes([7; 16]), wall: WallTime::default() });
    }
    writer::array(&mut out, nodes.len() as u32);
    out.extend(nodes.concat());
    out
}

/// Encoded root: an array of five elements. The root has no parent (nil), and its name, host, start
/// and kind are 0.
const ROOT: &[u8] = &[0x95, 0xc0, 0, 0, 0, 0];

#[test]
fn error_names_exceeded_limit() {
    assert_eq!(decode(&encode_by_hand(1, &[ROOT])).map(|tree| tree.nodes().len()), Ok(1));

    let limit = |what, found, limit| Err(WireError::Limit { what, found, limit });
    assert_eq!(decode(&vec![0; MAX_TREE_BYTES + 1]), Err(WireError::TooLong(MAX_TREE_BYTES + 1)));
    assert_eq!(decode(&[0x93, 2, 0x90, 0x90]), Err(WireError::Version(2)));
    assert_eq!(decode(&encode_by_hand(9, &[ROOT])), limit("hosts", 9, MAX_ANCHORS));
    assert_eq!(
        decode(&[0x93, 1, 0x90, 0xdd, 0xff, 0xff, 0xff, 0xff]),
        limit("nodes", u32::MAX as usize, MAX_NODES)
    );
    let long_name = [&[0x95, 0, 0xd9, 129][..], &[b'x'; 129], &[0, 0, 0]].concat();
    assert_eq!(
        decode(&encode_by_hand(1, &[ROOT, &long_name])),
        limit("bytes of a name", 129, MAX_NAME_BYTES)
    );
    let distant_parent: &[u8] = &[0x95, 0xce, 0xff, 0xff, 0xff, 0xff, 1, 0, 0, 0];
    assert_eq!(
        decode(&encode_by_hand(1, &[ROOT, distant_parent])),
        limit("nodes", u32::MAX as usize, MAX_NODES)
    );
}

#[test]
fn invalid_tree_is_refused_with_reason() {
    let tree = |nodes: &[&[u8]]| match decode(&encode_by_hand(1, nodes)) {
        Err(WireError::Tree(error)) => error,
        result => panic!("{result:?}"),
    };
    assert_eq!(tree(&[]), TreeError::Orphan(0));
    assert_eq!(tree(&[ROOT, ROOT]), TreeError::Orphan(1));
    let (own_parent, forward): (&[u8], &[u8]) = (&[0x95, 1, 1, 0, 0, 0], &[0x95, 2, 1, 0, 0, 0]);
    assert_eq!(tree(&[ROOT, own_parent]), TreeError::Order(1));
    assert_eq!(tree(&[ROOT, forward, own_parent]), TreeError::Order(1));
    assert_eq!(tree(&[ROOT, &[0x95, 0, 1, 1, 0, 0]]), TreeError::UnknownHost(1));
    let nan = [&[0x97, 0, 1, 0, 0, 3, 0xcb][..], &f64::NAN.to_be_bytes(), &[0xa0]].concat();
    assert_eq!(tree(&[ROOT, &nan]), TreeError::NotANumber(1));
    let crossed_bounds: &[u8] = &[0x98, 0, 1, 0, 0, 4, 1, 2, 1];
    assert_eq!(tree(&[ROOT, crossed_bounds]), TreeError::CrossedBounds(1));

    let chain: Vec<[u8; 6]> = (0..MAX_DEPTH as u8).map(|parent| [0x95, parent, 1, 0, 0, 0]).collect();
    let mut nodes: Vec<&[u8]> = vec![ROOT];
    nodes.extend(chain.iter().map(|node| &node[..]));
    assert_eq!(tree(&nodes), TreeError::TooDeep(MAX_DEPTH));
    nodes.pop();
    assert!(decode(&encode_by_hand(1, &nodes)).is_ok());
}

#[test]
fn wire_form_is_unchanged() {
    let host = HostId::from_bytes([0xaa; 16]);
    let mut tree = Tree::new(stage::ITERATION, Anchor { host, wall: WallTime::from_unix_nanos(1) });
    tree.add(NodeId::ROOT, stage::SENSING, Span::from_nanos(2), Measure::Timer(Some(Span::from_nanos(300))));
    tree.add(NodeId::ROOT, "grip".into(), Span::ZERO, Measure::Value(1.5, Unit::BYTES));
    let expected = [
        &[0x93, 1, 0x91, 0x92, 0xc4, 16][..],
        &[0xaa; 16],
        &[1, 0x93],
        &[0x95, 0xc0, 0, 0, 0, 0],
        &[0x96, 0, 1, 0, 2, 1, 0xcd, 0x01, 0x2c],
        &[0x97, 0, 0xa4, b'g', b'r', b'i', b'p', 0, 0, 3, 0xcb, 0x3f, 0xf8, 0, 0, 0, 0, 0, 0, 0xa1, b'B'],
    ];
    assert_eq!(encode_to_bytes(&tree), expected.concat());
}

#[test]
fn transit_without_raw_stamps_keeps_form_of_earlier_releases() {
    let (sent, received) = (WallTime::from_unix_nanos(3), Some(WallTime::from_unix_nanos(4)));
    let transit = |raw_stamps| {
        let mut tree = Tree::new(
            stage::ITERATION,
            Anchor { host: HostId::from_bytes([7; 16]), wall: WallTime::default() },
        );
        let transit = Transit { sent, received, delay: None, raw_stamps };
        tree.add(NodeId::ROOT, stage::UPLOAD, Span::from_nanos(2), Measure::Transit(Box::new(transit)));
        tree
    };
    let name = stage::code(&stage::UPLOAD).expect("a standard name");
    let without_stamps = [0x98, 0, name, 0, 2, 2, 3, 4, 0xc0];
    assert_eq!(encode_to_bytes(&transit(None)), encode_by_hand(1, &[ROOT, &without_stamps]));
    let json = serde_json::to_string(&transit(None)).expect("a tree can be serialised");
    assert!(!json.contains("raw_stamps"), "{json}");

    let stamps = RawStamps { sent: RawTime::from_nanos(5), received: RawTime::from_nanos(-6) };
    let with_stamps = [0x9a, 0, name, 0, 2, 2, 3, 4, 0xc0, 5, 0xfa];
    assert_eq!(encode_to_bytes(&transit(Some(stamps))), encode_by_hand(1, &[ROOT, &with_stamps]));
    let json = serde_json::to_string(&transit(Some(stamps))).expect("a tree can be serialised");
    assert_eq!(
        serde_json::from_str::<Tree>(&json).expect("the written form is valid"),
        transit(Some(stamps))
    );
    // A node with only one of the two stamps is malformed.
    assert!(decode(&encode_by_hand(1, &[ROOT, &[0x99, 0, name, 0, 2, 2, 3, 4, 0xc0, 5]])).is_err());
}
