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
    pending: HashMap<C, Pending>,
}

#[derive(Clone, Debug)]
struct Pending {
    hello: Box<Hello>,
    nonce: Nonce,
    /// `true` if the secret was requested.
    enrol: bool,
    since: MonoTime,
}

/// Result of a proof.
#[derive(Clone, Debug, PartialEq)]
pub enum ProofResult {
    /// The proof is valid.
    Valid {
        /// Hello that the proof confirms.
        hello: Box<Hello>,
        /// Secret of the host, if the aggregator had none before.
        enrolled: Option<HostSecret>,
    },
    /// The proof was made with another secret than the host's.
    Invalid(Box<Hello>),
    /// The proof answers no challenge of this connection. The agent must send a hello.
    Unsolicited,
}

impl<C: Eq + Hash> Challenges<C> {
    /// Creates an empty set of challenges for the aggregator of this name.
    pub fn new(aggregator: Slug) -> Self {
        Self { aggregator, pending: HashMap::new() }
    }

    /// Records the hello of a connection and returns the challenge to be sent. `enrol` requests the secret, because
    /// none of the host is known; `nonce` is a new one.
    ///
    /// The challenge contains the highest version that both ends support. Hellos without such a version are refused
    /// before ([`Receiving::version_refusal`](super::Receiving::version_refusal)).
    ///
    /// A repeated hello gets the same challenge again, because on a slow link the proof may be in flight. Any other
    /// hello replaces the previous one of its connection.
    pub fn challenge(
        &mut self,
        connection: C,
        hello: Hello,
        enrol: bool,
        nonce: Nonce,
        now: MonoTime,
    ) -> ToAgent {
        let claim = |hello: &Hello| (hello.host.id, hello.process, hello.stream);
        let before = self.pending.get(&connection);
        // A proof for the previous challenge may be in flight; a new nonce would make it invalid.
        let before = before.filter(|it| claim(&it.hello) == claim(&hello) && it.enrol == enrol);
        let nonce = before.map_or(nonce, |before| before.nonce);
        let (aggregator, stream) = (self.aggregator.clone(), hello.stream);
        let chosen = STREAM_VERSIONS.highest_common(&hello.versions()).ok();
        let version = chosen.filter(|chosen| *chosen != hello.protocol);
        self.pending.insert(connection, Pending { hello: Box::new(hello), nonce, enrol, since: now });
        ToAgent::Challenge { aggregator, stream, nonce, enrol, version }
    }

    /// Returns the hello whose proof a connection has to send.
    pub fn pending_hello(&self, connection: &C) -> Option<&Hello> {
        self.pending.get(connection).map(|pending| &*pending.hello)
    }

    /// Checks the proof that came on a connection. `known` is the secret of the host that [`pending_hello`](Self::pending_hello)
    /// returns, if the aggregator has one. A challenge is removed by its answer, whether that is valid or not.
    pub fn check_proof(&mut self, connection: &C, proof: Proof, known: Option<&HostSecret>) -> ProofResult {
        let answered =
            |pending: &Pending| (pending.hello.host.id, pending.nonce) == (proof.host, proof.nonce);
        if !self.pending.get(connection).is_some_and(answered) {
            return ProofResult::Unsolicited;
        }
        // Removed before the check, so that each nonce is answered at most once.
        let Some(Pending { hello, nonce, enrol, .. }) = self.pending.remove(connection) else {
            return ProofResult::Unsolicited;
        };
        // A secret that was not requested is ignored: it could replace the known secret.
        let told = proof.secret.filter(|_| enrol);
        let Some(secret) = known.or(told.as_ref()) else { return ProofResult::Unsolicited };
        if secret.verify(&proof.code, &nonce, &hello, &self.aggregator) {
            ProofResult::Valid { hello, enrolled: told.filter(|_| known.is_none()) }
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
        self.pending.retain(|_, pending| now - pending.since <= PROOF_TIMEOUT);
    }

    /// Returns the number of challenges without an answer.
    pub fn len(&self) -> usize {
        self.pending.len()
    }

    /// Returns whether all challenges are answered.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }
}
