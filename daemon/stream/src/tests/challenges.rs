//! Challenges at the aggregator's end, and the hellos that they confirm.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

fn challenges() -> Challenges<u8> {
    Challenges::new("base".parse().expect("a name"))
}

fn nonce(byte: u8) -> Nonce {
    Nonce::from_bytes([byte; 32])
}

/// Returns the proof of an agent with a secret.
fn proof(secret: &HostSecret, hello: &Hello, challenge: &ToAgent) -> Proof {
    let ToAgent::Challenge { aggregator, stream, nonce, enrol, version: None } = challenge else {
        panic!("expected a challenge, got {challenge:?}");
    };
    assert_eq!(*stream, hello.stream);
    let code = secret.prove(nonce, hello, aggregator);
    Proof { host: hello.host.id, nonce: *nonce, code, secret: enrol.then(|| secret.clone()) }
}

fn some_hello() -> Hello {
    hello(HostId::random(), "edge", 1, StreamId::random(), 1)
}

#[test]
fn unknown_host_is_enrolled_with_the_secret_it_proves() {
    let (mut end, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = end.challenge(1, hello.clone(), true, nonce(1), at(0).mono);
    let proven = end.check_proof(&1, proof(&secret, &hello, &challenge), None);
    assert_eq!(proven, ProofResult::Valid { hello: Box::new(hello), enrolled: Some(secret) });
    assert!(end.is_empty());
}

#[test]
fn known_host_proves_without_telling_its_secret() {
    let (mut end, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = end.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let proof = proof(&secret, &hello, &challenge);
    assert_eq!(proof.secret, None);
    assert_eq!(
        end.check_proof(&1, proof, Some(&secret)),
        ProofResult::Valid { hello: Box::new(hello), enrolled: None }
    );
}

#[test]
fn another_secret_is_refused_even_when_it_is_told() {
    let (mut end, hello, known) = (challenges(), some_hello(), HostSecret::random());
    let impostor = HostSecret::random();
    let challenge = end.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let told = Proof { secret: Some(impostor.clone()), ..proof(&impostor, &hello, &challenge) };
    assert_eq!(end.check_proof(&1, told, Some(&known)), ProofResult::Invalid(Box::new(hello.clone())));
    // The host was enrolled on another connection after this one was asked for its secret.
    let challenge = end.challenge(1, hello.clone(), true, nonce(2), at(0).mono);
    let told = proof(&impostor, &hello, &challenge);
    assert_eq!(end.check_proof(&1, told, Some(&known)), ProofResult::Invalid(Box::new(hello)));
}

#[test]
fn proof_counts_once_and_on_its_own_connection() {
    let (mut end, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = end.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let overheard = proof(&secret, &hello, &challenge);
    end.challenge(2, hello, false, nonce(2), at(0).mono);
    assert_eq!(end.check_proof(&2, overheard.clone(), Some(&secret)), ProofResult::Unsolicited);
    let replayed = Proof { nonce: nonce(2), ..overheard.clone() };
    assert!(matches!(end.check_proof(&2, replayed, Some(&secret)), ProofResult::Invalid(_)));
    assert!(matches!(end.check_proof(&1, overheard.clone(), Some(&secret)), ProofResult::Valid { .. }));
    assert_eq!(end.check_proof(&1, overheard, Some(&secret)), ProofResult::Unsolicited);
}

#[test]
fn cleared_secret_is_requested_again() {
    let (mut end, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = end.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    assert_eq!(end.check_proof(&1, proof(&secret, &hello, &challenge), None), ProofResult::Unsolicited);
}

#[test]
fn repeated_hello_gets_the_same_challenge() {
    let (mut end, hello) = (challenges(), some_hello());
    let first = end.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    assert_eq!(end.challenge(1, hello.clone(), false, nonce(2), at(1_000).mono), first);
    assert_ne!(end.challenge(1, Hello { process: 9, ..hello }, false, nonce(2), at(1_000).mono), first);
    assert_eq!(end.len(), 1, "one of each connection");
    end.remove_expired(at(16_001).mono);
    assert!(end.is_empty(), "memory of silent connections is freed");
}

proptest! {
    /// Checks that a hello is accepted only after its own proof with the host's secret, whatever is sent on other
    /// connections.
    #[test]
    fn hello_counts_only_after_its_own_proof(
        steps in prop::collection::vec((0_u8..4, 0_u8..3, 0_u8..3, any::<bool>()), 1..60),
    ) {
        let hosts: Vec<Hello> = (0..3).map(|n| hello(HostId::from_bytes([n; 16]), "edge", 1, StreamId::from_bytes([n; 16]), 1)).collect();
        let secret = |host: u8| HostSecret::from_bytes([host; 32]);
        let (mut end, mut asked) = (challenges(), BTreeMap::<u8, (u8, ToAgent)>::new());
        for (turn, (action, connection, host, honest)) in (0_u8..).zip(steps) {
            let said = hosts[usize::from(host)].clone();
            match action {
                0 | 1 => {
                    let challenge = end.challenge(connection, said, false, nonce(turn), at(0).mono);
                    asked.insert(connection, (host, challenge));
                }
                2 => {
                    let Some((challenged, challenge)) = asked.values().next().cloned() else { continue };
                    let key = if honest { secret(host) } else { HostSecret::from_bytes([99; 32]) };
                    let ToAgent::Challenge { aggregator, nonce, .. } = &challenge else { unreachable!() };
                    let code = key.prove(nonce, &said, aggregator);
                    let mine = asked.get(&connection).cloned();
                    if let Some((of, ToAgent::Challenge { nonce: pending_hello, .. })) = &mine && (*of, pending_hello) == (host, nonce) {
                        asked.remove(&connection);
                    }
                    let counts = honest && challenged == host && mine == Some((host, challenge.clone()));
                    let proven = end.check_proof(&connection, Proof { host: said.host.id, nonce: *nonce, code, secret: None }, Some(&secret(host)));
                    prop_assert_eq!(matches!(&proven, ProofResult::Valid { hello, .. } if hello.host.id == said.host.id), counts);
                }
                _ => {
                    end.forget(&connection);
                    asked.remove(&connection);
                }
            }
            prop_assert!(end.len() <= 3);
        }
    }
}
