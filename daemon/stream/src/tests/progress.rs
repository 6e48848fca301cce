//! Handling of batches at the aggregator's end.

use super::admission::{chain, expect_welcome, hello, mark, record_with};
use super::*;

/// Window of a single agent.
const WINDOW: u32 = 8;
/// Value of `is_intact` in [`Receiving::handle_batch`] for a batch whose bytes match its hash.
const INTACT: bool = true;
/// Value of `is_intact` in [`Receiving::handle_batch`] for a damaged batch.
const DAMAGED: bool = false;

struct AggregatorEnd {
    receiving: Receiving,
    id: HostId,
    stream: StreamId,
    process: u64,
}

impl AggregatorEnd {
    /// Returns the end of an aggregator to which a host with `stored` stored batches sent a hello.
    fn with_stored_batches(stored: u64) -> Self {
        let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
        let mark = (stored > 0).then(|| mark(id, stored));
        let result =
            aggregator.handle_hello(&hello(id, "edge", 1, stream, stored + 1), record_with(mark), at(0).mono);
        assert_eq!(expect_welcome(&result), (stored, mark.map(|mark| mark.chain), WINDOW));
        Self { receiving: aggregator, id, stream, process: 1 }
    }

    fn head(&self, number: u64) -> BatchHead {
        let (host, stream) = (self.id, self.stream);
        let (previous_chain, chain) = (chain(number - 1), chain(number));
        let events_before = number - 1;
        BatchHead {
            host,
            stream,
            process: self.process,
            number,
            previous_chain,
            chain,
            events: 1,
            events_before,
        }
    }

    fn receive_batch(&mut self, number: u64) -> Arrival {
        let head = self.head(number);
        self.receiving.handle_batch(&head, INTACT, at(1).mono)
    }

    fn report_stored(&mut self, number: u64) -> Option<ToAgent> {
        let (to, reply) = self.receiving.handle_stored(self.stream, mark(self.id, number))?;
        assert_eq!(to, self.id);
        Some(reply)
    }

    fn ack(&self, through: u64) -> ToAgent {
        ToAgent::Ack { stream: self.stream, through, window: WINDOW }
    }

    fn resend(&self, from: u64) -> ToAgent {
        ToAgent::Resend { stream: self.stream, from }
    }

    /// Sends the hello of another process with the same spool, long after the first hello.
    fn restart_agent(&mut self, stored: u64) -> HelloResult {
        self.process = 2;
        let hello = hello(self.id, "edge", self.process, self.stream, stored + 1);
        self.receiving.handle_hello(&hello, record_with(Some(mark(self.id, stored))), at(5_000).mono)
    }
}

const UNKNOWN: Arrival = Arrival::Unknown(ToAgent::Unknown);

#[test]
fn batches_are_accepted_in_order_and_acknowledged_when_stored() {
    let mut aggregator = AggregatorEnd::with_stored_batches(2);
    assert_eq!(aggregator.receive_batch(3), Arrival::Accept);
    assert_eq!(aggregator.receive_batch(3), Arrival::Pending);
    assert_eq!(aggregator.receive_batch(4), Arrival::Accept);
    let ack = aggregator.ack(3);
    assert_eq!(aggregator.report_stored(3), Some(ack.clone()));
    assert_eq!(aggregator.receive_batch(1), Arrival::Duplicate(ack));
    assert_eq!(aggregator.receive_batch(4), Arrival::Pending);
}

#[test]
fn missing_batches_are_requested_once() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    let (first, second) = (aggregator.resend(1), aggregator.resend(2));
    assert_eq!(aggregator.receive_batch(2), Arrival::Rejected(Some(first)));
    assert_eq!(aggregator.receive_batch(3), Arrival::Rejected(None));
    assert_eq!(aggregator.receive_batch(1), Arrival::Accept);
    assert_eq!(aggregator.receive_batch(3), Arrival::Rejected(Some(second)));
    assert_eq!(aggregator.receive_batch(9), Arrival::Rejected(None));
}

#[test]
fn failed_batch_is_requested_again_with_later_batches() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    (1..=3).for_each(|number| assert_eq!(aggregator.receive_batch(number), Arrival::Accept));
    aggregator.report_stored(1);
    assert_eq!(
        aggregator.receiving.handle_failed_store(aggregator.stream),
        Some((aggregator.id, aggregator.resend(2)))
    );
    assert_eq!(aggregator.receive_batch(3), Arrival::Rejected(None));
    assert_eq!(aggregator.receive_batch(2), Arrival::Accept);
}

#[test]
fn lost_batches_are_reported_missing_once() {
    for (stored, first, from) in [(3, 1, 4), (0, 1, 1), (0, 5, 5), (3, 6, 4)] {
        let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
        let hello = Hello { first, events_before_first: Some(first - 1), ..hello(id, "edge", 1, stream, 8) };
        let record = record_with((stored > 0).then(|| mark(id, stored)));
        let result = aggregator.handle_hello(&hello, record, at(0).mono);
        let HelloResult::Welcome { missing, .. } = result else { panic!("{result:?}") };
        assert_eq!(
            missing,
            Some(MissingBatches {
                host: id,
                stream,
                from,
                through: 7,
                chain: chain(7),
                process: 1,
                events: Some(8 - from),
                events_through: 7
            })
        );
        expect_welcome(&aggregator.handle_hello(&hello, record, at(1).mono));
        let mut aggregator = AggregatorEnd { receiving: aggregator, id, stream, process: 1 };
        assert_eq!(aggregator.receive_batch(8), Arrival::Accept);
        let ack = aggregator.ack(7);
        assert_eq!(aggregator.report_stored(7), Some(ack));
    }
}

#[test]
fn batch_of_other_stream_host_or_chain_causes_request_for_hello() {
    let mut aggregator = AggregatorEnd::with_stored_batches(4);
    let other_stream = BatchHead { stream: StreamId::random(), ..aggregator.head(5) };
    assert_eq!(aggregator.receiving.handle_batch(&other_stream, INTACT, at(1).mono), UNKNOWN);
    let other_host = BatchHead { host: HostId::random(), ..aggregator.head(5) };
    assert_eq!(aggregator.receiving.handle_batch(&other_host, INTACT, at(1).mono), UNKNOWN);
    let other_chain = BatchHead { previous_chain: chain(9), ..aggregator.head(5) };
    assert_eq!(aggregator.receiving.handle_batch(&other_chain, INTACT, at(1).mono), UNKNOWN);
    assert_eq!(aggregator.receive_batch(5), Arrival::Accept);
}

#[test]
fn batches_of_dead_process_are_stored_before_next_session() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    (1..=3).for_each(|number| assert_eq!(aggregator.receive_batch(number), Arrival::Accept));
    aggregator.report_stored(1);
    assert!(matches!(aggregator.restart_agent(1), HelloResult::Wait), "batches 2 and 3 may still be stored");
    aggregator.report_stored(3);
    let HelloResult::Welcome { reply: ToAgent::Welcome { stored, .. }, .. } = aggregator.restart_agent(1)
    else {
        panic!("expected a welcome, because no batch waits to be stored")
    };
    assert_eq!(stored, 3);

    // If storing failed, the next process may send a different batch with the same number.
    let mut aggregator = AggregatorEnd::with_stored_batches(1);
    assert_eq!(aggregator.receive_batch(2), Arrival::Accept);
    assert!(matches!(aggregator.restart_agent(1), HelloResult::Wait));
    aggregator.receiving.handle_failed_store(aggregator.stream);
    expect_welcome(&aggregator.restart_agent(1));
    let other = BatchHead { chain: chain(9), process: 2, ..aggregator.head(2) };
    assert_eq!(aggregator.receiving.handle_batch(&other, INTACT, at(5_001).mono), Arrival::Accept);
}

#[test]
fn different_batch_of_same_number_causes_request_for_hello() {
    let mut aggregator = AggregatorEnd::with_stored_batches(1);
    (2..=3).for_each(|number| assert_eq!(aggregator.receive_batch(number), Arrival::Accept));
    let other = BatchHead { chain: chain(9), ..aggregator.head(2) };
    let next = BatchHead { previous_chain: chain(9), chain: chain(10), ..aggregator.head(4) };
    for head in [other, next] {
        assert_eq!(aggregator.receiving.handle_batch(&head, INTACT, at(5_001).mono), UNKNOWN);
    }
}

#[test]
fn damaged_batch_is_requested_twice_then_quarantined() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    let (head, resend) = (aggregator.head(1), Arrival::Rejected(Some(aggregator.resend(1))));
    assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), resend);
    assert_eq!(aggregator.receive_batch(2), Arrival::Rejected(None));
    assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), resend);
    // Different damage shows that the batch was damaged in transit.
    let other_damage = BatchHead { events: 2, ..head };
    assert_eq!(aggregator.receiving.handle_batch(&other_damage, DAMAGED, at(1).mono), resend);
    assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), resend);
    assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), resend);
    assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), Arrival::AcceptDamaged);
    assert_eq!(aggregator.receive_batch(2), Arrival::Accept);
}

#[test]
fn batches_with_damaged_chains_cause_request_for_hello() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    let (head, resend) = (
        BatchHead { previous_chain: chain(7), ..aggregator.head(1) },
        Arrival::Rejected(Some(aggregator.resend(1))),
    );
    for expected in [resend.clone(), resend.clone(), UNKNOWN, resend] {
        assert_eq!(aggregator.receiving.handle_batch(&head, DAMAGED, at(1).mono), expected);
    }
}

#[test]
fn deferred_streams_are_requested_oldest_first() {
    let mut aggregator = receiving();
    let agents: Vec<(HostId, StreamId)> = (0..3)
        .map(|n| {
            let (id, stream) = (HostId::random(), StreamId::random());
            expect_welcome(&aggregator.handle_hello(
                &hello(id, &format!("edge-{n}"), n, stream, 1),
                record_with(None),
                at(0).mono,
            ));
            (id, stream)
        })
        .collect();
    for agent in [2, 0, 2, 1] {
        aggregator.defer_batch(agents[agent].0, agents[agent].1);
    }
    aggregator.defer_batch(agents[0].0, StreamId::random());
    let request = |agent: usize| (agents[agent].0, ToAgent::Resend { stream: agents[agent].1, from: 1 });
    assert_eq!(aggregator.request_deferred(0), []);
    assert_eq!(aggregator.request_deferred(2), [request(2), request(0)]);
    // After a hello, the agent sends its batches again. They are not requested.
    aggregator.handle_hello(&hello(agents[1].0, "edge-1", 1, agents[1].1, 1), record_with(None), at(1).mono);
    assert_eq!(aggregator.request_deferred(2), []);
    // The queue had no capacity for a requested batch, which is deferred again.
    aggregator.defer_batch(agents[2].0, agents[2].1);
    assert_eq!(aggregator.request_deferred(9), [request(2)]);
    aggregator.defer_batch(agents[0].0, agents[0].1);
    aggregator.handle_goodbye(agents[0].0);
    assert_eq!(aggregator.request_deferred(9), []);
}

#[test]
fn host_cannot_defer_stream_of_other_host() {
    let (mut aggregator, other) = (AggregatorEnd::with_stored_batches(0), HostId::random());
    let hello_of_other = hello(other, "other", 1, StreamId::random(), 1);
    expect_welcome(&aggregator.receiving.handle_hello(&hello_of_other, record_with(None), at(0).mono));
    aggregator.receiving.defer_batch(other, aggregator.stream);
    assert_eq!(aggregator.receiving.request_deferred(1), []);
    aggregator.receiving.defer_batch(aggregator.id, aggregator.stream);
    assert_eq!(aggregator.receiving.request_deferred(1), [(aggregator.id, aggregator.resend(1))]);
}

#[test]
fn agent_that_ignores_window_is_limited() {
    let mut aggregator = AggregatorEnd::with_stored_batches(0);
    let accepted =
        (1..=10_000).take_while(|number| aggregator.receive_batch(*number) == Arrival::Accept).count();
    assert!((MAX_IN_FLIGHT_BATCHES..3_000).contains(&accepted), "{accepted}");
    assert_eq!(aggregator.restart_agent(0), HelloResult::Wait);
}

#[test]
fn largest_batch_numbers_are_handled() {
    let last = i64::MAX as u64;
    let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
    let stored = |number| HighWaterMark {
        host: id,
        stored: number,
        chain: ChainHash::START,
        process: None,
        events: Some(number),
    };
    let hello =
        Hello { oldest: last, chain_before_oldest: ChainHash::START, ..hello(id, "edge", 1, stream, 1) };
    let result = aggregator.handle_hello(&hello, record_with(None), at(0).mono);
    assert!(matches!(result, HelloResult::Welcome { missing: Some(MissingBatches { from: 1, .. }), .. }));
    let head = |number| {
        let (host, previous_chain, chain) = (id, ChainHash::START, chain(1));
        BatchHead {
            host,
            stream,
            process: 1,
            number,
            previous_chain,
            chain,
            events: 1,
            events_before: number - 1,
        }
    };
    assert_eq!(aggregator.handle_batch(&head(last), INTACT, at(1).mono), Arrival::Accept);
    assert_eq!(
        aggregator.handle_batch(
            &BatchHead { previous_chain: chain(1), ..head(last + 1) },
            INTACT,
            at(1).mono
        ),
        Arrival::Rejected(None)
    );
    assert!(aggregator.handle_stored(stream, stored(u64::MAX)).is_some());
    assert_eq!(
        aggregator.handle_failed_store(stream),
        Some((id, ToAgent::Resend { stream, from: u64::MAX }))
    );
    assert_eq!(aggregator.handle_batch(&head(u64::MAX), INTACT, at(1).mono), UNKNOWN);
    aggregator.handle_goodbye(id);
    expect_welcome(&aggregator.handle_hello(&hello, record_with(Some(stored(u64::MAX))), at(2).mono));
}
