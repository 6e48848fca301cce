use peernet_clock::{Span, WallTime};
use proptest::prelude::*;

use super::*;
use crate::{Anchor, HostId, Measure, Unit, stage};

/// Builds a tree from `(path, value)` pairs in the order of logging. Nodes without a value are containers.
fn tree(nodes: &[(&str, Option<f64>)]) -> Tree {
    let anchor = Anchor { host: HostId::random(), wall: WallTime::from_unix_nanos(0) };
    let mut tree = Tree::new(stage::ITERATION, anchor);
    for (path, value) in nodes {
        let (parent_path, name) = path.rsplit_once('/').unwrap_or(("", path));
        let parent_path: Vec<&str> = parent_path.split('/').filter(|name| !name.is_empty()).collect();
        let parent = tree.find(&parent_path).expect("the parent is logged first").0;
        let measure = value.map_or(Measure::Container, |value| Measure::Value(value, Unit::NONE));
        tree.add(parent, Name::from(name), Span::ZERO, measure);
    }
    tree
}

fn csv(rows: &[Tree]) -> String {
    let mut out = Vec::new();
    write(&mut out, rows.iter().enumerate().map(|(index, tree)| (index as u64 + 1, tree)))
        .expect("writing to memory succeeds");
    String::from_utf8(out).expect("the table is UTF-8")
}

#[test]
fn nested_names_are_joined_and_values_of_parents_get_suffix() {
    let rows = [tree(&[
        ("sensing", Some(0.5)),
        ("inference", Some(2.0)),
        ("inference/pre", Some(0.25)),
        ("model", None),
        ("model/layer", None),
        ("model/layer/one", Some(1e-7)),
        ("download", Some(3.0)),
    ])];
    assert_eq!(
        csv(&rows),
        "iteration,sensing,inference_val,inference_pre,model_layer_one,download\n1,0.5,2,0.25,0.0000001,3\n"
    );
}

#[test]
fn columns_of_later_rows_keep_their_order() {
    let rows = [
        tree(&[("a", Some(1.0)), ("c", Some(3.0))]),
        tree(&[("a", Some(1.0)), ("b", Some(2.0)), ("c", Some(3.0)), ("d", Some(4.0))]),
        tree(&[("c", Some(3.0)), ("c/deep", Some(5.0))]),
        tree(&[]),
    ];
    assert_eq!(csv(&rows), "iteration,a,b,c_val,c_deep,d\n1,1,,3,,\n2,1,2,3,,4\n3,,,3,5,\n4,,,,,\n");
}

#[test]
fn column_names_are_unique() {
    let rows = [tree(&[
        ("iteration", Some(0.0)),
        ("a_b", Some(1.0)),
        ("a", None),
        ("a/b", Some(2.0)),
        ("tool", Some(3.0)),
        ("tool", Some(4.0)),
    ])];
    assert_eq!(csv(&rows), "iteration,iteration_2,a_b,a_b_2,tool,tool_2\n1,0,1,2,3,4\n");
}

#[test]
fn special_characters_in_names_are_quoted() {
    let rows = [tree(&[("force, \"left\"", Some(1.0))])];
    assert_eq!(csv(&rows), "iteration,\"force, \"\"left\"\"\"\n1,1\n");
}

proptest! {
    #[test]
    fn every_value_has_one_unique_header(
        rows in prop::collection::vec(prop::collection::vec(("[ab_]{1,2}", 0_usize..5, prop::option::of(1..1000_i32)), 0..12), 1..6),
    ) {
        let trees: Vec<Tree> = rows
            .iter()
            .map(|nodes| {
                let mut tree = tree(&[]);
                for (name, parent, value) in nodes {
                    let parent = NodeId((parent % tree.nodes().len()) as u32);
                    let measure = value.map_or(Measure::Container, |v| Measure::Value(f64::from(v), Unit::NONE));
                    tree.add(parent, Name::from(name.as_str()), Span::ZERO, measure);
                }
                tree
            })
            .collect();
        let text = csv(&trees);
        let mut reader = ::csv::Reader::from_reader(text.as_bytes());
        let headers = reader.headers().expect("a header").clone();
        prop_assert_eq!(headers.iter().collect::<HashSet<_>>().len(), headers.len());
        for (tree, record) in trees.iter().zip(reader.records()) {
            let record = record.expect("rows are as long as the header");
            let mut written: Vec<f64> =
                record.iter().skip(1).filter(|cell| !cell.is_empty()).map(|c| c.parse().expect("a number")).collect();
            let mut logged: Vec<f64> = tree.iter().filter_map(|(_, node)| node.measure.value()).collect();
            written.sort_by(f64::total_cmp);
            logged.sort_by(f64::total_cmp);
            prop_assert_eq!(written, logged);
        }
    }
}
