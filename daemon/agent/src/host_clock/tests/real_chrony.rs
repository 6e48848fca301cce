//! Tests with real chrony: its claims become intervals that contain the truth, with the right sign.

use peernet_clock::{DelaySource, Span};
use peernet_networks::PeerClock;
use tokio::sync::watch;

use super::chronyd::Chronyd;
use super::{start_watching, system_clock};
use crate::config::ClockConfig;

/// Waits for the first state after chrony was queried.
async fn wait_for_first_answer(published: &mut watch::Receiver<PeerClock>) -> PeerClock {
    let state_after_query =
        published.wait_for(|state| !state.text.is_empty() && !state.text.contains("not queried"));
    state_after_query.await.expect("the task runs").clone()
}

#[tokio::test]
async fn interval_contains_known_bias_and_not_its_opposite() {
    let server = Chronyd::server();
    // chrony adds `offset` to its measurement of a server with the same clock. chrony then assumes that true time is
    // 50 ms ahead of the clock, or 50 ms behind the clock.
    for (offset_s, error) in [(0.050, Span::from_millis(-50)), (-0.050, Span::from_millis(50))] {
        let client = Chronyd::client(&server, offset_s);
        let clock = system_clock();
        let (mut published, _running) = start_watching(client.clock_config(), None, &clock);
        let state = wait_for_first_answer(&mut published).await;
        assert_eq!(state.text, "chrony, stratum 11, to 127.0.0.1");
        let claim = state.claim.expect("chrony is synchronised");
        assert_eq!(claim.source, DelaySource::Chrony);
        let contains = |error: Span| claim.error.lo <= error && error <= claim.error.hi;
        assert!(contains(error), "{error} is not in {:?}", claim.error);
        assert!(!contains(-error), "{} is in {:?}", -error, claim.error);
        assert!(
            contains(Span::ZERO),
            "the claim stays true while chrony slews the error to zero: {:?}",
            claim.error
        );
        assert!(claim.error.width() < Span::from_millis(80), "{:?}", claim.error);
    }
}

#[tokio::test]
async fn daemon_that_follows_no_server_claims_nothing() {
    let (server, unsynchronised) = (Chronyd::server(), Chronyd::without_server());
    // A client that is synchronised to the server shows that the server answers.
    let _client = Chronyd::client(&server, 0.0);
    let expected = [(&server, "chrony, local reference only"), (&unsynchronised, "chrony, not synchronised")];
    for (daemon, text) in expected {
        let clock = system_clock();
        let (mut published, _running) = start_watching(daemon.clock_config(), None, &clock);
        let state = wait_for_first_answer(&mut published).await;
        assert_eq!((state.claim, state.text.as_str()), (None, text));
    }
}

#[tokio::test]
async fn claim_ends_with_its_daemon() {
    let server = Chronyd::server();
    let mut client = Chronyd::client(&server, 0.0);
    let clock = system_clock();
    let (mut published, _running) = start_watching(client.clock_config(), None, &clock);
    published.wait_for(|state| state.claim.is_some()).await.expect("the task runs");
    client.kill();
    let state = published.wait_for(|state| state.claim.is_none()).await.expect("the task runs").clone();
    assert!(state.text.starts_with("chrony, "), "{}", state.text);
}

#[tokio::test]
async fn host_without_chrony_reports_kernel() {
    let clock = system_clock();
    let config = ClockConfig { chronyc: "/nowhere/chronyc".to_owned(), ..ClockConfig::default() };
    let (mut published, _running) = start_watching(config, None, &clock);
    let state = wait_for_first_answer(&mut published).await;
    assert!(state.text.starts_with("kernel, "), "{}", state.text);
}

#[tokio::test]
async fn hanging_or_invalid_command_claims_nothing() {
    let clock = system_clock();
    for (script, text) in [("sleep 60", "no answer within"), ("echo hello", "cannot read the output")] {
        let folder = tempfile::tempdir().expect("there is room for a temporary folder");
        let command = folder.path().join("chronyc");
        std::fs::write(&command, format!("#!/bin/sh\n{script}\n")).expect("the temporary folder is writable");
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&command, mode).expect("the file is ours");
        let config = ClockConfig {
            chronyc: command.display().to_string(),
            discipline: vec![crate::config::ClaimSource::Chrony],
            ..ClockConfig::default()
        };
        let (mut published, _running) = start_watching(config, None, &clock);
        let state = wait_for_first_answer(&mut published).await;
        assert_eq!(state.claim, None);
        assert!(state.text.contains(text), "{}", state.text);
    }
}
