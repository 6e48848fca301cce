//! Slow links: live figures stay recent, the link is used, and nothing is lost or repeated.

use super::link::{Link, LinkSettings};
use super::*;

fn usual() -> SendingConfig {
    SendingConfig { window: 4, first_pause: Span::from_seconds(1), ..SendingConfig::default() }
}

/// Returns a text that hardly compresses, because it is different for each event.
fn news(n: i64) -> String {
    (0..8).map(|part| Chain::START.next(part, &n.to_be_bytes()).to_string()).collect()
}

/// Runs for some seconds. Returns the largest delay of the live figures, and the used share of the link.
fn watch(link: &mut Link, seconds: i64) -> (i64, f64) {
    (link.behind, link.up.used_us) = (0, 0);
    let queued = link.up.busy_us - link.agent.millis * 1_000;
    link.run(seconds);
    let left = (link.up.busy_us - link.agent.millis * 1_000).max(0);
    (link.behind, (link.up.used_us + queued.max(0) - left) as f64 / (seconds * 1_000_000) as f64)
}

/// Makes the link fast, and checks that every event arrives exactly once.
fn finish(mut link: Link) {
    (link.up.bytes_per_s, link.setting.events_per_s) = (10_000_000, 0);
    for _ in 0..20 {
        link.run(10);
        if link.agent.accounting().waiting == 0 {
            break;
        }
    }
    let is = link.agent.accounting();
    assert_eq!((is.waiting, is.dropped, is.stored), (0, 0, link.stored), "{is:?}");
    assert_eq!((link.repeated, link.hellos), (0, 1), "(batches, greetings) that came again");
}

#[test]
fn live_updates_stay_fresh_on_slow_link() {
    // Bytes per second, one-way delay, and largest delay of the live figures, both in milliseconds.
    for (rate, delay, most) in [
        (6_250, 0, 1_500),
        (6_250, 300, 3_000),
        (12_500, 100, 1_500),
        (62_500, 20, 900),
        (62_500, 300, 2_500),
    ] {
        for offline in [0, 60] {
            // More events than the link carries, and a backlog of batches of the largest size.
            let setting = LinkSettings {
                bytes_per_s: rate,
                one_way: delay,
                step: 5,
                commit: 60,
                deaf: 0,
                controlled: true,
                events_per_s: if offline > 0 { 2_000 } else { rate / 60 },
                text: news,
            };
            let mut link = Link::new(usual(), setting);
            link.run(offline);
            link.setting.events_per_s = rate / 60;
            link.connect();
            link.run(8);
            let (behind, used) = watch(&mut link, 100);
            println!("{rate} B/s, {delay} ms, {offline} s offline: {behind} ms behind, {used:.2} in use");
            assert!(behind <= most, "{rate} B/s, {delay} ms, {offline} s offline: {behind} ms behind");
            assert!(used >= 0.8, "{rate} B/s, {delay} ms, {offline} s offline: {used} in use");
            assert!(link.agent.accounting().compressed, "compression came on");
            finish(link);
        }
    }
}
