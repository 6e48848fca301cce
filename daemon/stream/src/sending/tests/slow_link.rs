//! Slow links: live figures stay recent, the link is used, and nothing is lost or repeated.

use super::link::{Link, LinkSettings};
use super::*;

/// Returns the agents' usual configuration.
fn usual_config() -> SendingConfig {
    SendingConfig { window: 4, first_pause: Span::from_seconds(1), ..SendingConfig::default() }
}

/// Returns a text that hardly compresses, because it is different for each event.
fn incompressible_text(n: i64) -> String {
    (0..8).map(|part| ChainHash::START.next(part, &n.to_be_bytes()).to_string()).collect()
}

/// Runs for some seconds. Returns the largest delay of the live figures in milliseconds, and the share of the link's
/// capacity that was used.
fn measure(link: &mut Link, seconds: i64) -> (i64, f64) {
    (link.max_live_delay_ms, link.up.used_us) = (0, 0);
    let queued_before = link.up.busy_until_us - link.agent.millis * 1_000;
    link.run(seconds);
    let queued_after = (link.up.busy_until_us - link.agent.millis * 1_000).max(0);
    (
        link.max_live_delay_ms,
        (link.up.used_us + queued_before.max(0) - queued_after) as f64 / (seconds * 1_000_000) as f64,
    )
}

/// Makes the link fast, and checks that every event is stored exactly once.
fn finish(mut link: Link) {
    (link.up.bytes_per_s, link.settings.events_per_s) = (10_000_000, 0);
    for _ in 0..20 {
        link.run(10);
        if link.agent.accounting().waiting == 0 {
            break;
        }
    }
    let accounting = link.agent.accounting();
    assert_eq!(
        (accounting.waiting, accounting.dropped, accounting.stored),
        (0, 0, link.stored),
        "{accounting:?}"
    );
    assert_eq!((link.repeated, link.hellos), (0, 1), "(repeated batches, hellos)");
}

#[test]
fn live_figures_stay_recent_on_slow_link() {
    // Bytes per second; then in milliseconds the one-way delay, and the largest allowed delay of the live figures.
    for (rate, delay, max_delay_ms) in [
        (6_250, 0, 1_500),
        (6_250, 300, 3_000),
        (12_500, 100, 1_500),
        (62_500, 20, 900),
        (62_500, 300, 2_500),
    ] {
        for offline in [0, 60] {
            // There are more events than the link carries: each event takes more than 60 bytes on the link. After the
            // time offline, there is also a backlog of batches of the largest size.
            let settings = LinkSettings {
                bytes_per_s: rate,
                one_way_ms: delay,
                step_ms: 5,
                commit_ms: 60,
                busy_ms: 0,
                is_flow_controlled: true,
                events_per_s: if offline > 0 { 2_000 } else { rate / 60 },
                text: incompressible_text,
            };
            let mut link = Link::new(usual_config(), settings);
            link.run(offline);
            link.settings.events_per_s = rate / 60;
            link.connect();
            link.run(8);
            let (live_delay_ms, used_share) = measure(&mut link, 100);
            println!(
                "{rate} B/s, {delay} ms, {offline} s offline: {live_delay_ms} ms behind, {used_share:.2} in use"
            );
            assert!(
                live_delay_ms <= max_delay_ms,
                "{rate} B/s, {delay} ms, {offline} s offline: {live_delay_ms} ms behind"
            );
            assert!(used_share >= 0.8, "{rate} B/s, {delay} ms, {offline} s offline: {used_share} in use");
            assert!(link.agent.accounting().compressed, "compression started");
            finish(link);
        }
    }
}
