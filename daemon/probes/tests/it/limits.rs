//! Tests of the rates at which a reflector answers.

use std::net::{IpAddr, Ipv4Addr};

use peernet_clock::{MonoTime, Span};
use peernet_probes::Refusal;
use peernet_probes::stamp::limiter::Limiter;
use proptest::prelude::*;

fn address(text: &str) -> IpAddr {
    text.parse().expect("an address")
}

fn forged_address(number: u32) -> IpAddr {
    Ipv4Addr::from(0x0B00_0000 + number).into()
}

fn admitted_count(limiter: &mut Limiter, address: IpAddr, now: MonoTime, requests: usize) -> usize {
    (0..requests).filter(|_| limiter.admit(address, now).is_ok()).count()
}

#[test]
fn source_is_limited_after_burst_of_one_second() {
    let mut limiter = Limiter::new(20);
    let (source, start) = (address("10.0.0.1"), MonoTime::from_nanos(5));
    assert_eq!(admitted_count(&mut limiter, source, start, 100), 20);
    let mut now = start;
    let mut total_admitted = 0;
    for _ in 0..100 {
        now = now + Span::from_millis(100);
        total_admitted += admitted_count(&mut limiter, source, now, 50);
    }
    assert_eq!(total_admitted, 200, "ten seconds at twenty a second");
    assert_eq!(
        admitted_count(&mut limiter, source, now + Span::from_seconds(3600), 100),
        20,
        "a bucket holds the tokens of one second"
    );
}

#[test]
fn ipv6_network_counts_as_one_source() {
    let mut limiter = Limiter::new(5);
    let now = MonoTime::from_nanos(0);
    assert_eq!(admitted_count(&mut limiter, address("10.0.0.1"), now, 9), 5);
    assert_eq!(
        admitted_count(&mut limiter, address("::ffff:10.0.0.1"), now, 9),
        0,
        "the same address in another form"
    );
    assert_eq!(admitted_count(&mut limiter, address("10.0.0.2"), now, 9), 5);
    assert_eq!(admitted_count(&mut limiter, address("2001:db8::1"), now, 9), 5);
    assert_eq!(
        admitted_count(&mut limiter, address("2001:db8::ffff:1"), now, 9),
        0,
        "one network, one source"
    );
    assert_eq!(admitted_count(&mut limiter, address("2001:db8:0:1::1"), now, 9), 5);
}

#[test]
fn forged_sources_share_one_rate() {
    let mut limiter = Limiter::new(5);
    let now = MonoTime::from_nanos(0);
    let answered = (0..100_000).filter(|number| limiter.admit(forged_address(*number), now).is_ok()).count();
    assert_eq!(answered, 50, "ten times the rate of one source");
    assert_eq!(limiter.admit(address("10.9.9.9"), now), Err(Refusal::TooMany));
}

#[test]
fn reopened_sessions_do_not_refill_the_bucket() {
    let mut limiter = Limiter::new(5);
    let (peer, now) = (address("10.0.0.1"), MonoTime::from_nanos(0));
    for _ in 0..3 {
        limiter.set_peers(&[peer]);
        admitted_count(&mut limiter, peer, now, 9);
        assert_eq!(limiter.admit(peer, now), Err(Refusal::TooOften));
        limiter.set_peers(&[]);
        assert_eq!(limiter.admit(peer, now), Err(Refusal::TooOften));
    }
}

proptest! {
    /// A peer with a session that asks at its rate is always answered, whatever forged sources send.
    #[test]
    fn peers_are_answered_during_any_flood(
        rate in 1u32..200,
        flood in proptest::collection::vec((0u32..20_000, 0usize..40), 1..300),
    ) {
        let mut limiter = Limiter::new(rate);
        let peer = address("192.0.2.1");
        limiter.set_peers(&[peer]);
        let interval = Span::from_nanos(1_000_000_000 / i64::from(rate));
        let mut now = MonoTime::from_nanos(0);
        for (source, count) in flood {
            for number in 0..count {
                let _ = limiter.admit(forged_address(source + number as u32), now);
            }
            prop_assert_eq!(limiter.admit(peer, now), Ok(()));
            now = now + interval;
        }
    }

    /// Neither one source nor all sources without a session together get more than one second's replies beyond their
    /// rate.
    #[test]
    fn replies_never_exceed_the_rates(
        rate in 1u32..50,
        arrivals in proptest::collection::vec((0u32..6, 0i64..20_000_000, any::<bool>()), 1..2000),
    ) {
        let mut limiter = Limiter::new(rate);
        let mut now = MonoTime::from_nanos(0);
        let mut replies: Vec<(u32, bool, MonoTime)> = Vec::new();
        for (source, pause, is_peer) in arrivals {
            now = now + Span::from_nanos(pause);
            // Sessions are opened and closed in between.
            if source == 0 {
                let peers = [forged_address(0)];
                limiter.set_peers(&peers[..usize::from(is_peer)]);
            }
            let has_session = limiter.is_peer(forged_address(source));
            if limiter.admit(forged_address(source), now).is_ok() {
                replies.push((source, has_session, now));
            }
        }
        let seconds = (now - MonoTime::from_nanos(0)).seconds();
        for source in 0..6 {
            let count = replies.iter().filter(|reply| reply.0 == source).count();
            prop_assert!(count as f64 <= f64::from(rate) * (1.0 + seconds) + 1.0, "{source}: {count}");
        }
        let sessionless_replies = replies.iter().filter(|reply| !reply.1).count();
        let max_replies = f64::from(rate * 10) * (1.0 + seconds) + 1.0;
        prop_assert!(sessionless_replies as f64 <= max_replies, "{sessionless_replies}");
    }
}
