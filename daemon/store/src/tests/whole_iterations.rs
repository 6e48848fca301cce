//! Reading of whole iterations, exactly as agents sent them.

use peernet_clock::Span;
use peernet_logger::{HostId, Measure, NodeId, RunId};
use peernet_stream::{Event, Iteration, Outcome};

use super::{TestStore, generate};
use crate::types::RunSummary;

async fn run(test_store: &TestStore) -> RunSummary {
    test_store.store.run(1).await.expect("answers").expect("exists").summary
}

/// Stores a run of `iterations` iterations, then a lost iteration and an iteration with an additional node. Returns all
/// these iterations.
async fn store_iterations(test_store: &mut TestStore, iterations: u64) -> Vec<Iteration> {
    let run = test_store.store_run(iterations).await;
    // `store_run` uses the same seed, so the iterations up to `iterations` are those that it stored.
    let mut numbers = generate::Numbers::new(7);
    let mut iteration = |number| generate::iteration(run, number, test_store.hosts(), &mut numbers);
    let mut sent_iterations: Vec<Iteration> = (1..=iterations).map(&mut iteration).collect();
    let lost = Outcome::Lost("the cable".to_owned());
    sent_iterations.push(Iteration { outcome: lost, warm_up: true, episode: 2, ..iteration(iterations + 1) });
    let mut with_extra_node = iteration(iterations + 3);
    with_extra_node.tree.add(
        NodeId(1),
        "debayer".into(),
        Span::ZERO,
        Measure::Timer(Some(Span::from_micros(70))),
    );
    sent_iterations.push(with_extra_node);
    let last = sent_iterations[iterations as usize..].iter().cloned().map(Event::Iteration).collect();
    let work = test_store.batch(last);
    test_store.commit(&[work]).await;
    sent_iterations
}

#[tokio::test]
async fn whole_iterations_are_read_as_sent() {
    let mut test_store = TestStore::new().await;
    let sent = store_iterations(&mut test_store, 450).await;
    let (run, mut read, mut after_number, mut pages) = (run(&test_store).await, Vec::new(), 0, 0);
    while let Some((last, page)) =
        test_store.store.full_iterations(&run, after_number).await.expect("answers")
    {
        read.extend(page);
        (after_number, pages) = (last, pages + 1);
    }
    assert!(read == sent, "{:?}", read.iter().zip(&sent).find(|(read, sent)| read != sent));
    assert_eq!((pages, after_number), (3, 453));
}

#[tokio::test]
async fn each_tree_shape_is_returned_once_per_page() {
    let mut test_store = TestStore::new().await;
    let sent = store_iterations(&mut test_store, 40).await;
    let run = run(&test_store).await;
    let (last, first_of_each_shape) =
        test_store.store.iterations_by_shape(&run, 0).await.expect("answers").expect("there are some");
    assert_eq!((last, first_of_each_shape), (43, vec![sent[0].clone(), sent[41].clone()]));
    assert_eq!(test_store.store.iterations_by_shape(&run, 43).await.expect("answers"), None);
    assert_eq!(test_store.store.full_iterations(&run, 43).await.expect("answers"), None);
}

#[tokio::test]
async fn page_of_many_shapes_is_returned_in_parts() {
    let mut test_store = TestStore::new().await;
    let stored_run = test_store.store_run(1).await;
    let mut numbers = generate::Numbers::new(7);
    // Each iteration has a node that no other iteration has.
    let iterations: Vec<Event> = (2..=451)
        .map(|number| {
            let mut iteration = generate::iteration(stored_run, number, test_store.hosts(), &mut numbers);
            let name = format!("step-{number}");
            iteration.tree.add(NodeId(1), name.into(), Span::ZERO, Measure::Timer(Some(Span::ZERO)));
            Event::Iteration(iteration)
        })
        .collect();
    let work: Vec<_> = iterations.chunks(50).map(|events| test_store.batch(events.to_vec())).collect();
    test_store.commit(&work).await;
    let (run, mut returned, mut after_number, mut sizes) =
        (run(&test_store).await, Vec::new(), 0, Vec::new());
    while let Some((last, first_of_each_shape)) =
        test_store.store.iterations_by_shape(&run, after_number).await.expect("answers")
    {
        sizes.push(first_of_each_shape.len());
        returned.extend(first_of_each_shape.into_iter().map(|iteration| iteration.number));
        after_number = last;
    }
    assert_eq!(sizes, [200, 200, 51]);
    assert!(returned.into_iter().eq(1..=451));
}

/// A server that the paper's commands start connects to no aggregator. Pages show the name that the edge gives it.
#[tokio::test]
async fn unintroduced_server_has_name_given_by_run() {
    let mut test_store = TestStore::new().await;
    let (run, server) = (RunId::random(), HostId::random());
    let mut numbers = generate::Numbers::new(5);
    let iteration = generate::iteration(run, 1, (test_store.edge, server), &mut numbers);
    let started = generate::run_started(run, "line", generate::at(0.0));
    let work = test_store.batch(vec![started, Event::Iteration(iteration)]);
    test_store.commit(&[work]).await;
    let detail = test_store.store.iteration(1, 1).await.expect("answers").expect("exists");
    let names: Vec<Option<String>> =
        detail.hosts.iter().map(|host| host.as_ref().map(ToString::to_string)).collect();
    assert_eq!(names, [Some("edge".to_owned()), Some("cloud".to_owned())]);
    assert_eq!(detail.tree.anchors()[1].host, server);
}
