//! Test of a full spool.

use std::num::NonZeroU64;

use peernet_logger::Slug;
use peernet_stream::Gap;

use super::{address_without_aggregator, pipeline, state};
use crate::harness::{Aggregator, TestAgent};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn newest_events_are_dropped_counted_and_replaced_by_gap() {
    let (address, received_events) = address_without_aggregator().await;
    let mut config = pipeline("load = { mode = 'rate', hz = 2000.0 }\nmax_in_flight = 64");
    config.spool.limit_bytes = NonZeroU64::new(100_000).expect("not zero");
    let agent = TestAgent::start_in(state(), &address, config).await;
    let full = agent.until(|live| live.accounting.dropped > 1000).await.accounting;
    assert!(full.spool_bytes <= full.spool_limit_bytes, "{full:?}");
    assert_eq!((full.spool_limit_bytes, full.trouble), (100_000, None));

    let aggregator = Aggregator::restart((address, received_events)).await;
    let received_events = aggregator.until(|received_events| !received_events.gaps().is_empty()).await;
    let before = received_events.iterations().len();
    aggregator.until(|received_events| received_events.iterations().len() > before + 100).await;
    let state = agent.stop_and_keep().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let run = received_events.run_starts()[0].run;
    let all_missing: u64 = received_events.gaps().iter().map(|gap| gap.count).sum();
    let of_run = |gap: &&&Gap| gap.run == Some(run);
    let missing: u64 = received_events.gaps().iter().filter(of_run).map(|gap| gap.count).sum();
    let numbers: Vec<u64> = received_events.iterations().iter().map(|iteration| iteration.number).collect();
    let newest = received_events.iterations().into_iter().max_by_key(|iteration| iteration.number);
    let newest = newest.expect("iterations were stored");
    // The spool may be full again when the agent stops. Then gaps count iterations after the newest stored iteration.
    let began = newest.tree.wall_start(&newest.tree.nodes()[0]).expect("the root has a start");
    let after_newest = |gap: &&&Gap| of_run(gap) && gap.from > began;
    let later: u64 = received_events.gaps().iter().filter(after_newest).map(|gap| gap.count).sum();
    assert_eq!(
        numbers.len() as u64 + missing,
        newest.number + later,
        "each iteration is stored or counted in a gap"
    );
    for gap in received_events.gaps().iter().filter(of_run) {
        assert_eq!(gap.pipeline.as_ref().map(Slug::as_str), Some("line"));
        assert!(gap.from <= gap.to && !gap.reason.is_empty());
    }

    // The counts are kept over a restart.
    let agent =
        TestAgent::start_in(state, &aggregator.address, pipeline("limit = { iterations = 50 }")).await;
    let received_events = aggregator.until(|received_events| received_events.run_ends().len() == 2).await;
    let second_run = received_events.run_ends()[1].run;
    assert_eq!(
        received_events.iterations().iter().filter(|iteration| iteration.run == second_run).count(),
        50
    );
    let account = agent.until(|live| live.accounting.waiting == 0).await.accounting;
    assert_eq!((account.dropped, account.gaps), (all_missing, received_events.gaps().len() as u64));
    assert_eq!(account.produced, account.stored + account.dropped);
    agent.stop().await.expect("stops well");
}
