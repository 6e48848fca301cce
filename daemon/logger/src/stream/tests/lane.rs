//! The agent's end alone.

use super::*;

const ROOMY: Usage = Usage { events: 1000, bytes: 1_000_000 };

fn sending(most: Usage) -> Sending<MemorySpool> {
    Sending::new(config(), host(HostId::random(), "edge"), 7, MemorySpool::new(most))
}

fn welcome(sending: &Sending<MemorySpool>, stored: u64) -> ToAgent {
    let aggregator = "base".parse().expect("a name");
    ToAgent::Welcome { aggregator, stream: sending.spool().stream(), stored }
}

fn ack(sending: &Sending<MemorySpool>, through: u64) -> ToAgent {
    ToAgent::Ack { stream: sending.spool().stream(), through }
}

/// Connected and welcomed at time 0, holding `events` events in batches of three.
fn up(events: usize) -> Sending<MemorySpool> {
    let mut sending = sending(ROOMY);
    (0..events).for_each(|n| sending.offer(&incident(&n.to_string()), at(0)));
    sending.flush(at(0).wall);
    sending.connected(at(0).mono);
    assert!(matches!(frames(&mut sending, at(0))[..], [ToAggregator::Hello(_)]));
    let welcome = welcome(&sending, 0);
    assert!(matches!(sending.received(&welcome, at(0)), Ok(Some(Notice::Welcomed { stored: 0, .. }))));
    sending
}

#[test]
fn batches_are_cut_by_size_and_by_age() {
    let mut sending = sending(ROOMY);
    for n in 0..4 {
        sending.offer(&incident(&n.to_string()), at(n));
    }
    assert_eq!(sending.spool().newest(), 1);
    assert_eq!(sending.deadline(), Some(at(203).mono));
    sending.tick(at(202));
    assert_eq!(sending.spool().newest(), 1);
    sending.tick(at(203));
    assert_eq!((sending.spool().newest(), sending.deadline()), (2, None));
}

#[test]
fn no_more_than_a_window_is_under_way_and_acknowledgements_move_it() {
    let mut sending = up(15);
    assert_eq!(numbers(&frames(&mut sending, at(1))), [1, 2, 3]);
    assert_eq!(numbers(&frames(&mut sending, at(2))), [0; 0]);
    let ack = ack(&sending, 2);
    sending.received(&ack, at(3)).expect("memory");
    assert_eq!(numbers(&frames(&mut sending, at(3))), [4, 5]);
    let Accounting { offered, stored, waiting, dropped, .. } = sending.accounting();
    assert_eq!((offered, stored, waiting, dropped), (15, 6, 9, 0));
}

#[test]
fn what_is_given_up_is_counted_and_what_comes_then_goes_at_once() {
    let mut sending = up(15);
    assert_eq!(numbers(&frames(&mut sending, at(1))), [1, 2, 3]);
    let first = ack(&sending, 1);
    sending.received(&first, at(2)).expect("memory");
    assert_eq!(sending.give_up(at(3)), Ok(12));
    sending.offer(&incident("the end"), at(3));
    sending.flush(at(3).wall);
    assert!(matches!(&frames(&mut sending, at(3))[..], [ToAggregator::Hello(hello)] if hello.oldest == 6));
    let welcome = welcome(&sending, 2);
    sending.received(&welcome, at(4)).expect("memory");
    assert_eq!(numbers(&frames(&mut sending, at(4))), [6]);
    let last = ack(&sending, 6);
    sending.received(&last, at(5)).expect("memory");
    let Accounting { offered, stored, waiting, dropped, .. } = sending.accounting();
    assert_eq!((offered, stored, waiting, dropped), (16, 4, 0, 12));
}

#[test]
fn silence_is_answered_by_a_new_hello_and_everything_under_way_goes_again() {
    let mut sending = up(6);
    assert_eq!(numbers(&frames(&mut sending, at(100))), [1, 2]);
    assert_eq!(sending.deadline(), Some(at(10_100).mono));
    sending.tick(at(10_100));
    assert!(matches!(frames(&mut sending, at(10_100))[..], [ToAggregator::Hello(_)]));
    let welcome = welcome(&sending, 1);
    sending.received(&welcome, at(10_101)).expect("memory");
    assert_eq!(numbers(&frames(&mut sending, at(10_101))), [2]);
}

#[test]
fn hellos_are_repeated_with_growing_pauses_and_a_refusal_lengthens_them() {
    let mut sending = sending(ROOMY);
    sending.connected(at(0).mono);
    let mut hellos = Vec::new();
    for now in 0..2000 {
        hellos.extend(frames(&mut sending, at(now)).iter().map(|_| now));
    }
    assert_eq!(hellos, [0, 250, 750, 1750]);
    let refused = ToAgent::Refused { reason: "the name is taken".into() };
    let notice = sending.received(&refused, at(2000)).expect("memory");
    assert_eq!(notice, Some(Notice::Refused("the name is taken".into())));
    assert_eq!(sending.deadline(), Some(at(6000).mono));
    assert_eq!(sending.goodbye(), None);
}

#[test]
fn an_aggregator_that_forgot_us_is_told_again() {
    let mut sending = up(3);
    assert_eq!(numbers(&frames(&mut sending, at(1))), [1]);
    sending.received(&ToAgent::Unknown, at(2)).expect("memory");
    let [ToAggregator::Hello(hello)] = &frames(&mut sending, at(2))[..] else { panic!("a hello") };
    assert_eq!((hello.oldest, hello.process, hello.protocol), (1, 7, PROTOCOL));
    sending.received(&ToAgent::Unknown, at(3)).expect("memory");
    assert!(frames(&mut sending, at(3)).is_empty());
}

#[test]
fn missing_batches_go_again_and_those_no_longer_here_are_told_of_by_a_hello() {
    let mut sending = up(9);
    frames(&mut sending, at(1));
    let stream = sending.spool().stream();
    sending.received(&ToAgent::Resend { stream, from: 2 }, at(2)).expect("memory");
    assert_eq!(numbers(&frames(&mut sending, at(2))), [2, 3]);
    let ack = ack(&sending, 2);
    sending.received(&ack, at(3)).expect("memory");
    sending.received(&ToAgent::Resend { stream, from: 1 }, at(4)).expect("memory");
    let [ToAggregator::Hello(hello)] = &frames(&mut sending, at(4))[..] else { panic!("a hello") };
    assert_eq!(hello.oldest, 3);
}

#[test]
fn a_stream_that_is_ahead_over_there_is_left_with_everything_it_held() {
    let mut sending = up(6);
    let (old, ahead) = (sending.spool().stream(), welcome(&sending, 9));
    sending.received(&ToAgent::Unknown, at(1)).expect("memory");
    let notice = sending.received(&ahead, at(1)).expect("memory");
    assert_eq!(notice, Some(Notice::StreamRenewed { stored: 9, newest: 2 }));
    assert_ne!(sending.spool().stream(), old);
    assert!(matches!(frames(&mut sending, at(1))[..], [ToAggregator::Hello(_)]));
    // The same answer once more is about a stream that is no longer ours.
    assert_eq!(sending.received(&ahead, at(2)), Ok(None));
    let welcome = welcome(&sending, 0);
    sending.received(&welcome, at(3)).expect("memory");
    assert_eq!(numbers(&frames(&mut sending, at(3))), [1, 2]);
    assert_eq!(sending.accounting().waiting, 6);
}
