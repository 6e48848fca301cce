//! Tests of the columns that numbers are stored in.

use peernet_clock::Span;
use peernet_logger::{IterationValues, Measure, Name, stage};
use peernet_stream::Outcome as StreamOutcome;
use proptest::prelude::*;

use super::*;
use crate::rows::{published_columns, published_stages};
use crate::testing::{add, iteration, offloaded, timer, tree};

#[test]
fn published_columns_come_first_in_order() {
    let expected = "iteration,sensing,upload,preprocessing,inference,postprocessing,download,download-bytes,\
                    download-logger-bytes,upload-bytes,upload-logger-bytes,upload-throughput,download-throughput";
    assert_eq!(published_columns().collect::<Vec<_>>().join(","), expected);
    assert!(published_stages().eq(published_columns().skip(1).take(6)));
}

#[test]
fn values_of_nodes_and_delays_are_found_by_column() {
    let row = Row::from_iteration(&iteration(9, StreamOutcome::Ok, offloaded(17_530, 3_700)));
    let numbers = |columns: &[&str]| columns.iter().map(|column| row.value(column)).collect::<Vec<_>>();
    assert_eq!(numbers(&["sensing", "capture", "transform"]), [Some(0.0007), Some(0.0005), Some(0.00015)]);
    assert_eq!(
        numbers(&["inference", "inference_val", "inference_pre"]),
        [Some(0.0037), None, Some(0.00003)]
    );
    assert_eq!(
        numbers(&["upload", "upload-lo", "upload-hi", "upload-raw"]),
        [Some(0.01753), Some(0.01752), Some(0.01754), Some(0.02253)]
    );
    assert_eq!(
        numbers(&["upload-throughput", "upload-throughput-lo", "upload-throughput-hi"]),
        [Some(8e8), Some(4e8), Some(f64::INFINITY)]
    );
    assert_eq!(
        numbers(&["iteration", "step", "warm-up", "at"]),
        [Some(9.0), Some(8.0), Some(0.0), Some(1_795_179_293.0)]
    );
    assert_eq!(numbers(&["preprocessing", "outcome", "nothing"]), [None; 3]);
}

#[test]
fn custom_names_never_replace_fixed_columns() {
    let mut tree = tree();
    let root: &[&str] = &[];
    for name in ["outcome", "capture", "upload-throughput-lo", "upload-lo"] {
        add(&mut tree, root, name, timer(1));
    }
    add(&mut tree, root, "tool", timer(2));
    add(&mut tree, root, "tool", timer(3));
    add(&mut tree, &["tool"], "part", timer(4));
    add(&mut tree, root, "arm", Measure::Container);
    add(&mut tree, &["arm"], "sensing", timer(5));
    let row = Row::from_iteration(&iteration(1, StreamOutcome::Ok, tree));
    let names: Vec<&str> = row.values.iter().map(|(name, _)| name.as_ref()).collect();
    let expected = [
        "outcome_2",
        "capture_2",
        "upload-throughput-lo_2",
        "upload-lo_2",
        "tool_val",
        "tool_2",
        "tool_part",
        "arm_sensing",
    ];
    assert_eq!(names, expected);
}

#[test]
fn repeated_stage_is_summed() {
    let mut tree = tree();
    add(&mut tree, &[], stage::INFERENCE, Measure::Timer(Some(Span::from_seconds(2))));
    add(&mut tree, &[], stage::INFERENCE, Measure::Timer(Some(Span::from_seconds(3))));
    // Stages without a fixed column are summed, too.
    for name in [stage::BATCH_WAIT, stage::BATCH_WAIT, stage::RESTART] {
        add(&mut tree, &[], name, Measure::Timer(Some(Span::from_seconds(7))));
    }
    let row = Row::from_iteration(&iteration(1, StreamOutcome::Ok, tree));
    let expected = [("inference", 5.0), ("batch-wait", 14.0), ("restart", 7.0)];
    assert_eq!(row.values, expected.map(|(name, value)| (Column::Borrowed(name), value)));
}

#[test]
fn fixed_columns_of_nodes_have_one_value_per_iteration() {
    let is_bound = |name: &str| name.ends_with("-throughput-lo") || name.ends_with("-throughput-hi");
    for (name, kind) in FIXED_COLUMNS {
        let has_node = kind == ColumnKind::Node && !is_bound(name);
        assert_eq!(
            IterationValues::has_one_value(name),
            has_node || ["upload", "download"].contains(&name),
            "{name}"
        );
    }
}

proptest! {
    #[test]
    fn every_number_of_tree_has_unique_name(
        nodes in prop::collection::vec(("(sensing|capture|at|[ab_]{1,2}(_2)?)", 0_usize..6, 1..1000_i64), 0..14),
    ) {
        let mut tree = tree();
        for (name, parent, micros) in &nodes {
            let parent = peernet_logger::NodeId((parent % tree.nodes().len()) as u32);
            tree.add(parent, Name::from(name.as_str()), Span::ZERO, timer(*micros));
        }
        let row = Row::from_iteration(&iteration(1, StreamOutcome::Ok, tree));
        let mut names: Vec<&str> = row.values.iter().map(|(name, _)| name.as_ref()).collect();
        let sum: f64 = row.values.iter().map(|(_, value)| value * 1e6).sum();
        let logged: i64 = nodes.iter().map(|(_, _, micros)| micros).sum();
        prop_assert!((sum - logged as f64).abs() < 1e-6);
        names.sort_unstable();
        let count = names.len();
        names.dedup();
        prop_assert_eq!(names.len(), count);
    }
}
