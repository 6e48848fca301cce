//! Tests of the durable lane's effect on the picture: it changes counts only.

use super::*;
use crate::picture::{Arrivals, Totals};

/// Applies 40 updates of a pipeline within ten seconds; with a `backlog`, also events of the durable lane between them.
fn figures(bed: &mut Bed, backlog: bool) -> Picture {
    for step in 0..40 {
        let at = 0.25 * f64::from(step);
        let second = second(at as i64, &[0.010 + 0.001 * f64::from(step % 7), 0.012], u64::from(step == 3));
        let mut accounting = Accounting::default();
        if backlog {
            accounting = Accounting {
                produced: 5_000_000,
                stored: 10_000 * step as u64,
                waiting: 5_000_000 - 10_000 * step as u64,
                oldest: Some(wall(-80_000.0 + 100.0 * at)),
                ..accounting
            };
            for batch in 0..200 {
                let events = u64::try_from(step * 200 + batch).expect("positive");
                let stored = Stored { events, nodes: 12 * events, ..Stored::default() };
                bed.live.take(News::Stored(bed.host, stored, Some(wall(-80_000.0 + 100.0 * at))), now(at));
                bed.live.take(News::Duplicate(bed.host), now(at));
                bed.live.take(News::Deferred(bed.host), now(at));
                bed.live.take(News::Run(bed.host, RunId::random(), 7), now(at));
            }
        }
        let news = update(bed.host, wall(at), vec![pipeline("line", vec![second])]);
        bed.live.take(with(news, accounting), now(at));
    }
    bed.picture(9.8)
}

#[test]
fn a_backlog_changes_no_figure_of_the_picture() {
    let (mut calm, mut busy) = (Bed::new(), Bed::new());
    busy.host = calm.host;
    busy.live = Live::new(slug("here"), "tcp://127.0.0.1:5550".into(), Span::from_seconds(3_600));
    busy.live.take(News::Hello(Box::new(description(busy.host, "edge")), 1), now(0.0));
    let (calm, busy) = (figures(&mut calm, false), figures(&mut busy, true));
    let text =
        |picture: &Picture| serde_json::to_string(&(&picture.pipelines, &picture.links)).expect("plain data");
    assert_eq!(text(&calm), text(&busy));
    assert_eq!((calm.hosts[0].behind, calm.hosts[0].catching_up), (None, None));
    let host = &busy.hosts[0];
    assert_eq!(host.behind, Some(Span::from_seconds_f64(80_000.0 - 99.0 * 9.75)));
    let found = host.catching_up.expect("it falls by 99 s a second");
    assert!(
        (found.rate - 99.0).abs() < 0.1 && (found.events_per_second - 40_000.0).abs() < 40.0,
        "{found:?}"
    );
}

#[test]
fn totals_hold_hosts_that_left_and_never_fall() {
    let mut bed = Bed::new();
    let (gone, stranger) = (HostId::random(), HostId::random());
    let stored =
        |events| Stored { events, nodes: 10 * events, quarantined: events / 100, ..Stored::default() };
    bed.live.take(News::Stored(gone, stored(100), None), now(0.0));
    assert_eq!(bed.live.picture(now(0.0)).absent, 1, "it is known, and nothing was heard of it");
    bed.live.take(News::Hello(Box::new(description(gone, "gone")), 1), now(0.0));
    assert_eq!(bed.live.picture(now(0.0)).absent, 0);
    bed.live.take(News::Hello(Box::new(description(stranger, "stranger")), 1), now(0.0));
    bed.live.take(News::Stored(gone, stored(150), None), now(1.0));
    bed.live.take(News::Damaged(bed.host), now(1.0));
    bed.send(3_500.0, vec![]);
    bed.live.age(now(3_601.0));
    let picture = bed.picture(3_601.0);
    assert_eq!((picture.hosts.len(), picture.absent), (1, 1), "the others left the picture, one is known");
    let expected = |events, damaged| Totals {
        stored: Stored { quarantined: 1, ..stored(events) },
        arrivals: Arrivals { deferred: 0, damaged },
        ..Totals::default()
    };
    assert_eq!(picture.totals, expected(150, 1));
    assert_eq!(picture.hosts[0].arrivals.damaged, 1);
    // The host returns; the counts stored before are not added again.
    bed.live.take(News::Hello(Box::new(description(gone, "gone")), 1), now(3_602.0));
    bed.live.take(News::Stored(gone, stored(160), None), now(3_602.0));
    let picture = bed.picture(3_602.0);
    assert_eq!(picture.totals, expected(160, 1));
    assert_eq!(picture.hosts.iter().map(|host| host.stored.events).max(), Some(160));
}

#[test]
fn a_host_that_is_away_catches_up_no_more() {
    let mut bed = Bed::new();
    figures(&mut bed, true);
    assert!(bed.picture(9.8).hosts[0].catching_up.is_some());
    bed.live.take(News::Goodbye(bed.host), now(9.9));
    let picture = bed.picture(9.9);
    assert_eq!(picture.hosts[0].catching_up, None);
    assert!(picture.hosts[0].behind.is_some(), "what it last told stays");
}
