//! Reports of hosts on the runs of others, and the hosts' secrets.

use peernet_stream::{Gap, HostSecret, Incident, IncidentKind, RunEnded};

use super::*;
use crate::maintenance::{ClearSecretError, clear_host_secret};
use crate::write::known_hosts;

fn gap(run: RunId) -> Event {
    let (from, to, count, reason) = (NOW, NOW, 123_456, "taken".to_owned());
    Event::Gap(Gap { pipeline: None, run: Some(run), from, to, count, reason })
}

fn incident(run: RunId) -> Event {
    let (kind, text) = (IncidentKind::PipelineFailed, "taken".into());
    Event::Incident(Incident { at: NOW, kind, pipeline: None, run: Some(run), peer: None, text })
}

fn ended(run: RunId) -> Event {
    Event::RunEnded(RunEnded { run, ended: NOW, reason: "taken".into() })
}

/// Continues as the other host, in another stream.
fn as_other(bed: &mut Bed) {
    (bed.edge, bed.cloud) = (bed.cloud, bed.edge);
    (bed.stream, bed.next) = (StreamId::random(), 1);
}

#[tokio::test]
async fn foreign_events_do_not_change_run() {
    let mut bed = Bed::new().await;
    let run = bed.run_of(3).await;
    let victim = "SELECT count(*) FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
                  WHERE run.number = 1 AND host.name = 'edge' AND pipeline.name = 'line' AND run.ok = 3 \
                  AND run.end_reason IS NULL";
    as_other(&mut bed);
    let iteration = generate::iteration(run, 9, bed.hosts(), &mut generate::Numbers::new(1));
    let start = generate::run_started(run, "taken", NOW);
    for event in [gap(run), incident(run), Event::Iteration(iteration), ended(run), start] {
        let work = bed.batch(vec![event]);
        assert!(bed.commit(&[work]).await.quarantined.is_empty());
        assert_eq!(bed.count(victim).await, 1);
    }
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE run = 1").await, 0);
    assert_eq!(bed.count("SELECT count(*) FROM incident WHERE run = 1").await, 0);
    let incidents_query = "SELECT count(*) FROM incident JOIN host ON host.id = incident.host \
                WHERE host.name = 'cloud' AND incident.kind = 'refused'";
    assert_eq!(bed.count(incidents_query).await, 1, "once for each run");
    let own = "SELECT count(*) FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
               WHERE host.name = 'cloud' AND run.ok = 1 AND run.end_reason = 'taken' AND run.reported_uuid IS NOT NULL";
    assert_eq!(bed.count(own).await, 1);
}

#[tokio::test]
async fn run_claimed_by_another_host_is_stored_for_its_owner() {
    let mut bed = Bed::new().await;
    let run = RunId::random();
    as_other(&mut bed);
    let (gap, claim) = (bed.batch(vec![gap(run)]), bed.batch(vec![ended(run)]));
    bed.commit(&[gap, claim]).await;
    as_other(&mut bed);
    let start = bed.batch(vec![generate::run_started(run, "line", NOW)]);
    let mut numbers = generate::Numbers::new(1);
    let iterations =
        (1..=5).map(|n| Event::Iteration(generate::iteration(run, n, bed.hosts(), &mut numbers)));
    let iterations = bed.batch(iterations.collect());
    let committed = bed.commit(&[start, iterations]).await;
    assert!(committed.quarantined.is_empty());
    assert_eq!(committed.runs, [(bed.edge, run, 2)]);
    assert_eq!(bed.count("SELECT ok FROM run WHERE number = 2").await, 5);
    assert_eq!(bed.count("SELECT count(*) FROM gap WHERE run IS NOT NULL").await, 0);
    // Another writer finds it again, and its iterations are known when they arrive again.
    bed.writer = open(&bed.path).await;
    bed.stream = StreamId::random();
    bed.next = 1;
    let mut numbers = generate::Numbers::new(1);
    let again = (4..=6).map(|n| Event::Iteration(generate::iteration(run, n, bed.hosts(), &mut numbers)));
    let again = bed.batch(again.collect());
    assert!(bed.commit(&[again]).await.quarantined.is_empty());
    assert_eq!(bed.count("SELECT ok FROM run WHERE number = 2").await, 6);
    assert_eq!(bed.count("SELECT count(*) FROM run").await, 2);
}

#[tokio::test]
async fn secret_is_stored_once_and_cleared_by_another_connection() {
    let mut bed = Bed::new().await;
    let run = RunId::random();
    let work = bed.batch(vec![generate::run_started(run, "line", NOW)]);
    bed.commit(&[work]).await;
    let (first, second) = (HostSecret::random(), HostSecret::random());
    for secret in [&first, &second] {
        let Work::Hello(mut greeting) = hello(generate::host(bed.edge, "edge"), 1) else {
            panic!("a greeting")
        };
        greeting.secret = Some(secret.clone());
        bed.commit(&[Work::Hello(greeting)]).await;
    }
    let mut connection = bed.other().await;
    let known = known_hosts(&mut connection).await.expect("reads");
    assert_eq!(known, [(bed.edge, Some(first.clone()))], "a host of which nothing is stored is not known");
    assert_eq!(bed.commit(&[Work::Secret(bed.edge)]).await.secrets, [(bed.edge, Some(first))]);

    let cleared = clear_host_secret(&bed.path, "edge").await.expect("clears");
    assert!(cleared.existed && cleared.host == bed.edge.to_string());
    assert_eq!(bed.commit(&[Work::Secret(bed.edge)]).await.secrets, [(bed.edge, None)]);
    let again = clear_host_secret(&bed.path, &bed.edge.to_string()).await.expect("clears");
    assert!(!again.existed);
    let unknown = clear_host_secret(&bed.path, "nobody").await;
    assert!(matches!(unknown, Err(ClearSecretError::NoHost { .. })), "{unknown:?}");
}

#[tokio::test]
async fn hosts_named_only_by_others_are_unknown() {
    let mut bed = Bed::new().await;
    // Agents that serve an experiment do not report to this aggregator: only iterations name them.
    for seed in 1..=5 {
        let (run, cloud) = (RunId::random(), HostId::random());
        let mut numbers = generate::Numbers::new(seed);
        let start = generate::run_started(run, "line", NOW);
        let iteration = generate::iteration(run, 1, (bed.edge, cloud), &mut numbers);
        let work = bed.batch(vec![start, Event::Iteration(iteration)]);
        assert!(bed.commit(&[work]).await.quarantined.is_empty());
    }
    assert_eq!(bed.count("SELECT count(*) FROM host WHERE name IS NULL").await, 5);
    let known = known_hosts(&mut bed.other().await).await.expect("reads");
    let known: Vec<HostId> = known.into_iter().map(|(host, _)| host).collect();
    assert_eq!(known, [bed.edge], "only known hosts count against max_hosts");
}
