//! Challenges at the aggregator, and the hellos that they confirm.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

// The arguments of `challenge` are the connection, the hello, whether the secret is requested, the nonce, and the time.
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
fn unknown_host_is_enrolled_with_proven_secret() {
    let (mut challenges, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = challenges.challenge(1, hello.clone(), true, nonce(1), at(0).mono);
    let proven = challenges.check_proof(&1, proof(&secret, &hello, &challenge), None);
    assert_eq!(proven, ProofResult::Valid { hello: Box::new(hello), enrolled: Some(secret) });
    assert!(challenges.is_empty());
}

#[test]
fn proof_of_known_host_contains_no_secret() {
    let (mut challenges, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = challenges.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let proof = proof(&secret, &hello, &challenge);
    assert_eq!(proof.secret, None);
    assert_eq!(
        challenges.check_proof(&1, proof, Some(&secret)),
        ProofResult::Valid { hello: Box::new(hello), enrolled: None }
    );
}

#[test]
fn other_secret_is_refused_even_if_proof_contains_it() {
    let (mut challenges, hello, stored_secret) = (challenges(), some_hello(), HostSecret::random());
    let impostor = HostSecret::random();
    let challenge = challenges.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let claimed_proof = Proof { secret: Some(impostor.clone()), ..proof(&impostor, &hello, &challenge) };
    assert_eq!(
        challenges.check_proof(&1, claimed_proof, Some(&stored_secret)),
        ProofResult::Invalid(Box::new(hello.clone()))
    );
    // The host was enrolled on another connection after the secret was requested on this connection.
    let challenge = challenges.challenge(1, hello.clone(), true, nonce(2), at(0).mono);
    let claimed_proof = proof(&impostor, &hello, &challenge);
    assert_eq!(
        challenges.check_proof(&1, claimed_proof, Some(&stored_secret)),
        ProofResult::Invalid(Box::new(hello))
    );
}

#[test]
fn proof_is_valid_once_and_only_on_its_own_connection() {
    let (mut challenges, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = challenges.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    let overheard = proof(&secret, &hello, &challenge);
    challenges.challenge(2, hello, false, nonce(2), at(0).mono);
    assert_eq!(challenges.check_proof(&2, overheard.clone(), Some(&secret)), ProofResult::Unsolicited);
    let replayed = Proof { nonce: nonce(2), ..overheard.clone() };
    assert!(matches!(challenges.check_proof(&2, replayed, Some(&secret)), ProofResult::Invalid(_)));
    assert!(matches!(
        challenges.check_proof(&1, overheard.clone(), Some(&secret)),
        ProofResult::Valid { .. }
    ));
    assert_eq!(challenges.check_proof(&1, overheard, Some(&secret)), ProofResult::Unsolicited);
}

#[test]
fn cleared_secret_is_requested_again() {
    let (mut challenges, hello, secret) = (challenges(), some_hello(), HostSecret::random());
    let challenge = challenges.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    // The secret is cleared before the proof arrives. After `Unsolicited`, the agent sends another hello, and the
    // challenge of that hello requests the secret.
    assert_eq!(
        challenges.check_proof(&1, proof(&secret, &hello, &challenge), None),
        ProofResult::Unsolicited
    );
}

#[test]
fn repeated_hello_gets_same_challenge() {
    let (mut challenges, hello) = (challenges(), some_hello());
    let first = challenges.challenge(1, hello.clone(), false, nonce(1), at(0).mono);
    assert_eq!(challenges.challenge(1, hello.clone(), false, nonce(2), at(1_000).mono), first);
    assert_ne!(
        challenges.challenge(1, Hello { process: 9, ..hello }, false, nonce(2), at(1_000).mono),
        first
    );
    assert_eq!(challenges.len(), 1, "one challenge for each connection");
    challenges.remove_expired(at(16_001).mono);
    assert!(challenges.is_empty(), "challenges without answer are removed after a time");
}

proptest! {
    /// Checks that a hello is accepted only after its own proof with the host's secret, whatever is sent on other
    /// connections.
    #[test]
    fn hello_is_accepted_only_after_its_own_proof(
        steps in prop::collection::vec((0_u8..4, 0_u8..3, 0_u8..3, any::<bool>()), 1..60),
    ) {
        let hosts: Vec<Hello> = (0..3).map(|n| hello(HostId::from_bytes([n; 16]), "edge", 1, StreamId::from_bytes([n; 16]), 1)).collect();
        let secret = |host: u8| HostSecret::from_bytes([host; 32]);
        let (mut challenges, mut open_challenges) = (challenges(), BTreeMap::<u8, (u8, ToAgent)>::new());
        for (turn, (action, connection, host, uses_right_secret)) in (0_u8..).zip(steps) {
            let hello_of_host = hosts[usize::from(host)].clone();
            match action {
                0 | 1 => {
                    let challenge = challenges.challenge(connection, hello_of_host, false, nonce(turn), at(0).mono);
                    open_challenges.insert(connection, (host, challenge));
                }
                2 => {
                    let Some((challenged, challenge)) = open_challenges.values().next().cloned() else { continue };
                    let key = if uses_right_secret { secret(host) } else { HostSecret::from_bytes([99; 32]) };
                    let ToAgent::Challenge { aggregator, nonce, .. } = &challenge else { unreachable!() };
                    let code = key.prove(nonce, &hello_of_host, aggregator);
                    let own_challenge = open_challenges.get(&connection).cloned();
                    if let Some((challenged_host, ToAgent::Challenge { nonce: pending_nonce, .. })) = &own_challenge
                        && (*challenged_host, pending_nonce) == (host, nonce)
                    {
                        open_challenges.remove(&connection);
                    }
                    let is_expected_valid =
                        uses_right_secret && challenged == host && own_challenge == Some((host, challenge.clone()));
                    let proof = Proof { host: hello_of_host.host.id, nonce: *nonce, code, secret: None };
                    let proven = challenges.check_proof(&connection, proof, Some(&secret(host)));
                    let is_valid = matches!(
                        &proven,
                        ProofResult::Valid { hello, .. } if hello.host.id == hello_of_host.host.id
                    );
                    prop_assert_eq!(is_valid, is_expected_valid);
                }
                _ => {
                    challenges.forget(&connection);
                    open_challenges.remove(&connection);
                }
            }
            prop_assert!(challenges.len() <= 3);
        }
    }
}
