//! The aggregator's end alone: who gets in, what becomes of a batch.

use super::*;

fn hello(id: HostId, name: &str, process: u64, stream: StreamId, oldest: u64) -> Hello {
    Hello { protocol: PROTOCOL, host: host(id, name), stream, oldest, process }
}

fn reason(greeting: Greeting) -> String {
    match greeting {
        Greeting::Refused { reply: ToAgent::Refused { reason: said }, reason } if said == reason => reason,
        other => panic!("expected a refusal, got {other:?}"),
    }
}

fn welcomed(greeting: &Greeting) -> u64 {
    match greeting {
        Greeting::Welcome { reply: ToAgent::Welcome { stored, .. }, missing: None } => *stored,
        other => panic!("expected a welcome, got {other:?}"),
    }
}

#[test]
fn batches_are_accepted_in_order_and_acknowledged_when_stored() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    assert_eq!(welcomed(&end.hello(&hello(id, "edge", 1, stream, 3), 2, at(0).mono)), 2);
    let now = at(1).mono;
    assert_eq!(end.batch(id, stream, 3, now), Arrival::Accept);
    assert_eq!(end.batch(id, stream, 3, now), Arrival::Pending);
    assert_eq!(end.batch(id, stream, 4, now), Arrival::Accept);
    assert_eq!(end.stored(stream, 3), Some((id, ToAgent::Ack { stream, through: 3 })));
    assert_eq!(end.batch(id, stream, 1, now), Arrival::Duplicate(ToAgent::Ack { stream, through: 3 }));
    assert_eq!(end.batch(id, stream, 4, now), Arrival::Pending);
}

#[test]
fn a_hole_is_asked_for_once() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    end.hello(&hello(id, "edge", 1, stream, 1), 0, at(0).mono);
    let now = at(1).mono;
    assert_eq!(end.batch(id, stream, 2, now), Arrival::Hole(Some(ToAgent::Resend { stream, from: 1 })));
    assert_eq!(end.batch(id, stream, 3, now), Arrival::Hole(None));
    assert_eq!(end.batch(id, stream, 1, now), Arrival::Accept);
    assert_eq!(end.batch(id, stream, 3, now), Arrival::Hole(Some(ToAgent::Resend { stream, from: 2 })));
}

#[test]
fn a_failed_write_is_asked_for_again_with_all_that_followed() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    end.hello(&hello(id, "edge", 1, stream, 1), 0, at(0).mono);
    let now = at(1).mono;
    (1..=3).for_each(|number| assert_eq!(end.batch(id, stream, number, now), Arrival::Accept));
    end.stored(stream, 1);
    assert_eq!(end.failed(stream), Some((id, ToAgent::Resend { stream, from: 2 })));
    assert_eq!(end.batch(id, stream, 2, now), Arrival::Accept);
}

#[test]
fn what_the_agent_no_longer_holds_is_reported_missing_once() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    let hello = hello(id, "edge", 1, stream, 8);
    let Greeting::Welcome { missing, .. } = end.hello(&hello, 3, at(0).mono) else { panic!("welcome") };
    assert_eq!(missing, Some(Missing { host: id, stream, from: 4, through: 7 }));
    assert_eq!(welcomed(&end.hello(&hello, 3, at(1).mono)), 3);
    assert_eq!(end.batch(id, stream, 8, at(2).mono), Arrival::Accept);
    assert_eq!(end.stored(stream, 7), Some((id, ToAgent::Ack { stream, through: 7 })));
}

#[test]
fn strangers_are_asked_to_say_hello() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    assert_eq!(end.live(id, at(0).mono), Some(ToAgent::Unknown));
    assert_eq!(end.batch(id, stream, 1, at(0).mono), Arrival::Unknown(ToAgent::Unknown));
    end.hello(&hello(id, "edge", 1, stream, 1), 0, at(0).mono);
    assert_eq!(end.batch(id, StreamId::random(), 1, at(0).mono), Arrival::Unknown(ToAgent::Unknown));
    assert_eq!(end.live(id, at(0).mono), None);
    end.forget_silent(Span::from_seconds(60), at(60_001).mono);
    assert_eq!(end.live(id, at(60_001).mono), Some(ToAgent::Unknown));
}

#[test]
fn another_version_is_refused_with_both_numbers() {
    let mut other = hello(HostId::random(), "edge", 1, StreamId::random(), 1);
    other.protocol = 99;
    let reason = reason(receiving().hello(&other, 0, at(0).mono));
    assert!(reason.contains("version 99") && reason.contains(&format!("version {PROTOCOL}")), "{reason}");
}

#[test]
fn two_hosts_cannot_have_one_name_while_both_are_there() {
    let (mut end, first, second) = (receiving(), HostId::random(), HostId::random());
    end.hello(&hello(first, "edge", 1, StreamId::random(), 1), 0, at(0).mono);
    let late = hello(second, "edge", 2, StreamId::random(), 1);
    let reason = reason(end.hello(&late, 0, at(9_000).mono));
    assert!(reason.contains("the name edge") && reason.contains(&first.to_string()), "{reason}");
    welcomed(&end.hello(&late, 0, at(10_001).mono));
}

#[test]
fn a_goodbye_frees_name_and_host_id_at_once() {
    let (mut end, id) = (receiving(), HostId::random());
    end.hello(&hello(id, "edge", 1, StreamId::random(), 1), 0, at(0).mono);
    end.goodbye(id);
    welcomed(&end.hello(&hello(id, "edge", 2, StreamId::random(), 1), 0, at(1).mono));
    end.goodbye(id);
    welcomed(&end.hello(&hello(HostId::random(), "edge", 3, StreamId::random(), 1), 0, at(2).mono));
}

#[test]
fn a_second_process_with_the_same_host_id_is_refused_while_the_first_lives() {
    let (mut end, id) = (receiving(), HostId::random());
    end.hello(&hello(id, "edge", 1, StreamId::random(), 1), 0, at(0).mono);
    let copy = hello(id, "edge", 2, StreamId::random(), 1);
    assert_eq!(end.live(id, at(200).mono), None);
    assert_eq!(end.hello(&copy, 0, at(300).mono), Greeting::Wait);
    assert_eq!(end.live(id, at(450).mono), None);
    assert!(reason(end.hello(&copy, 0, at(550).mono)).contains("another agent with the host id"));
    assert_eq!(end.live(id, at(700).mono), None);
}

#[test]
fn a_crashed_agent_gets_in_as_soon_as_its_silence_shows() {
    let (mut end, id, stream) = (receiving(), HostId::random(), StreamId::random());
    end.hello(&hello(id, "edge", 1, stream, 1), 0, at(0).mono);
    assert_eq!(end.batch(id, stream, 1, at(200).mono), Arrival::Accept);
    let again = hello(id, "edge", 2, stream, 1);
    assert_eq!(end.hello(&again, 0, at(300).mono), Greeting::Wait);
    assert_eq!(end.hello(&again, 0, at(550).mono), Greeting::Wait);
    welcomed(&end.hello(&again, 0, at(1_050).mono));
    // What the first process sent is about to be stored; the second sends it again.
    assert_eq!(end.batch(id, stream, 1, at(1_060).mono), Arrival::Pending);
    // Long after a crash nothing is waited for.
    welcomed(&end.hello(&hello(id, "edge", 3, stream, 1), 0, at(9_000).mono));
}

#[test]
fn a_copied_spool_is_refused() {
    let (mut end, stream) = (receiving(), StreamId::random());
    end.hello(&hello(HostId::random(), "edge", 1, stream, 1), 0, at(0).mono);
    let copy = hello(HostId::random(), "edge-2", 2, stream, 1);
    assert!(reason(end.hello(&copy, 0, at(1).mono)).contains("the spool of this agent belongs to"));
}
