//! Tests of hosts that report on the runs of another host.

use std::sync::Arc;

use peernet_clock::{ClockIdentity, SystemClock};
use peernet_logger::{HostId, Recorder, RunId};
use peernet_stream::{
    Accounting, ClockSample, Event, Gap, HostClock, HostMetrics, Incident, IncidentKind, Iteration,
    LiveUpdate, NetworkName, Outcome, PipelineLive, PipelineState, Placement, ProbeCounts, RunDescription,
    RunEnded, ToAggregator,
};
use peernet_tests::truth::query_database;
use peernet_tests::{
    Fleet, InventedHost, MisbehavingPeer, StoredEvents, TestRng, record_measurements, wait_until, wall,
};

use super::start_fleet;

// The text "taken" and the count 123,456 are easy to recognise in stored data and answers.

fn run_started(run: RunId) -> Event {
    Event::RunStarted(RunDescription {
        run,
        pipeline: "taken".parse().expect("a name"),
        started: wall(),
        placement: Placement::sensor_alone(),
        facts: vec![],
        configuration: "taken".into(),
        version: "0".into(),
        experiment: None,
        conditions: vec![],
    })
}

fn gap(run: RunId) -> Event {
    let (from, to, count, reason) = (wall(), wall(), 123_456, "taken".to_owned());
    Event::Gap(Gap { pipeline: "loop".parse().ok(), run: Some(run), from, to, count, reason })
}

fn incident(run: RunId, peer: HostId) -> Event {
    Event::Incident(Incident {
        at: wall(),
        kind: IncidentKind::PipelineFailed,
        pipeline: "loop".parse().ok(),
        run: Some(run),
        peer: Some(peer),
        text: "taken".into(),
    })
}

fn iteration(run: RunId, number: u64, host: HostId) -> Event {
    let clock = Arc::new(SystemClock::new(ClockIdentity::new("boot", "test")));
    let tree = Recorder::new(clock, host).finish();
    Event::Iteration(Iteration {
        run,
        number,
        episode: 0,
        step: 0,
        warm_up: false,
        outcome: Outcome::Ok,
        tree,
    })
}

fn clock(peer: HostId) -> Event {
    Event::Clock(Box::new(ClockSample {
        peer,
        peer_name: "edge".parse().expect("a name"),
        at: wall(),
        relation_period: 1,
        max_drift_ppm: 1.0,
        upper: None,
        lower: None,
        offset: None,
        probes: ProbeCounts::default(),
        exchanges: peernet_clock::ExchangeCounts::default(),
        round_trip: None,
        up: None,
        down: None,
        network: NetworkName::default(),
        basis: None,
    }))
}

#[test]
fn foreign_reports_leave_run_unchanged() {
    let mut rng = TestRng::new("foreign reports");
    let mut fleet = start_fleet("");
    let row = query_database(
        fleet.database(),
        "SELECT run.uuid || ' ' || host.uuid FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host",
    );
    let (run, robot) = row.trim().split_once(' ').expect("one run");
    let (run, robot): (RunId, HostId) = (run.parse().expect("an id"), robot.parse().expect("an id"));
    let gaps_of_run = |fleet: &Fleet| fleet.api.json("/api/v1/runs/1")["gaps"].clone();
    let before = (gaps_of_run(&fleet), fleet.api.json("/api/v1/runs/1")["reason"].clone());

    let misbehaving_peer = MisbehavingPeer::connect(fleet.deployment.events_port);
    let mut host = InventedHost::new("stranger", &mut rng);
    host.open_session(&misbehaving_peer);
    let own_id = host.hello.host.id;
    // Each kind of event is sent alone, then two of them in one batch. Afterwards the robot sends real events.
    let events = [
        gap(run),
        incident(run, robot),
        iteration(run, 7, own_id),
        Event::RunEnded(RunEnded { run, ended: wall(), reason: "taken".into() }),
        run_started(run),
        clock(robot),
    ];
    let mut batches = 0;
    for event in &events {
        let batch = host.batch_with(std::slice::from_ref(event));
        misbehaving_peer.send(&batch);
        batches += 1;
        misbehaving_peer.wait_for_ack(batches);
    }
    let batch = host.batch_with(&events[..2]);
    misbehaving_peer.send(&batch);
    misbehaving_peer.wait_for_ack(batches + 1);
    // An event that claims to be the robot's own is quarantined.
    let forged = host.batch_with(&[iteration(run, 8, robot)]);
    misbehaving_peer.send(&forged);
    misbehaving_peer.wait_for_ack(batches + 2);

    assert_eq!((gaps_of_run(&fleet), fleet.api.json("/api/v1/runs/1")["reason"].clone()), before);
    let trust = fleet.api.json("/api/v1/runs/1/trust").to_string();
    assert!(!trust.contains("123,456") && !trust.contains("never reached the store"), "{trust}");
    let incidents = fleet.api.json("/api/v1/incidents");
    let incidents = incidents["incidents"].as_array().expect("a list").clone();
    let from_stranger: Vec<_> = incidents.iter().filter(|incident| incident["host"] == "stranger").collect();
    assert!(
        incidents.iter().any(|incident| incident.to_string().contains("belong to other hosts")),
        "{incidents:?}"
    );
    assert!(from_stranger.iter().any(|incident| incident["text"] == "taken"), "{incidents:?}");
    assert!(from_stranger.iter().all(|incident| incident["run"] != 1), "{incidents:?}");

    let before = fleet.wait_for_counts(0, "the agent reports", |_| true);
    fleet.wait_for_counts(0, "more events of the robot are stored", |counts| {
        counts.stored > before.stored + 20
    });
    fleet.agents[0].stop();
    fleet.deliver_spool(0).assert_balanced();
    let mut stored_events = stop(&mut fleet);
    let stranger = stored_events.hosts.remove("stranger").expect("stored");
    assert_eq!((stranger.quarantined, stored_events.hosts["edge"].gaps), (1, 0));
    let stored = &stored_events.runs[&run.to_string()];
    assert_eq!(
        (stored.host.as_str(), stored.pipeline.as_str(), stored.reason.as_str()),
        ("edge", "loop", "stopped")
    );
    assert!(stored.is_contiguous() && stored.missing == 0, "{stored:?}");
    record_measurements(
        "foreign reports",
        &[("kinds of events", events.len().to_string()), ("kinds that changed the run", "0".into())],
    );
}

#[test]
fn hosts_with_same_run_id_have_separate_runs() {
    let mut rng = TestRng::new("claimed runs");
    let mut fleet = Fleet::new(&[], "");
    let (first_peer, second_peer) = (
        MisbehavingPeer::connect(fleet.deployment.events_port),
        MisbehavingPeer::connect(fleet.deployment.events_port),
    );
    let (mut thief, mut robot) = (InventedHost::new("thief", &mut rng), InventedHost::new("robot", &mut rng));
    let run = RunId::random();
    thief.open_session(&first_peer);
    first_peer.send(&thief.batch_with(&[gap(run), run_started(run), iteration(run, 1, thief.hello.host.id)]));
    first_peer.wait_for_ack(1);
    robot.open_session(&second_peer);
    let own_id = robot.hello.host.id;
    second_peer.send(&robot.batch_with(&[
        run_started(run),
        iteration(run, 1, own_id),
        iteration(run, 2, own_id),
    ]));
    second_peer.wait_for_ack(1);
    first_peer.send(&thief.batch_with(&[Event::RunEnded(RunEnded {
        run,
        ended: wall(),
        reason: "taken".into(),
    })]));
    first_peer.wait_for_ack(2);

    // The live lane of each host shows its own run.
    for (misbehaving_peer, host) in [(&first_peer, &thief), (&second_peer, &robot)] {
        misbehaving_peer.send_message(&ToAggregator::Live(LiveUpdate {
            host: host.hello.host.id,
            sent: wall(),
            pipelines: vec![PipelineLive {
                pipeline: "taken".parse().expect("a name"),
                state: PipelineState::Running,
                run: Some(run),
                placement: Placement::sensor_alone(),
                load: "closed".into(),
                seconds: vec![],
            }],
            links: vec![],
            clock: HostClock::default(),
            metrics: HostMetrics::default(),
            accounting: Accounting::default(),
        }));
    }
    let numbers = wait_until("both pipelines", || {
        let list = fleet.api.json("/api/v1/pipelines");
        let numbers: Vec<i64> =
            list["pipelines"].as_array()?.iter().filter_map(|pipeline| pipeline["run"].as_i64()).collect();
        (numbers.len() == 2).then_some(numbers)
    });
    assert_ne!(numbers[0], numbers[1]);

    let stored_events = stop(&mut fleet);
    let runs_of = |host: &str| stored_events.runs.values().filter(|run| run.host == host).collect::<Vec<_>>();
    let (thief, robot) = (runs_of("thief"), runs_of("robot"));
    assert_eq!((thief.len(), robot.len()), (1, 1), "{stored_events:?}");
    assert_eq!((robot[0].ranges.as_slice(), robot[0].missing), (&[1..=2][..], 0));
    assert_ne!(robot[0].reason, "taken");
    assert!(stored_events.hosts.values().all(|host| host.quarantined == 0), "{stored_events:?}");
}

/// Stops all running processes and reads the stored data, without a check of its consistency: iterations of invented
/// hosts have no totals, so roll-ups differ from counters.
fn stop(fleet: &mut Fleet) -> StoredEvents {
    for agent in fleet.agents.iter_mut().filter(|agent| agent.is_running()) {
        agent.stop();
    }
    fleet.aggregator.stop();
    StoredEvents::read(fleet.database())
}
