//! Admission of hosts at the aggregator's end.

use super::*;

pub(crate) fn hello(id: HostId, name: &str, process: u64, stream: StreamId, oldest: u64) -> Hello {
    Hello {
        protocol: STREAM_VERSIONS.oldest(),
        host: host(id, name),
        stream,
        previous_stream: None,
        first: 1,
        oldest,
        chain_before_oldest: chain(oldest - 1),
        events_before_oldest: oldest - 1,
        events_before_first: Some(0),
        batch_bytes: 512 * 1024,
        process,
        extension: None,
    }
}

/// Returns the chain hash of a batch in the stream that these tests use.
pub(super) fn chain(number: u64) -> ChainHash {
    (0..number).fold(ChainHash::START, |chain, _| chain.next(1, b"event"))
}

/// Returns the mark of a stream of which `stored` batches are stored.
pub(super) fn mark(host: HostId, stored: u64) -> HighWaterMark {
    HighWaterMark { host, stored, chain: chain(stored), process: Some(1), events: Some(stored) }
}

/// Returns the database's state for one stream.
pub(super) fn record_with(mark: Option<HighWaterMark>) -> StreamRecord {
    StreamRecord { mark, was_used: mark.is_some(), ..StreamRecord::default() }
}

/// Returns the reason of a refusal. Panics for any other result.
pub(super) fn expect_refusal(result: HelloResult) -> String {
    match result {
        HelloResult::Refused { reply: ToAgent::Refused { reason: stated_reason }, reason }
            if stated_reason == reason =>
        {
            reason
        }
        other => panic!("expected a refusal, got {other:?}"),
    }
}

/// Returns the number and the chain hash of the last stored batch, and the window, from a welcome that reports nothing
/// else. Panics for any other result.
pub(super) fn expect_welcome(result: &HelloResult) -> (u64, Option<ChainHash>, u32) {
    match result {
        HelloResult::Welcome {
            reply: ToAgent::Welcome { stored, chain, window, .. },
            missing: None,
            replaced: None,
            missing_previous: None,
            displaced: None,
        } => (*stored, *chain, *window),
        other => panic!("expected a welcome, got {other:?}"),
    }
}

#[test]
fn message_without_session_requests_hello() {
    let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
    assert_eq!(aggregator.handle_live(id, at(0).mono), Some(ToAgent::Unknown));
    expect_welcome(&aggregator.handle_hello(&hello(id, "edge", 1, stream, 1), record_with(None), at(0).mono));
    assert_eq!(aggregator.handle_live(id, at(0).mono), None);
    aggregator.forget_silent(Span::from_seconds(60), at(60_001).mono);
    assert_eq!(aggregator.handle_live(id, at(60_001).mono), Some(ToAgent::Unknown));
}

#[test]
fn hello_is_repeated_only_if_nothing_has_changed() {
    let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
    let first_hello = hello(id, "edge", 1, stream, 4);
    assert!(!aggregator.is_repeated_hello(&first_hello));
    expect_welcome(&aggregator.handle_hello(&first_hello, record_with(Some(mark(id, 3))), at(0).mono));
    assert!(aggregator.is_repeated_hello(&first_hello));
    let of_other_process = hello(id, "edge", 2, stream, 4);
    let of_other_stream = hello(id, "edge", 1, StreamId::random(), 4);
    let with_missing_batch = hello(id, "edge", 1, stream, 5);
    for other in [of_other_process, of_other_stream, with_missing_batch] {
        assert!(!aggregator.is_repeated_hello(&other), "{other:?}");
    }
    aggregator.handle_goodbye(id);
    assert!(!aggregator.is_repeated_hello(&first_hello));
}

#[test]
fn hello_with_impossible_batch_numbers_is_refused() {
    let valid_hello = hello(HostId::random(), "edge", 1, StreamId::random(), 1);
    for (first, oldest) in [(0, 0), (0, 1), (5, 4), (u64::MAX, u64::MAX), (1, u64::MAX), (1, 1 << 63)] {
        let invalid_hello = Hello { first, oldest, ..valid_hello.clone() };
        let reason = expect_refusal(receiving().handle_hello(&invalid_hello, record_with(None), at(0).mono));
        assert!(reason.contains("spool of this agent is damaged"), "{reason}");
    }
}

#[test]
fn second_connected_host_of_same_name_is_refused() {
    let (mut aggregator, first, second) = (receiving(), HostId::random(), HostId::random());
    aggregator.handle_hello(&hello(first, "edge", 1, StreamId::random(), 1), record_with(None), at(0).mono);
    let second_hello = hello(second, "edge", 2, StreamId::random(), 1);
    let reason = expect_refusal(aggregator.handle_hello(&second_hello, record_with(None), at(9_000).mono));
    assert!(reason.contains("the name edge") && reason.contains(&first.to_string()), "{reason}");
    // After 10 s of silence the first host no longer counts as connected, so its name is free.
    expect_welcome(&aggregator.handle_hello(&second_hello, record_with(None), at(10_001).mono));
}

#[test]
fn goodbye_frees_name_and_host_id_at_once() {
    let (mut aggregator, id) = (receiving(), HostId::random());
    aggregator.handle_hello(&hello(id, "edge", 1, StreamId::random(), 1), record_with(None), at(0).mono);
    aggregator.handle_goodbye(id);
    expect_welcome(&aggregator.handle_hello(
        &hello(id, "edge", 2, StreamId::random(), 1),
        record_with(None),
        at(1).mono,
    ));
    aggregator.handle_goodbye(id);
    expect_welcome(&aggregator.handle_hello(
        &hello(HostId::random(), "edge", 3, StreamId::random(), 1),
        record_with(None),
        at(2).mono,
    ));
}

#[test]
fn second_process_of_host_is_refused_while_first_lives() {
    let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
    aggregator.handle_hello(&hello(id, "edge", 1, stream, 1), record_with(None), at(0).mono);
    // A cloned machine also has the same stream.
    let copy = hello(id, "edge", 2, stream, 1);
    assert_eq!(aggregator.handle_live(id, at(200).mono), None);
    assert_eq!(aggregator.handle_hello(&copy, record_with(None), at(300).mono), HelloResult::Wait);
    // The first process sends a live update after the hello of the copy, so both processes are alive.
    assert_eq!(aggregator.handle_live(id, at(450).mono), None);
    assert!(
        expect_refusal(aggregator.handle_hello(&copy, record_with(None), at(550).mono))
            .contains("another agent with the host id")
    );
    assert_eq!(aggregator.handle_live(id, at(700).mono), None);
}

#[test]
fn restarted_agent_is_accepted_after_silence_of_crashed_process() {
    let (mut aggregator, id, stream) = (receiving(), HostId::random(), StreamId::random());
    aggregator.handle_hello(&hello(id, "edge", 1, stream, 1), record_with(None), at(0).mono);
    aggregator.handle_live(id, at(200).mono);
    // The new process is accepted when the crashed process has been silent for more than 750 ms.
    let restarted = hello(id, "edge", 2, stream, 1);
    assert_eq!(aggregator.handle_hello(&restarted, record_with(None), at(300).mono), HelloResult::Wait);
    assert_eq!(aggregator.handle_hello(&restarted, record_with(None), at(550).mono), HelloResult::Wait);
    expect_welcome(&aggregator.handle_hello(&restarted, record_with(None), at(1_050).mono));
    // Long after a crash the new process is accepted at once.
    expect_welcome(&aggregator.handle_hello(
        &hello(id, "edge", 3, stream, 1),
        record_with(None),
        at(9_000).mono,
    ));
}

#[test]
fn spool_of_another_host_is_refused() {
    let (mut aggregator, stream, owner) = (receiving(), StreamId::random(), HostId::random());
    let copy = hello(HostId::random(), "edge-2", 2, stream, 1);
    let expected_reason = format!("the spool of this agent belongs to the host with the id {owner}");
    let stored = Some(mark(owner, 5));
    assert!(
        expect_refusal(aggregator.handle_hello(&copy, record_with(stored), at(0).mono))
            .contains(&expected_reason)
    );
    aggregator.handle_hello(&hello(owner, "edge", 1, stream, 1), record_with(None), at(0).mono);
    assert!(
        expect_refusal(aggregator.handle_hello(&copy, record_with(None), at(1).mono))
            .contains(&expected_reason)
    );
}

#[test]
fn deleted_or_replaced_spool_is_reported_once() {
    let (mut aggregator, id) = (receiving(), HostId::random());
    let (old, new) = (StreamId::random(), StreamId::random());
    let replaced = |result| match result {
        HelloResult::Welcome { replaced, .. } => replaced,
        other => panic!("expected a welcome, got {other:?}"),
    };
    let record_of_host = |last_stream| StreamRecord { last_stream, ..StreamRecord::default() };
    let first = hello(id, "edge", 1, old, 1);
    assert_eq!(replaced(aggregator.handle_hello(&first, record_with(None), at(0).mono)), None);
    aggregator.handle_goodbye(id);
    assert_eq!(replaced(aggregator.handle_hello(&first, record_of_host(Some(old)), at(1).mono)), None);
    aggregator.handle_goodbye(id);
    let second = hello(id, "edge", 2, new, 1);
    assert_eq!(replaced(aggregator.handle_hello(&second, record_of_host(Some(old)), at(2).mono)), Some(old));
    assert_eq!(replaced(aggregator.handle_hello(&second, record_of_host(Some(old)), at(3).mono)), None);
    aggregator.handle_goodbye(id);
    // A stream that continues the previous stream replaces nothing. A stream that was used before replaces nothing
    // either.
    let renewed = Hello { previous_stream: Some(old), ..second.clone() };
    assert_eq!(replaced(aggregator.handle_hello(&renewed, record_of_host(Some(old)), at(4).mono)), None);
    aggregator.handle_goodbye(id);
    let stored = StreamRecord { mark: Some(mark(id, 3)), ..record_of_host(Some(old)) };
    assert_eq!(replaced(aggregator.handle_hello(&second, stored, at(5).mono)), None);
    aggregator.handle_goodbye(id);
    let was_used = StreamRecord { was_used: true, ..record_of_host(Some(old)) };
    assert_eq!(replaced(aggregator.handle_hello(&hello(id, "edge", 3, new, 1), was_used, at(6).mono)), None);
}

#[test]
fn batches_missing_in_older_database_are_reported_once() {
    let (mut aggregator, id) = (receiving(), HostId::random());
    let (old, new) = (StreamId::random(), StreamId::random());
    let missing_previous = |result| match result {
        HelloResult::Welcome { missing_previous, .. } => missing_previous,
        other => panic!("expected a welcome, got {other:?}"),
    };
    let renewed = Hello {
        previous_stream: Some(old),
        first: 8,
        events_before_first: Some(7),
        ..hello(id, "edge", 1, new, 8)
    };
    let previous =
        |previous_mark| StreamRecord { last_stream: Some(old), previous_mark, ..StreamRecord::default() };
    let expected =
        |from| Some(MissingPreviousBatches { stream: old, from, through: 7, events: Some(8 - from) });
    for (stored, missing) in [(Some(3), expected(4)), (None, expected(1)), (Some(7), None), (Some(9), None)] {
        let before = previous(stored.map(|stored| mark(id, stored)));
        assert_eq!(missing_previous(aggregator.handle_hello(&renewed, before, at(0).mono)), missing);
        assert_eq!(
            missing_previous(aggregator.handle_hello(&renewed, before, at(1).mono)),
            None,
            "the gap was reported for the previous hello"
        );
        aggregator.handle_goodbye(id);
        let was_used = StreamRecord { was_used: true, ..before };
        assert_eq!(
            missing_previous(aggregator.handle_hello(&renewed, was_used, at(2).mono)),
            None,
            "the stream was used before"
        );
        aggregator.handle_goodbye(id);
    }
    // Batches after the seventh came from the memory of a dead process, and were stored in another database only. The
    // number of these batches is unknown, so `through` equals `from`.
    let renewed = Hello { events_before_first: Some(9), ..renewed };
    let before = previous(Some(mark(id, 7)));
    let expected = MissingPreviousBatches { stream: old, from: 8, through: 8, events: Some(2) };
    assert_eq!(missing_previous(aggregator.handle_hello(&renewed, before, at(3).mono)), Some(expected));
}

#[test]
fn host_that_changes_its_streams_waits_for_writer() {
    let (mut aggregator, id) = (receiving(), HostId::random());
    let mut streams: Vec<StreamId> = Vec::new();
    while let HelloResult::Welcome { missing, .. } =
        aggregator.handle_hello(&hello(id, "edge", 1, StreamId::random(), 5), record_with(None), at(0).mono)
    {
        streams.push(missing.expect("four missing batches").stream);
        assert!(streams.len() < 100, "one host must not fill the memory");
    }
    streams.iter().for_each(|stream| drop(aggregator.handle_stored(*stream, mark(id, 4))));
    let next = hello(id, "edge", 1, StreamId::random(), 1);
    expect_welcome(&aggregator.handle_hello(&next, record_with(None), at(1).mono));
}

#[test]
fn windows_share_aggregators_memory() {
    let mut aggregator = receiving();
    let window = |aggregator: &mut Receiving, n: u64, batch_bytes| {
        let name = format!("edge-{n}");
        let hello = Hello { batch_bytes, ..hello(HostId::random(), &name, n, StreamId::random(), 1) };
        expect_welcome(&aggregator.handle_hello(&hello, record_with(None), at(0).mono)).2
    };
    // All hosts share 64 MiB equally. A window is this share divided by the length of a batch, from 1 to 8. A stated
    // length counts as at most 4 MiB and at least 1 KiB.
    assert_eq!(window(&mut aggregator, 0, 512 * 1024), 8);
    assert_eq!(window(&mut aggregator, 1, 0), 8);
    assert_eq!(window(&mut aggregator, 2, u32::MAX), 5);
    (3..32).for_each(|n| _ = window(&mut aggregator, n, 512 * 1024));
    assert_eq!(window(&mut aggregator, 32, 512 * 1024), 3);
    (33..1_000).for_each(|n| _ = window(&mut aggregator, n, 512 * 1024));
    assert_eq!(window(&mut aggregator, 1_000, 512 * 1024), 1);
    assert_eq!(window(&mut aggregator, 1_001, 1_000), 8);
}
