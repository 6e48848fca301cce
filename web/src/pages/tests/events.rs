//! Tests of the counts of events on pages, in every state that an agent's events may be in.

use super::*;

#[tokio::test]
async fn event_counts_of_each_state_are_shown() {
    let (app, _folder) = samples::app().await;
    let mut reported = host("cam-1", "Orin");
    reported.accounting = samples::accounting();
    reported.behind = Some(Span::from_seconds(11_520));
    reported.catching_up = Some(peernet_aggregator::CatchingUp {
        rate: 48.0,
        events_per_second: 20_100.0,
        remaining: Span::from_seconds(240),
    });
    reported.newest_stored = Some(samples::NOW);
    reported.rejected_batches = peernet_aggregator::RejectedBatches { deferred: 7, damaged: 2 };
    let mut broken = host("cam-2", "Orin");
    broken.accounting = peernet_stream::Accounting {
        trouble: Some(HOSTILE.into()),
        compressed: true,
        spool_bytes: 1 << 31,
        ..samples::accounting()
    };
    let live_state = snapshot(vec![reported, broken, host("cam-3", "Orin")], Vec::new());
    let part = |name: &str, part_id: &str| {
        let update = host::update(&app, &live_state, name).expect("renders");
        let (_, html) = update.parts.into_iter().find(|(id, _)| *id == part_id).expect("the part");
        check(&html);
        html
    };
    let html = part("cam-1", "accounting");
    for text in [
        "1,204,500",
        // 1,204,370 spooled events minus 1,203,000 sent events.
        "1,370 not yet",
        "catching up</span><span>3\u{202f}h 12\u{202f}min behind, about 4\u{202f}min left at 20,100 events/s",
        "312\u{202f}MB of 1.07\u{202f}GB",
        "because the agent&#39;s spool was full, or lost when the agent was killed; <a href=\"/incidents\">see 1 gap</a>",
        // 312 MB of 1.07 GB.
        "width=\"29.",
    ] {
        assert!(html.contains(text), "{text} is missing: {html}");
    }
    let html = part("cam-1", "stored");
    assert!(
        html.contains("7 batches while the queue was full, requested again")
            && html.contains("19 Nov 2026, 12:01:07 by the host&#39;s clock"),
        "{html}"
    );
    let html = part("cam-2", "accounting");
    assert!(
        html.contains("wait for the link or the aggregator")
            && html.contains("spool full")
            && html.contains("meter bad"),
        "{html}"
    );
    let html = part("cam-3", "accounting");
    assert!(html.contains("not known yet") && html.contains("nothing waits"), "{html}");
    let update = hosts::update(&app, &live_state).expect("renders");
    let (_, html) = update.parts.iter().find(|(id, _)| *id == "events").expect("the part");
    check(html);
    assert!(html.contains("spool fails") && html.contains("11,520.0"), "{html}");
    let html = overview_of(&live_state, Vec::new()).await;
    assert!(html.contains(">cam-2:</a> the spool cannot be used: "), "{html}");
}

#[tokio::test]
async fn overview_notes_remarks_that_need_attention() {
    let (app, _folder) = samples::app().await;
    let mut late = host("cam-1", "Orin");
    late.accounting = peernet_stream::Accounting { spool_bytes: 1 << 30, ..samples::accounting() };
    late.behind = Some(Span::from_seconds(11_520));
    late.catching_up = Some(peernet_aggregator::CatchingUp {
        rate: 48.0,
        events_per_second: 20_100.0,
        remaining: Span::from_seconds(240),
    });
    let live_state = snapshot(vec![late], Vec::new());
    let update = host::update(&app, &live_state, "cam-1").expect("renders");
    let (_, host_page) = update.parts.iter().find(|(id, _)| *id == "accounting").expect("the part");
    let overview = overview_of(&live_state, Vec::new()).await;
    assert!(overview.contains(", 2 to look at</h1>"), "{overview}");
    let notes = overview.split_once("<ul class=\"notes\">").expect("notes").1;
    let notes = notes.split_once("</ul>").expect("an end").0;
    for (word, needs_attention) in [("spool full", true), ("lost", true), ("catching up", false)] {
        let chip = format!("</svg>{word}</span>");
        assert!(host_page.contains(&chip), "{word}: {host_page}");
        assert_eq!(notes.contains(&chip), needs_attention, "{word}: {notes}");
    }
}

#[tokio::test]
async fn dot_of_host_has_tone_of_its_notes() {
    let mut lossy = host("cam-1", "Orin");
    lossy.accounting = samples::accounting();
    (lossy.connected, lossy.has_left) = (false, true);
    for (noted, word) in [(lossy, "lost"), (busy_host(), "busy")] {
        let html = overview_of(&snapshot(vec![noted], Vec::new()), Vec::new()).await;
        assert!(html.contains(", 1 to look at</h1>"), "{html}");
        let row = html.split_once("<span class=\"dot warn\">").expect("a dot with the tone of the note").1;
        assert!(row.contains(&format!("</svg>{word}</span>")), "{row}");
    }
}
