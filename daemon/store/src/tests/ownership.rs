//! Events of a host about the runs of another host, and the secrets of hosts.

use peernet_stream::{Gap, HostSecret, Incident, IncidentKind, RunEnded};

use super::*;
use crate::maintenance::{ClearSecretError, clear_host_secret};
use crate::write::{read_host_counts, read_host_secrets};

fn gap(run: RunId) -> Event {
    let (from, to, count, reason) = (NOW, NOW, 123_456, "foreign".to_owned());
    Event::Gap(Gap { pipeline: None, run: Some(run), from, to, count, reason })
}

fn incident(run: RunId) -> Event {
    let (kind, text) = (IncidentKind::PipelineFailed, "foreign".into());
    Event::Incident(Incident { at: NOW, kind, pipeline: None, run: Some(run), peer: None, text })
}

fn ended(run: RunId) -> Event {
    Event::RunEnded(RunEnded { run, ended: NOW, reason: "foreign".into() })
}

/// Continues as the other host, in another stream.
fn continue_as_other_host(test_store: &mut TestStore) {
    (test_store.edge, test_store.cloud) = (test_store.cloud, test_store.edge);
    (test_store.stream, test_store.next_number) = (StreamId::random(), 1);
}

#[tokio::test]
async fn foreign_events_do_not_change_run() {
    let mut test_store = TestStore::new().await;
    let run = test_store.store_run(3).await;
    let unchanged_run_query = "SELECT count(*) FROM run JOIN pipeline ON pipeline.id = run.pipeline JOIN host ON host.id = pipeline.host \
                  WHERE run.number = 1 AND host.name = 'edge' AND pipeline.name = 'line' AND run.ok = 3 \
                  AND run.end_reason IS NULL";
    continue_as_other_host(&mut test_store);
    let iteration = generate::iteration(run, 9, test_store.hosts(), &mut generate::Numbers::new(1));
    let start = generate::run_started(run, "foreign", NOW);
    for event in [gap(run), incident(run), Event::Iteration(iteration), ended(run), start] {
        let work = test_store.batch(vec![event]);
        assert!(test_store.commit(&[work]).await.quarantined.is_empty());
        assert_eq!(test_store.count(unchanged_run_query).await, 1);
    }
    assert_eq!(test_store.count("SELECT count(*) FROM gap WHERE run = 1").await, 0);
    assert_eq!(test_store.count("SELECT count(*) FROM incident WHERE run = 1").await, 0);
    let incidents_query = "SELECT count(*) FROM incident JOIN host ON host.id = incident.host \
                WHERE host.name = 'cloud' AND incident.kind = 'refused'";
    assert_eq!(test_store.count(incidents_query).await, 1, "one incident for each run");
    // The iteration and the end belong to a run of the host that sent them.
    let run_of_other_host_query = "SELECT count(*) FROM run JOIN pipeline ON pipeline.id = run.pipeline \
               JOIN host ON host.id = pipeline.host WHERE host.name = 'cloud' AND run.ok = 1 \
               AND run.end_reason = 'foreign' AND run.reported_uuid IS NOT NULL";
    assert_eq!(test_store.count(run_of_other_host_query).await, 1);
}

#[tokio::test]
async fn run_claimed_by_other_host_is_stored_for_owner() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    continue_as_other_host(&mut test_store);
    let (gap, claim) = (test_store.batch(vec![gap(run)]), test_store.batch(vec![ended(run)]));
    test_store.commit(&[gap, claim]).await;
    continue_as_other_host(&mut test_store);
    let start = test_store.batch(vec![generate::run_started(run, "line", NOW)]);
    let mut numbers = generate::Numbers::new(1);
    let iterations =
        (1..=5).map(|n| Event::Iteration(generate::iteration(run, n, test_store.hosts(), &mut numbers)));
    let iterations = test_store.batch(iterations.collect());
    let committed = test_store.commit(&[start, iterations]).await;
    assert!(committed.quarantined.is_empty());
    assert_eq!(committed.runs, [(test_store.edge, run, 2)]);
    assert_eq!(test_store.count("SELECT ok FROM run WHERE number = 2").await, 5);
    assert_eq!(test_store.count("SELECT count(*) FROM gap WHERE run IS NOT NULL").await, 0);
    // A new writer reads the run from the database. It does not store iterations twice that arrive again.
    test_store.writer = open(&test_store.path).await;
    test_store.stream = StreamId::random();
    test_store.next_number = 1;
    let mut numbers = generate::Numbers::new(1);
    let repeated =
        (4..=6).map(|n| Event::Iteration(generate::iteration(run, n, test_store.hosts(), &mut numbers)));
    let repeated = test_store.batch(repeated.collect());
    assert!(test_store.commit(&[repeated]).await.quarantined.is_empty());
    assert_eq!(test_store.count("SELECT ok FROM run WHERE number = 2").await, 6);
    assert_eq!(test_store.count("SELECT count(*) FROM run").await, 2);
}

#[tokio::test]
async fn secret_is_stored_once_and_cleared_by_another_connection() {
    let mut test_store = TestStore::new().await;
    let run = RunId::random();
    let work = test_store.batch(vec![generate::run_started(run, "line", NOW)]);
    test_store.commit(&[work]).await;
    let (first, second) = (HostSecret::random(), HostSecret::random());
    for secret in [&first, &second] {
        let Work::Hello(mut introduction) = hello(generate::host(test_store.edge, "edge"), 1) else {
            panic!("an introduction")
        };
        introduction.secret = Some(secret.clone());
        test_store.commit(&[Work::Hello(introduction)]).await;
    }
    let mut connection = test_store.second_connection().await;
    let known_hosts = read_host_secrets(&mut connection).await.expect("reads");
    assert_eq!(
        known_hosts,
        [(test_store.edge, Some(first.clone()))],
        "only the host with stored events is known, with its first secret"
    );
    assert_eq!(
        test_store.commit(&[Work::Secret(test_store.edge)]).await.secrets,
        [(test_store.edge, Some(first))]
    );

    let cleared = clear_host_secret(&test_store.path, "edge").await.expect("clears");
    assert!(cleared.existed && cleared.host == test_store.edge.to_string());
    assert_eq!(test_store.commit(&[Work::Secret(test_store.edge)]).await.secrets, [(test_store.edge, None)]);
    let repeated = clear_host_secret(&test_store.path, &test_store.edge.to_string()).await.expect("clears");
    assert!(!repeated.existed);
    let unknown = clear_host_secret(&test_store.path, "nobody").await;
    assert!(matches!(unknown, Err(ClearSecretError::NoHost { .. })), "{unknown:?}");
}

#[tokio::test]
async fn hosts_without_introduction_are_unknown() {
    let mut test_store = TestStore::new().await;
    // The clouds of these iterations send no events to this aggregator: only the iterations name them.
    for seed in 1..=5 {
        let (run, cloud) = (RunId::random(), HostId::random());
        let mut numbers = generate::Numbers::new(seed);
        let start = generate::run_started(run, "line", NOW);
        let iteration = generate::iteration(run, 1, (test_store.edge, cloud), &mut numbers);
        let work = test_store.batch(vec![start, Event::Iteration(iteration)]);
        assert!(test_store.commit(&[work]).await.quarantined.is_empty());
    }
    assert_eq!(test_store.count("SELECT count(*) FROM host WHERE name IS NULL").await, 5);
    let known_hosts = read_host_secrets(&mut test_store.second_connection().await).await.expect("reads");
    let known_hosts: Vec<HostId> = known_hosts.into_iter().map(|(host, _)| host).collect();
    assert_eq!(known_hosts, [test_store.edge], "only known hosts count against max_hosts");
    let counts = read_host_counts(&mut test_store.second_connection().await, 10).await.expect("reads");
    let counted_hosts: Vec<HostId> = counts.into_iter().map(|(host, _)| host).collect();
    assert_eq!(counted_hosts, [test_store.edge, test_store.cloud], "only hosts that introduced themselves");
}
