//! How often each source is answered.

use std::net::SocketAddr;

use peernet_clock::{MonoTime, Span};
use peernet_probes::stamp::limiter::Limiter;

fn source(text: &str) -> SocketAddr {
    text.parse().expect("an address")
}

fn allowed(limiter: &mut Limiter, source: SocketAddr, now: MonoTime, asked: usize) -> usize {
    (0..asked).filter(|_| limiter.allows(source, now)).count()
}

#[test]
fn a_source_has_one_seconds_worth_and_then_its_rate() {
    let mut limiter = Limiter::new(20);
    let (one, start) = (source("10.0.0.1:1000"), MonoTime::from_nanos(5));
    assert_eq!(allowed(&mut limiter, one, start, 100), 20);
    let mut later = start;
    let mut sum = 0;
    for _ in 0..100 {
        later = later + Span::from_millis(100);
        sum += allowed(&mut limiter, one, later, 50);
    }
    assert_eq!(sum, 200, "ten seconds at twenty a second");
    assert_eq!(allowed(&mut limiter, one, later + Span::from_seconds(3600), 100), 20, "no more is saved up");
}

#[test]
fn ports_share_and_addresses_do_not() {
    let mut limiter = Limiter::new(5);
    let now = MonoTime::from_nanos(0);
    assert_eq!(allowed(&mut limiter, source("10.0.0.1:1000"), now, 9), 5);
    assert_eq!(allowed(&mut limiter, source("10.0.0.1:2000"), now, 9), 0);
    assert_eq!(
        allowed(&mut limiter, source("[::ffff:10.0.0.1]:2000"), now, 9),
        0,
        "the same in other clothes"
    );
    assert_eq!(allowed(&mut limiter, source("10.0.0.2:1000"), now, 9), 5);
    assert_eq!(allowed(&mut limiter, source("[2001:db8::1]:1"), now, 9), 5);
    assert_eq!(allowed(&mut limiter, source("[2001:db8::ffff:1]:1"), now, 9), 0, "one network, one source");
    assert_eq!(allowed(&mut limiter, source("[2001:db8:0:1::1]:1"), now, 9), 5);
}

#[test]
fn a_crowd_of_sources_locks_nobody_out_and_does_not_free_who_keeps_asking() {
    let mut limiter = Limiter::new(5);
    let flood = source("10.0.0.1:1");
    let now = MonoTime::from_nanos(0);
    assert_eq!(allowed(&mut limiter, flood, now, 9), 5);
    for forged in 0..100_000u32 {
        let forged = SocketAddr::from((std::net::Ipv4Addr::from(0x0B00_0000 + forged), 7));
        assert!(limiter.allows(forged, now), "each has a bucket of its own");
        assert!(!limiter.allows(flood, now), "it is remembered as long as it asks");
    }
    assert_eq!(allowed(&mut limiter, source("10.9.9.9:1"), now, 9), 5);
}
