//! Challenges that wait for their proof. Nothing of a host changes before the agent has proven that it has the host's
//! secret.

use std::collections::HashMap;
use std::hash::Hash;

use peernet_clock::{MonoTime, Span};

use super::super::{HostSecret, Nonce, Proof, STREAM_VERSIONS};
use super::{Hello, ToAgent};
use peernet_logger::Slug;

/// Time that a challenge waits for its proof: longer than a round trip on any link.
const PROOF_TIMEOUT: Span = Span::from_seconds(15);

/// Hellos that wait for their proof, at most one per connection. `C` identifies a connection.
#[derive(Clone, Debug)]
pub struct Challenges<C> {
    aggregator: Slug,
    pending: HashMap<C, PendingHello>,
}

#[derive(Clone, Debug)]
struct PendingHello {
    hello: Box<Hello>,
    nonce: Nonce,
    /// `true` if the challenge requests the secret.
    enrol: bool,
    challenged_at: MonoTime,
}

/// Result of a proof.
#[derive(Clone, Debug, PartialEq)]
pub enum ProofResult {
    /// The proof is valid.
    Valid {
        /// Hello that the proof confirms.
        hello: Box<Hello>,
        /// Secret of the host, if the aggregator had none of that host before.
        enrolled: Option<HostSecret>,
    },
    /// The proof was made with a secret that is not the host's.
    Invalid(Box<Hello>),
    /// The proof answers no challenge of this connection, or the aggregator has no secret of the host any more. The
    /// agent must send a hello.
    Unsolicited,
}

impl<C: Eq + Hash> Challenges<C> {
    /// Creates an empty set of challenges for the aggregator of this name.
    pub fn new(aggregator: Slug) -> Self {
        Self { aggregator, pending: HashMap::new() }
    }

    /// Records the hello of a connection and returns the challenge to be sent. `enrol` requests the secret, because no
    /// secret of the host is known; `nonce` is a new random number.
    ///
    /// The challenge states the highest version that both ends support, unless this version is the oldest version that
    /// the agent supports. Hellos without a common version are refused before they are challenged
    /// ([`Receiving::version_refusal`](super::Receiving::version_refusal)).
    ///
    /// A repeated hello gets the same challenge again, because on a slow link the proof may be in flight. Any other
    /// hello replaces the previous hello of its connection.
    pub fn challenge(
        &mut self,
        connection: C,
        hello: Hello,
        enrol: bool,
        nonce: Nonce,
        now: MonoTime,
    ) -> ToAgent {
        let identity = |hello: &Hello| (hello.host.id, hello.process, hello.stream);
        let previous = self.pending.get(&connection);
        // A proof for the previous challenge may be in flight; a new nonce would make it invalid.
        let repeated = previous
            .filter(|previous| identity(&previous.hello) == identity(&hello) && previous.enrol == enrol);
        let nonce = repeated.map_or(nonce, |repeated| repeated.nonce);
        let (aggregator, stream) = (self.aggregator.clone(), hello.stream);
        let chosen = STREAM_VERSIONS.highest_common(&hello.versions()).ok();
        let version = chosen.filter(|chosen| *chosen != hello.protocol);
        self.pending
            .insert(connection, PendingHello { hello: Box::new(hello), nonce, enrol, challenged_at: now });
        ToAgent::Challenge { aggregator, stream, nonce, enrol, version }
    }

    /// Checks the proof that arrived on a connection. `known_secret` is the stored secret of the host that the hello
    /// names, if any. An answer removes its challenge, whether the answer is valid or not.
    pub fn check_proof(
        &mut self,
        connection: &C,
        proof: Proof,
        known_secret: Option<&HostSecret>,
    ) -> ProofResult {
        let is_answered =
            |pending: &PendingHello| (pending.hello.host.id, pending.nonce) == (proof.host, proof.nonce);
        if !self.pending.get(connection).is_some_and(is_answered) {
            return ProofResult::Unsolicited;
        }
        // The challenge is removed before the check, so that each nonce is answered at most once.
        let Some(PendingHello { hello, nonce, enrol, .. }) = self.pending.remove(connection) else {
            return ProofResult::Unsolicited;
        };
        // A secret that was not requested is ignored. Otherwise, if the host's secret was deleted from the database
        // after the challenge, anybody could give the host a new secret.
        let stated_secret = proof.secret.filter(|_| enrol);
        let Some(secret) = known_secret.or(stated_secret.as_ref()) else { return ProofResult::Unsolicited };
        if secret.verify(&proof.code, &nonce, &hello, &self.aggregator) {
            ProofResult::Valid { hello, enrolled: stated_secret.filter(|_| known_secret.is_none()) }
        } else {
            ProofResult::Invalid(hello)
        }
    }

    /// Removes the challenge of a connection that ended.
    pub fn forget(&mut self, connection: &C) {
        self.pending.remove(connection);
    }

    /// Removes challenges that were not answered in time.
    pub fn remove_expired(&mut self, now: MonoTime) {
        self.pending.retain(|_, pending| now - pending.challenged_at <= PROOF_TIMEOUT);
    }

    /// Returns the number of challenges without an answer.
    pub fn len(&self) -> usize {
        self.pending.len()
    }

    /// Returns whether no challenge waits for an answer.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }
}
