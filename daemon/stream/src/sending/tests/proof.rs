//! The proof that an agent has the secret of its host.

use super::super::super::{AGENT_STREAM_VERSIONS, Nonce};
use super::*;

/// Returns a challenge. `enrol` requests the secret.
fn challenge(agent: &Agent, stream: StreamId, enrol: bool) -> ToAgent {
    let aggregator = "base".parse().expect("a name");
    assert!(!agent.hellos.is_empty(), "the agent sent a hello");
    ToAgent::Challenge { aggregator, stream, nonce: Nonce::from_bytes([5; 32]), enrol, version: None }
}

#[test]
fn secret_is_sent_only_when_requested() {
    let mut agent = Agent::new(SendingConfig::default());
    agent.connect();
    let stream = agent.hellos[0].stream;
    agent.receive(&challenge(&agent, stream, false));
    agent.receive(&challenge(&agent, stream, true));
    let contains_secret: Vec<bool> = agent.proofs.iter().map(|proof| proof.secret.is_some()).collect();
    assert_eq!(contains_secret, [false, true]);
    let (proof, aggregator) = (&agent.proofs[1], "base".parse().expect("a name"));
    let secret = proof.secret.as_ref().expect("the proof contains the secret");
    assert!(secret.verify(&proof.code, &Nonce::from_bytes([5; 32]), &agent.hellos[0], &aggregator));
    assert!(agent.notices.iter().any(|notice| matches!(notice, Notice::Enrolling { .. })));
}

#[test]
fn challenge_with_unsupported_version_is_not_answered() {
    let mut agent = Agent::new(SendingConfig::default());
    agent.connect();
    let (stream, chosen) = (agent.hellos[0].stream, AGENT_STREAM_VERSIONS.newest());
    let challenge_with = |version| match challenge(&agent, stream, false) {
        ToAgent::Challenge { aggregator, stream, nonce, enrol, .. } => {
            ToAgent::Challenge { aggregator, stream, nonce, enrol, version }
        }
        other => other,
    };
    let (too_new, supported) = (challenge_with(Some(chosen + 1)), challenge_with(Some(chosen)));
    agent.receive(&too_new);
    assert!(agent.proofs.is_empty());
    let Some(Notice::Refused(reason)) = agent.notices.last() else { panic!("{:?}", agent.notices) };
    assert!(reason.contains("the aggregator on base"), "{reason}");
    assert_eq!(
        agent.sending.version(),
        AGENT_STREAM_VERSIONS.oldest(),
        "the oldest version is used until a supported version is chosen"
    );
    agent.receive(&supported);
    assert_eq!((agent.proofs.len(), agent.sending.version()), (1, chosen));
}

#[test]
fn challenge_of_another_stream_is_not_answered() {
    let mut agent = Agent::new(SendingConfig::default());
    agent.connect();
    agent.receive(&challenge(&agent, StreamId::random(), false));
    assert!(agent.proofs.is_empty());
}

#[test]
fn agent_with_session_answers_no_challenge() {
    let mut agent = Agent::new(SendingConfig::default());
    agent.connect();
    let stream = agent.hellos[0].stream;
    agent.welcome(0, None);
    agent.receive(&challenge(&agent, stream, true));
    assert!(agent.proofs.is_empty());
}
