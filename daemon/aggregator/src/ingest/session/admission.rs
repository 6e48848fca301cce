//! The admission of a host: its hello, the proof of its identity, and the records that follow.

use peernet_clock::Stamp;
use peernet_logger::HostId;
use peernet_networks::Peer;
use peernet_stream::{Hello, HelloResult, HostSecret, Nonce, Proof, ProofResult, Receiving, ToAgent};

use super::IngestSession;
use crate::ingest::queue::AdmittedWork;
use crate::live::{LiveEvent, limits};
use crate::live_state::RefusedHost;
use peernet_store::writing::{Introduction, Work};

impl IngestSession {
    /// Processes a hello. Nothing about the host changes until its identity is proven.
    pub(super) fn handle_hello(&mut self, from: &Peer, mut hello: Hello, now: Stamp) {
        let host = hello.host.id;
        // The description is cut to the size that is displayed, because the challenge keeps it before the host has
        // proven its identity. What is cut here is not counted.
        limits::limit_description(&mut hello.host, &mut 0);
        let reason = Receiving::version_refusal(&hello)
            .or_else(|| self.routes.limit_refusal(from.connection, host))
            .or_else(|| self.hosts.limit_refusal(host));
        if let Some(reason) = reason {
            self.refuse(from, &hello, reason, now);
            return;
        }
        // A host without a known secret states it with the proof: trust on first use.
        let enrol = self.hosts.secret(host).is_none();
        let reply = self.challenges.challenge(from.connection, hello, enrol, Nonce::random(), now.mono);
        self.output.reply(from.connection, reply);
    }

    /// Processes a proof of identity.
    pub(super) fn handle_proof(&mut self, from: &Peer, proof: Proof, now: Stamp) {
        let known_secret = self.hosts.secret(proof.host).cloned();
        match self.challenges.check_proof(&from.connection, proof, known_secret.as_ref()) {
            ProofResult::Valid { hello, enrolled } => {
                let secret = known_secret.or(enrolled);
                self.open_session(from, *hello, secret, now);
            }
            ProofResult::Invalid(hello) => {
                let host = hello.host.id;
                // An operator may have cleared the secret since it was read, so it is read again.
                if self.hosts.needs_secret_check(host, now.mono)
                    && let Some(slot) = self.queue.reserve(0)
                {
                    slot.fill(AdmittedWork::Work(Work::Secret(host)), now.mono);
                }
                self.refuse(from, &hello, secret_refusal(host), now);
            }
            ProofResult::Unsolicited => {
                self.output.reject_stranger(from.connection);
            }
        }
    }

    /// Gives a session to a host that has proven its identity.
    fn open_session(&mut self, from: &Peer, hello: Hello, secret: Option<HostSecret>, now: Stamp) {
        let host = hello.host.id;
        // The limit is checked again, because other hosts may have been stored since the hello.
        if let Some(reason) = self.hosts.limit_refusal(host) {
            self.refuse(from, &hello, reason, now);
            return;
        }
        // An agent repeats its hello every ten seconds while nothing can be stored. A repeated hello adds nothing to the
        // database and takes no place in the queue. The agent therefore keeps its session, and with it the live lane,
        // even if the queue is full.
        let is_repeated = self.hosts.is_stored(host)
            && self.hosts.secret(host).is_some()
            && self.receiving.is_repeated_hello(&hello);
        // If the queue has no capacity for the work that follows, the hello counts as lost; the agent repeats the
        // hello.
        let slots = if is_repeated { None } else { self.queue.reserve(0).zip(self.queue.reserve(0)) };
        if slots.is_none() && !is_repeated {
            self.output.count_deferred_hello();
            return;
        }
        let record = self.store.streams.stream_record(&hello, self.hosts.seniority(host));
        // A welcome acknowledges all batches up to the stream's mark. While the database is closed, it is unknown
        // whether these batches are still stored, so the agent has to wait and repeats its hello.
        if !self.store.is_open() && record.mark.is_some_and(|mark| hello.oldest <= mark.stored) {
            return;
        }
        match self.receiving.handle_hello(&hello, record, now.mono) {
            HelloResult::Welcome { reply, missing, replaced, missing_previous, displaced } => {
                let Hello { host: description, process, stream, previous_stream, first, .. } = hello;
                let name = &description.name;
                if let Some(replaced) = replaced {
                    tracing::warn!(
                        host = %name, %stream, %replaced,
                        "the spool of this host was deleted or replaced: its remaining events are lost"
                    );
                }
                if let Some(missing_previous) = missing_previous {
                    tracing::warn!(
                        host = %name, stream = %missing_previous.stream, from = missing_previous.from, through = missing_previous.through,
                        events = missing_previous.events,
                        "batches of this host are not in this database, which is an older copy of the one that stored them; \
                         they are recorded as a gap"
                    );
                }
                if let Some(missing) = missing {
                    // Logged as information: an agent deletes only acknowledged batches, so another database has stored
                    // these.
                    tracing::info!(
                        host = %name, from = missing.from, through = missing.through, events = missing.events,
                        "batches of this host are missing in this database and are recorded as a gap: another aggregator \
                         acknowledged them, or this one did with another database"
                    );
                }
                tracing::info!(host = %name, id = %host, stored = record.mark.map(|mark| mark.stored), "a host connected");
                let introduction = Introduction {
                    host: description.clone(),
                    process,
                    stream,
                    previous_stream,
                    first,
                    replaced,
                    missing_previous,
                    secret,
                };
                let dropped_newcomer = slots.and_then(|(introduction_slot, gap_slot)| {
                    if !self.hosts.is_stored(host) {
                        // A newcomer is stored with its first batch, so nothing is queued now.
                        drop((introduction_slot, gap_slot));
                        return self.hosts.add_newcomer(introduction, missing);
                    }
                    if let Some(secret) = &introduction.secret {
                        self.hosts.enrol(host, secret);
                    }
                    introduction_slot.fill(AdmittedWork::Work(Work::Hello(Box::new(introduction))), now.mono);
                    match missing {
                        Some(missing) => {
                            gap_slot.fill(AdmittedWork::Work(Work::MissingBatches(missing)), now.mono);
                        }
                        None => drop(gap_slot),
                    }
                    self.store.streams.record_hello(host, stream);
                    None
                });
                if let Some(dropped_newcomer) = dropped_newcomer {
                    self.end_dropped_newcomer(dropped_newcomer);
                }
                if let Some(displaced) = displaced {
                    tracing::warn!(host = %description.name, id = %host, %displaced, "this host has been stored under this name for longer; another host with the name was disconnected");
                    // The displaced host sends its hello again and is refused with the reason.
                    self.routes.remove(displaced);
                    self.forget_newcomer(displaced);
                }
                self.routes.insert(host, from.connection);
                self.output.reply(from.connection, reply);
                self.output.announce(LiveEvent::Hello(Box::new(description), process));
            }
            HelloResult::Refused { reason, .. } => {
                drop(slots);
                self.refuse(from, &hello, reason, now);
            }
            // The agent repeats its hello, and that hello decides.
            HelloResult::Wait => {}
        }
    }

    /// Refuses a host, and shows the refusal in the log and in the live state.
    fn refuse(&mut self, from: &Peer, hello: &Hello, reason: String, now: Stamp) {
        let ip = from.address.map(|address| address.ip());
        let address = from.address.map(|address| address.to_string());
        if let Some(times) = self.refusals.count_event(&reason, ip, now.mono) {
            let (host, id) = (&hello.host.name, &hello.host.id);
            tracing::warn!(%host, %id, address, %reason, times, "a host was refused");
        }
        self.output.reply(from.connection, ToAgent::Refused { reason: reason.clone() });
        let refused = RefusedHost { name: hello.host.name.clone(), address, reason, at: now.wall };
        self.output.announce(LiveEvent::Refused(refused));
    }
}

/// Returns the text that refuses an agent without the secret of its host id, with the remedy.
fn secret_refusal(host: HostId) -> String {
    format!(
        "this agent does not have the secret that belongs to the host id {host}. If its state directory is a copy of another \
         host's, give it another [agent] state_dir. If this really is that host, and its file host-secret was lost or the \
         aggregator's database is an older copy, run `peernetd clear-host-secret --config CONFIG {host}` on the aggregator's \
         machine. Nothing has to be deleted: until the host is admitted again, its events wait in its spool"
    )
}
