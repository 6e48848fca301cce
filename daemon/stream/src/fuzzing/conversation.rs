//! Random conversations with each of the two state machines.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use peernet_clock::{MonoTime, Span, Stamp};

use super::script::{Script, host, start_time};
use crate::codec;
use crate::{
    Accounting, Action, Arrival, ChainHash, Event, HelloResult, HostSecret, Incident, IncidentKind, Nonce,
    Receiving, ReceivingConfig, Sending, SendingConfig, SpoolState, SpooledBatch, StreamId, StreamRecord,
    ToAgent, ToAggregator, Usage,
};
use peernet_logger::HostId;

/// Maximum number of executed steps of one script.
const MAX_STEPS: usize = 2_000;

/// Runs a script. The first byte selects the receiving or the sending state machine. The other bytes determine the
/// inputs of the state machine: frames, results of actions, and the passage of time.
///
/// # Panics
/// If a guarantee is violated: batches of a stream are accepted out of order, a window is zero, or events are not
/// accounted for.
pub fn any_conversation(data: &[u8]) {
    let Some((&selector, script)) = data.split_first() else { return };
    let mut script = Script(script);
    if selector & 1 == 0 { drive_receiving(&mut script) } else { drive_sending(&mut script) }
}

fn drive_receiving(script: &mut Script<'_>) {
    let mut receiving = Receiving::new(ReceivingConfig::new("base".parse().expect("a name")));
    // For each stream, the number of the last batch that was reported as accepted.
    let mut accepted: BTreeMap<StreamId, u64> = BTreeMap::new();
    let mut now = MonoTime::from_nanos(0);
    for _ in 0..MAX_STEPS {
        if script.is_over() {
            return;
        }
        match script.byte() % 10 {
            0 => {
                let hello = script.hello();
                let mark = (script.byte() & 1 == 0).then(|| script.host()).map(|owner| script.mark(owner));
                let last_stream = (script.byte() & 1 == 0).then(|| script.stream());
                let (was_used, previous_mark) =
                    (last_stream == Some(hello.stream), mark.filter(|mark| mark.stored & 1 == 0));
                let record = StreamRecord {
                    mark,
                    was_used,
                    last_stream,
                    previous_mark,
                    seniority: mark.map(|mark| mark.stored),
                };
                if let HelloResult::Welcome { reply, missing, .. } =
                    receiving.handle_hello(&hello, record, now)
                {
                    assert!(matches!(reply, ToAgent::Welcome { window: 1.., .. }));
                    // The mark may be ahead of the accepted batches, so the order is checked anew from this hello on.
                    accepted.remove(&hello.stream);
                    if let Some(missing) = missing {
                        assert!(missing.from <= missing.through && missing.through < hello.oldest);
                        accepted.insert(hello.stream, missing.through);
                    }
                }
            }
            1..=5 => {
                let (head, is_intact) = (script.head(), !script.byte().is_multiple_of(4));
                let arrival = receiving.handle_batch(&head, is_intact, now);
                if matches!(arrival, Arrival::Accept | Arrival::AcceptDamaged) {
                    let previous = accepted.insert(head.stream, head.number);
                    assert!(
                        previous.is_none_or(|previous| head.number == previous + 1),
                        "batches are accepted in order"
                    );
                    assert!(is_intact == (arrival == Arrival::Accept));
                }
                if let Arrival::Duplicate(reply) = arrival {
                    assert!(
                        matches!(reply, ToAgent::Ack { window: 1.., through, .. } if through >= head.number)
                    );
                }
            }
            6 => {
                let (stream, owner) = (script.stream(), script.host());
                let mark = script.mark(owner);
                receiving.handle_stored(stream, mark);
                // The mark may be ahead of the accepted batches. The next batch then follows the mark.
                accepted.entry(stream).and_modify(|number| *number = mark.stored.max(*number));
            }
            7 => {
                let stream = script.stream();
                receiving.handle_failed_store(stream);
                // The batches after the mark count as not received, so the order is checked anew.
                accepted.remove(&stream);
            }
            8 => {
                let (stream, host) = (script.stream(), script.host());
                receiving.defer_batch(host, stream);
                let max_requests = usize::from(script.byte() % 4);
                assert!(receiving.request_deferred(max_requests).len() <= max_requests);
            }
            _ => {
                now = now + Span::from_millis(i64::from(script.byte()) * 4);
                receiving.forget_silent(Span::from_millis(400), now);
                receiving.handle_live(script.host(), now);
                if script.byte() & 1 == 0 {
                    receiving.handle_goodbye(script.host());
                }
                // The sessions of some hosts may have ended, so the order of all streams is checked anew.
                accepted.clear();
            }
        }
    }
}

/// An agent with a spool, which performs the requested actions or fails.
struct Agent {
    sending: Sending,
    /// Actions on the spool that the agent has not performed yet.
    pending_actions: VecDeque<Action>,
    spool: Vec<SpooledBatch>,
    now: Stamp,
    /// Value of `bytes` in the last request for an echo.
    echo_bytes: u64,
}

fn drive_sending(script: &mut Script<'_>) {
    // The limits are so low that a short script reaches them.
    let config = SendingConfig {
        batch_nodes: 2,
        spool_bytes: 2_000,
        memory: Usage { events: 40, bytes: 2_000 },
        reserve_events: 2,
        ..SendingConfig::default()
    };
    let stream = StreamId::from_bytes([1; 16]);
    let state = SpoolState::new(stream);
    let now = Stamp { wall: start_time(), ..Stamp::default() };
    let (host, process) = (host(HostId::from_bytes([1; 16])), 1);
    let sending = Sending::new(config, host, HostSecret::from_bytes([9; 32]), process, state);
    let mut agent =
        Agent { sending, pending_actions: VecDeque::new(), spool: Vec::new(), now, echo_bytes: 0 };
    let mut last_sent = (stream, ChainHash::START, 0);
    for _ in 0..MAX_STEPS {
        if script.is_over() {
            return;
        }
        agent.step(script, last_sent);
        while let Some(action) = agent.sending.next(agent.now.mono) {
            match action {
                Action::Send(frame) => match codec::decode_batch_head(&frame) {
                    Some(head) => last_sent = (head.stream, head.chain, head.number),
                    None if codec::decode_part(&Bytes::from(frame.clone())).is_some() => {}
                    None => match codec::decode(&frame) {
                        Ok(ToAggregator::Hello(hello)) => {
                            last_sent = (hello.stream, hello.chain_before_oldest, hello.oldest - 1);
                        }
                        Ok(ToAggregator::Proof(_)) => {}
                        Ok(ToAggregator::Echo { bytes, .. }) => agent.echo_bytes = bytes,
                        message => panic!("{message:?} was sent"),
                    },
                },
                action => agent.pending_actions.push_back(action),
            }
        }
        let Accounting { produced, stored, waiting, dropped, .. } = agent.sending.accounting();
        assert_eq!(produced, stored + waiting + dropped, "every event is accounted for");
    }
}

impl Agent {
    /// Performs one step. `last_sent` contains the stream, chain hash and number of the last sent batch.
    fn step(&mut self, script: &mut Script<'_>, last_sent: (StreamId, ChainHash, u64)) {
        let now = self.now;
        match script.byte() % 10 {
            0 | 1 => self.sending.offer(&incident(script.byte()), now),
            2 | 3 => self.answer_next_action(script.byte().is_multiple_of(5)),
            4 => {
                let span = Span::from_millis(i64::from(script.byte()) * 8);
                self.now = now + span;
                self.sending.tick(self.now);
            }
            5 => match script.byte() % 8 {
                2 => self.sending.record_live_sent(usize::from(script.byte()) * 64),
                3 | 4 => drop(self.sending.on_message(&ToAgent::Echo { bytes: self.echo_bytes }, now)),
                0 => self.sending.on_disconnected(),
                1 => self.sending.flush(now.wall),
                _ => self.sending.on_connected(now.mono),
            },
            6 => {
                if let Ok(message) = codec::decode(&script.bytes()) {
                    self.sending.on_message(&message, now);
                }
            }
            _ => {
                let message = random_message(script, last_sent);
                self.sending.on_message(&message, now);
            }
        }
    }

    /// Performs the next action on the spool and reports its result. If `fails` is `true`, reports a failure instead.
    fn answer_next_action(&mut self, fails: bool) {
        let now = self.now;
        let reason = || "the disk fails".to_owned();
        match self.pending_actions.pop_front() {
            Some(Action::Append { .. }) if fails => drop(self.sending.on_append_failed(reason(), now)),
            Some(Action::Append { batches, .. }) => {
                self.spool.extend(batches);
                self.sending.on_appended(now);
            }
            Some(Action::Load { .. }) if fails => drop(self.sending.on_load_failed(reason(), now)),
            Some(Action::Load { from, .. }) => {
                // The loaded batches are batch `from` and the next batch, if the spool contains them.
                let next_batches = self.spool.iter().skip_while(|batch| batch.number < from).take(2);
                let loaded: Vec<_> = next_batches.filter(|batch| batch.number <= from + 1).cloned().collect();
                self.sending.on_loaded(loaded, now);
            }
            Some(Action::Delete { .. }) if fails => drop(self.sending.on_delete_failed(reason(), now)),
            Some(Action::Delete { through, .. }) => {
                self.spool.retain(|batch| batch.number > through);
                self.sending.on_deleted();
            }
            Some(Action::Renew { .. }) if fails => drop(self.sending.on_renew_failed(reason(), now)),
            Some(Action::Renew { .. }) => self.sending.on_renewed(now),
            Some(Action::Send(_)) | None => {}
        }
    }
}

fn random_message(
    script: &mut Script<'_>,
    (mut stream, chain, number): (StreamId, ChainHash, u64),
) -> ToAgent {
    let choice = script.byte();
    let (mut number, mut chain, window) = (number, Some(chain), u32::from(script.byte()));
    // Without the bit 0x40 of `choice`, the message is that of an aggregator that stored everything that was sent.
    if choice & 0x40 != 0 {
        number = script.number();
        chain = (choice & 0x20 != 0).then(|| script.chain(number));
    }
    if choice >= 0xf0 {
        stream = script.stream();
    }
    match choice % 6 {
        0 | 1 => {
            let aggregator = "base".parse().expect("a name");
            let process = Some(u64::from(choice >> 3 & 3));
            ToAgent::Welcome { aggregator, stream, stored: number, chain, process, window }
        }
        2 | 3 => ToAgent::Ack { stream, through: number, window },
        4 => ToAgent::Resend { stream, from: number },
        _ if choice & 0x30 == 0x30 => {
            let (aggregator, nonce) = ("base".parse().expect("a name"), Nonce::from_bytes([choice; 32]));
            let version = (choice & 4 != 0).then_some(u16::from(choice & 7));
            ToAgent::Challenge { aggregator, stream, nonce, enrol: choice & 8 != 0, version }
        }
        _ if choice & 0x10 != 0 => ToAgent::Refused { reason: "no".into() },
        _ => ToAgent::Unknown,
    }
}

fn incident(length: u8) -> Event {
    Event::Incident(Incident {
        at: start_time(),
        kind: IncidentKind::Control,
        pipeline: None,
        run: None,
        peer: None,
        text: "x".repeat(length.into()),
    })
}
