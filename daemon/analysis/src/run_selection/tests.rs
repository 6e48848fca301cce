//! Tests of which runs count, if there are repeats, several edges, or copies.

use super::*;

fn run(repeat: u32, edge: HostId, state: RunState, sequence: i64) -> Candidate {
    let position = ExperimentPosition {
        name: "x".to_owned(),
        id: "x1".to_owned(),
        configuration: Vec::new(),
        repeat,
        ..ExperimentPosition::default()
    };
    Candidate {
        id: Some(RunId::random()),
        state: Some(state),
        repeat: Some(Repeat::new(&position, edge, "line")),
        edges: None,
        times: Some([sequence, sequence + 1].map(WallTime::from_unix_nanos).into()),
        sequence,
        is_named: false,
        rank: 0,
    }
}

#[test]
fn finished_repeat_counts_once_per_edge() {
    let (edge, other) = (HostId::random(), HostId::random());
    let runs = [
        run(0, edge, RunState::Finished, 1),
        run(1, edge, RunState::Interrupted, 2),
        run(1, edge, RunState::Finished, 3),
        run(0, other, RunState::Finished, 4),
        run(0, edge, RunState::Finished, 5),
        run(2, edge, RunState::Open, 6),
    ];
    let unfinished = |state| Some(Exclusion::Unfinished(state));
    let expected = [
        Some(Exclusion::MeasuredAgain(4)),
        unfinished(RunState::Interrupted),
        None,
        None,
        None,
        unfinished(RunState::Open),
    ];
    assert_eq!(exclusions(&runs), expected);
}

#[test]
fn edge_beside_failed_edge_does_not_count() {
    let (edge, other) = (HostId::random(), HostId::random());
    let failed = RunState::Failed(None);
    let mut runs = [
        run(0, edge, RunState::Finished, 10),
        run(0, other, failed.clone(), 11),
        // Both edges measured the repeat again.
        run(0, edge, RunState::Finished, 20),
        run(0, other, RunState::Finished, 21),
        run(1, edge, RunState::Finished, 11),
    ];
    let unfinished = Some(Exclusion::Unfinished(failed));
    let other_unfinished = Some(Exclusion::ConcurrentRunUnfinished(1));
    assert_eq!(exclusions(&runs), [other_unfinished, unfinished.clone(), None, None, None]);
    runs[0].is_named = true;
    assert_eq!(exclusions(&runs), [None, unfinished, None, None, None]);
}

#[test]
fn repeat_without_run_of_edge_does_not_count() {
    let (edge, other) = (HostId::random(), HostId::random());
    let run_with_two_edges =
        |repeat, edge, state, sequence| Candidate { edges: Some(2), ..run(repeat, edge, state, sequence) };
    let alone = run_with_two_edges(0, edge, RunState::Finished, 10);
    let missing = Some(Exclusion::EdgeMissing { measured: 1, edges: 2 });
    let copy = alone.clone();
    let second_pipeline = Candidate {
        id: Some(RunId::random()),
        repeat: alone.repeat.clone().map(|repeat| Repeat { pipeline: "second".to_owned(), ..repeat }),
        ..alone.clone()
    };
    let of_another_repeat = run_with_two_edges(1, other, RunState::Finished, 10);
    let runs = [alone.clone(), copy, second_pipeline, of_another_repeat];
    assert_eq!(exclusions(&runs), vec![missing.clone(); 4]);
    // The failed edge of an earlier attempt is not the missing edge.
    let failed = run_with_two_edges(0, other, RunState::Failed(None), 1);
    let unfinished = Some(Exclusion::Unfinished(RunState::Failed(None)));
    assert_eq!(exclusions(&[failed, alone.clone()]), [unfinished, missing]);
    let together = run_with_two_edges(0, other, RunState::Finished, 20);
    assert_eq!(
        exclusions(&[alone.clone(), together]),
        [None, None],
        "runs with few iterations need not overlap in time"
    );
    assert_eq!(exclusions(&[Candidate { is_named: true, ..alone.clone() }]), [None]);
    assert_eq!(
        exclusions(&[Candidate { edges: None, ..alone }]),
        [None],
        "earlier versions record no number"
    );
}

#[test]
fn named_run_counts_in_any_state() {
    let edge = HostId::random();
    let mut runs = [
        run(0, edge, RunState::Failed(None), 1),
        run(1, edge, RunState::Finished, 2),
        run(1, edge, RunState::Finished, 3),
    ];
    runs.iter_mut().take(2).for_each(|run| run.is_named = true);
    assert_eq!(exclusions(&runs), [None, None, None]);
}

#[test]
fn only_one_of_several_copies_counts() {
    let first = run(0, HostId::random(), RunState::Finished, 1);
    let runs = [Candidate { rank: 1, ..first.clone() }, first.clone(), first.clone()];
    let copy = Some(Exclusion::CopyOf(1));
    assert_eq!(exclusions(&runs), [copy.clone(), None, copy]);
    let named = [Candidate { is_named: true, rank: 1, ..first.clone() }, first.clone()];
    assert_eq!(exclusions(&named), [Some(Exclusion::CopyOf(1)), None], "the rank decides");
    let unknown = Candidate { id: None, repeat: None, state: None, ..first };
    assert_eq!(
        exclusions(&[unknown.clone(), unknown]),
        [None, None],
        "results without an id are not known to be copies"
    );
}
