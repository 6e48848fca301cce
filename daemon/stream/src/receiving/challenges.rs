//! Challenges that wait for their proof: nothing of a host changes before it has shown that it has the host's secret.

use std::collections::HashMap;
use std::hash::Hash;

use peernet_clock::{MonoTime, Span};

use super::super::{HostSecret, Nonce, Proof, STREAM_VERSIONS};
use super::{Hello, ToAgent};
use peernet_logger::Slug;

/// How long a challenge waits for its proof: longer than a round trip on any link.
const PROOF_WITHIN: Span = Span::from_seconds(15);

/// Hellos whose proof is awaited, one of each connection at most. `C` identifies a connection.
#[derive(Clone, Debug)]
pub struct Challenges<C> {
    aggregator: Slug,
    pending: HashMap<C, Pending>,
}

#[derive(Clone, Debug)]
struct Pending {
    hello: Box<Hello>,
    nonce: Nonce,
    /// Whether the secret was asked for.
    enrol: bool,
    since: MonoTime,
}

/// What a proof shows.
#[derive(Clone, Debug, PartialEq)]
pub enum Proven {
    /// The hello is that of its host.
    Yes {
        /// What was said at first.
        hello: Box<Hello>,
        /// The host's secret, where the aggregator knew none until now.
        enrolled: Option<HostSecret>,
    },
    /// It was made with another secret than the host's.
    No(Box<Hello>),
    /// It answers no challenge that waits on this connection: the agent is to say hello again.
    Unasked,
}

impl<C: Eq + Hash> Challenges<C> {
    /// No challenge yet, by the aggregator of this name.
    pub fn new(aggregator: Slug) -> Self {
        Self { aggregator, pending: HashMap::new() }
    }

    /// A hello came on a connection. Returns what is to be sent. `enrol` says that no secret of its host is known;
    /// `nonce` is a fresh one.
    ///
    /// The highest version that both ends speak is chosen. Hellos without one are refused before
    /// ([`Receiving::refuses_version`](super::Receiving::refuses_version)).
    ///
    /// A hello that is repeated gets the same challenge again: on a slow link the proof may be on its way. Any other takes
    /// the place of the one before on its connection.
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
        let before = before.filter(|it| claim(&it.hello) == claim(&hello) && it.enrol == enrol);
        let nonce = before.map_or(nonce, |before| before.nonce);
        let (aggregator, stream) = (self.aggregator.clone(), hello.stream);
        let chosen = STREAM_VERSIONS.highest_common(&hello.versions()).ok();
        let version = chosen.filter(|chosen| *chosen != hello.protocol);
        self.pending.insert(connection, Pending { hello: Box::new(hello), nonce, enrol, since: now });
        ToAgent::Challenge { aggregator, stream, nonce, enrol, version }
    }

    /// The host whose proof a connection is to give.
    pub fn awaited(&self, connection: &C) -> Option<&Hello> {
        self.pending.get(connection).map(|pending| &*pending.hello)
    }

    /// A proof came on a connection; `known` is the secret of the host that [`awaited`](Self::awaited) names, if one is
    /// known. A challenge is used up by the answer to it, whether that is right or wrong.
    pub fn prove(&mut self, connection: &C, proof: Proof, known: Option<&HostSecret>) -> Proven {
        let answered =
            |pending: &Pending| (pending.hello.host.id, pending.nonce) == (proof.host, proof.nonce);
        if !self.pending.get(connection).is_some_and(answered) {
            return Proven::Unasked;
        }
        let Some(Pending { hello, nonce, enrol, .. }) = self.pending.remove(connection) else {
            return Proven::Unasked;
        };
        let told = proof.secret.filter(|_| enrol);
        let Some(secret) = known.or(told.as_ref()) else { return Proven::Unasked };
        if secret.verify(&proof.code, &nonce, &hello, &self.aggregator) {
            Proven::Yes { hello, enrolled: told.filter(|_| known.is_none()) }
        } else {
            Proven::No(hello)
        }
    }

    /// A connection has ended.
    pub fn forget(&mut self, connection: &C) {
        self.pending.remove(connection);
    }

    /// Forgets challenges that were not answered in time.
    pub fn age(&mut self, now: MonoTime) {
        self.pending.retain(|_, pending| now - pending.since <= PROOF_WITHIN);
    }

    /// How many proofs are awaited.
    pub fn len(&self) -> usize {
        self.pending.len()
    }

    /// Whether no proof is awaited.
    pub fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }
}
