//! Tests of both lanes from agents to readers.

use peernet_aggregator::Readiness;
use peernet_logger::{HostId, RunId, stage};
use peernet_statistics::Summary;
use peernet_store::RunFilter;
use peernet_stream::{
    ClockSample, EndReason, Event, HostClock, Iteration, OutcomeCounts, PipelineLive, PipelineState,
    RunEnded, Second,
};

use crate::testbed::Testbed;
use crate::{clocks, generate};

fn iterations(run: RunId, edge: HostId, numbers: std::ops::RangeInclusive<u64>) -> Vec<Iteration> {
    let cloud = HostId::from_bytes([7; 16]);
    let mut random = generate::Numbers::new(*numbers.start());
    numbers.map(|n| generate::iteration(run, n, (edge, cloud), &mut random)).collect()
}

fn events(iterations: &[Iteration]) -> impl Iterator<Item = Event> {
    iterations.iter().cloned().map(Event::Iteration)
}

pub(crate) fn live(run: RunId, at: i64, totals: &[f64]) -> PipelineLive {
    let mut summary = Summary::default();
    totals.iter().for_each(|total| summary.record(*total));
    PipelineLive {
        pipeline: "line".parse().expect("a name"),
        state: PipelineState::Running,
        run: Some(run),
        placement: generate::remote(),
        load: "5 Hz".into(),
        seconds: vec![Second {
            at,
            counts: OutcomeCounts { ok: totals.len() as u64, ..OutcomeCounts::default() },
            values: vec![(stage::TOTAL, summary)],
            bounds: vec![],
            verdicts: vec![],
        }],
    }
}

#[tokio::test]
async fn readers_get_what_agents_sent() {
    let mut testbed = Testbed::new().await;
    let (mut first_agent, mut second_agent) = (testbed.agent("one").await, testbed.agent("two").await);
    let runs = [RunId::random(), RunId::random()];
    let sent = [iterations(runs[0], first_agent.id, 1..=300), iterations(runs[1], second_agent.id, 1..=200)];
    for (agent, (run, sent)) in [&mut first_agent, &mut second_agent].into_iter().zip(runs.iter().zip(&sent))
    {
        agent.offer([generate::run_started(*run, "line", generate::at(0.0))]);
        agent.offer(events(sent));
        agent.offer([Event::RunEnded(RunEnded {
            run: *run,
            ended: generate::at(60.0),
            reason: EndReason::Finished,
        })]);
    }
    tokio::join!(first_agent.until_stored(), second_agent.until_stored());
    assert_eq!(
        (first_agent.accounting().stored, second_agent.accounting().stored, first_agent.accounting().dropped),
        (302, 202, 0)
    );

    let store = testbed.aggregator().store();
    let listed = store.runs(&RunFilter::default()).await.expect("answers");
    assert_eq!(listed.len(), 2);
    for summary in &listed {
        let index = runs.iter().position(|run| *run == summary.id).expect("one of the two runs");
        assert_eq!(summary.counts.ok, sent[index].len() as u64);
        assert_eq!(summary.host, [first_agent.id, second_agent.id][index]);
        assert_eq!(summary.reason, Some(EndReason::Finished));
        for iteration in sent[index].iter().step_by(37) {
            let detail = store.iteration(summary.number, iteration.number).await.expect("answers");
            assert_eq!(detail.expect("stored").tree, iteration.tree);
        }
    }
    assert_eq!(testbed.count("SELECT count(*) FROM node").await, 500 * 21);
    let snapshot = testbed.snapshot("the counts of both hosts", |snapshot| {
        snapshot.hosts.len() == 2 && snapshot.hosts.iter().map(|host| host.stored.events).sum::<u64>() == 504
    });
    assert_eq!(snapshot.await.hosts.iter().map(|host| host.stored.nodes).sum::<u64>(), 500 * 21);
    testbed.stop().await;
}

#[tokio::test]
async fn clock_samples_are_shown_and_stored() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    let cloud = HostId::random();
    let samples: Vec<_> = (1..=200).map(|second| clocks::sample(cloud, second, 40)).collect();
    let clock_events = |part: &[ClockSample]| -> Vec<Event> {
        part.iter().cloned().map(|sample| Event::Clock(Box::new(sample))).collect()
    };
    // Half of the samples are stored, the aggregator restarts, and the other half is stored. Each sample is stored
    // once.
    agent.offer(clock_events(&samples[..100]));
    agent.until_stored().await;
    testbed.stop().await;
    testbed.start().await;
    agent.offer(clock_events(&samples[100..]));
    agent.until_stored().await;
    assert_eq!(testbed.count("SELECT count(*) FROM clock_sample").await, 200);
    let store = testbed.aggregator().store();
    let links = store.links().await.expect("answers");
    assert_eq!((links.len(), links[0].edge, links[0].cloud), (1, agent.id, cloud));
    let series =
        store.clock_series(&links[0].key(), links[0].first, links[0].last, 200).await.expect("answers");
    assert_eq!((series.bucket_s, series.points.len()), (1, 200));
    for (point, sample) in series.points.iter().zip(&samples) {
        assert_eq!((point.at, &point.offset, point.up), (sample.at, &sample.offset, sample.up));
    }

    // The live lane shows the present, independently of what is stored.
    let mut sample = clocks::sample(cloud, 1, 40);
    sample.at = testbed.clock.wall();
    let clock = HostClock { text: "kernel, synchronised".into(), ..HostClock::default() };
    agent.live_with(vec![], vec![clocks::link(sample.clone())], clock.clone()).await;
    let snapshot = testbed.snapshot("the link", |snapshot| snapshot.links.len() == 1).await;
    let link = &snapshot.links[0];
    assert_eq!((link.edge, link.connected, &link.live), (agent.id, true, &clocks::link(sample.clone())));
    assert_eq!((link.history.len(), &link.history[0].offset), (1, &sample.offset));
    assert_eq!(snapshot.hosts[0].clock, clock);
    // The agent sends nothing more. After a few seconds of silence, its links count as disconnected.
    testbed
        .snapshot("the disconnected link", |snapshot| snapshot.links.iter().all(|link| !link.connected))
        .await;
    testbed.stop().await;
}

#[tokio::test]
async fn restart_loses_nothing_and_stores_nothing_twice() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    let run = RunId::random();
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    for part in 0..4_u64 {
        agent.offer(events(&iterations(run, agent.id, part * 500 + 1..=part * 500 + 500)));
        let half = agent.accounting().stored + 250;
        agent.until("half of the part is stored", |agent| agent.accounting().stored >= half).await;
        testbed.stop().await;
        testbed.start().await;
    }
    agent.until_stored().await;
    assert_eq!(agent.accounting().stored, 2_001);
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 2_000);
    assert_eq!(testbed.count("SELECT count(*) FROM node").await, 2_000 * 21);
    assert_eq!(testbed.count("SELECT ok FROM run").await, 2_000);
    assert_eq!(testbed.count("SELECT count(*) FROM gap").await, 0);
    let stages = testbed.aggregator().store().statistics_of(1).await.expect("answers").stages;
    let total = stages.iter().find(|stage_statistics| stage_statistics.stage == "total").expect("measured");
    assert_eq!(total.statistics.count, 2_000);
    testbed.stop().await;
}

#[tokio::test]
async fn nothing_is_acknowledged_before_commit_while_live_state_updates() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    testbed.snapshot("the host", |snapshot| snapshot.hosts.len() == 1).await;
    // The hello is stored before the database is locked.
    let run = RunId::random();
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    agent.until_stored().await;

    let mut other = testbed.connection().await;
    sqlx::raw_sql("BEGIN EXCLUSIVE").execute(&mut other).await.expect("locks");
    agent.offer(events(&iterations(run, agent.id, 1..=100)));
    agent.until("storing fails", |_| testbed.aggregator().current_readiness() != Readiness::Ready).await;
    let Readiness::NotStoring(reason) = testbed.aggregator().current_readiness() else {
        panic!("not storing")
    };
    assert!(reason.contains("locked"), "{reason}");
    assert_eq!((agent.accounting().stored, agent.accounting().waiting), (1, 100));

    let second = testbed.clock.wall().unix_seconds();
    agent.live(vec![live(run, second, &[0.020; 7])]).await;
    let snapshot = testbed.snapshot("the second", |snapshot| {
        snapshot.pipelines.first().is_some_and(|pipeline| pipeline.windows[2].counts.ok == 7)
    });
    let snapshot = snapshot.await;
    assert_eq!((snapshot.pipelines[0].run_number, snapshot.hosts[0].accounting.waiting), (Some(1), 100));
    assert!(snapshot.hosts[0].behind.is_some());

    sqlx::raw_sql("ROLLBACK").execute(&mut other).await.expect("unlocks");
    agent.until_stored().await;
    assert_eq!(testbed.aggregator().current_readiness(), Readiness::Ready);
    assert_eq!(testbed.count("SELECT count(*) FROM iteration").await, 100);
    testbed.stop().await;
}

#[tokio::test]
async fn admitted_batches_are_stored_and_acknowledged_at_stop() {
    let mut testbed = Testbed::new().await;
    let mut agent = testbed.agent("edge").await;
    agent.until_up().await;
    let run = RunId::random();
    agent.offer([generate::run_started(run, "line", generate::at(0.0))]);
    agent.offer(events(&iterations(run, agent.id, 1..=400)));
    agent.until("some events are stored", |agent| agent.accounting().stored > 0).await;
    testbed.stop().await;
    let stored = testbed.count("SELECT ok FROM run").await as u64 + 1;
    agent.until("all acknowledgements have arrived", |agent| agent.accounting().stored >= stored).await;
    assert_eq!(agent.accounting().stored, stored);
}
