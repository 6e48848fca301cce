//! Tests of the pages of links, in every state that the clocks may be in.

use peernet_clock::{Span, Verdict};

use super::super::{link, links, pipeline};
use super::{check, overview_of};
use crate::tests::samples::{self, host, snapshot};

/// Returns a live state with one pipeline and the pipeline's link. `verdict` is the verdict of the pipeline's delays.
/// `half` is half the width of the offset's bounds, seconds; `None` without an offset.
pub(super) fn live_state_with_link(half: Option<f64>, verdict: Verdict) -> peernet_aggregator::LiveState {
    let mut live_state =
        snapshot(vec![host("cam-1", "Orin")], vec![samples::pipeline("line", 30.0, 1.0, verdict, &[])]);
    live_state.links.push(std::sync::Arc::new(samples::link(half, &[])));
    live_state
}

#[tokio::test]
async fn link_page_renders_for_each_verdict_and_range() {
    let (app, _folder) = samples::app().await;
    // The samples have downloads of 0.6 ms. Bounds of ±0.65 ms are too wide for them, bounds of ±0.02 ms are not.
    for (half, word) in [(Some(0.00065), "limited"), (Some(0.00002), "ok"), (None, "unsynchronised")] {
        // The last part of a topic says whether the chart shows the offset with its drift removed or as measured.
        for topic in ["cam-1~rack-a/10min/removed", "cam-1~rack-a/10min/measured", "cam-1~rack-a/24h/removed"]
        {
            let update =
                link::update(&app, &live_state_with_link(half, Verdict::Ok), topic).await.expect("renders");
            let html: String = update.parts.iter().map(|(_, html)| html.as_str()).collect();
            check(&html);
            assert!(html.contains(word), "{topic}: {html}");
            // An empty update would blank a part of the page.
            let empty: Vec<_> = update.parts.iter().filter(|(_, html)| html.trim().is_empty()).collect();
            assert!(empty.is_empty(), "{topic}: {empty:?}");
            assert!(html.contains("Each interval contains the true delay"), "{topic}: {html}");
            // Only the chart of the last ten minutes is part of live updates.
            assert_eq!(update.parts.iter().any(|(id, _)| *id == "chart"), topic.contains("10min"), "{topic}");
        }
        let update = links::update(&app, &live_state_with_link(half, Verdict::Ok)).expect("renders");
        update.parts.iter().for_each(|(_, html)| check(html));
        let (_, list) = &update.parts[1];
        assert!(list.contains(word) && list.contains("/links/cam-1~rack-a"), "{list}");
    }
    for wrong in
        ["cam-1~rack-b/10min/removed", "cam-1/10min/removed", "cam-1~rack-a/1d/removed", "cam-1~rack-a"]
    {
        assert!(
            link::update(&app, &live_state_with_link(None, Verdict::Ok), wrong).await.is_err(),
            "{wrong}"
        );
    }
}

#[tokio::test]
async fn links_over_two_networks_have_distinct_names() {
    let (app, _folder) = samples::app().await;
    let mut live_state = live_state_with_link(Some(0.00065), Verdict::Ok);
    live_state.links.push(std::sync::Arc::new(samples::link_over_udp(Some(0.00065))));
    let list = links::update(&app, &live_state).expect("renders");
    for (href, name) in [("cam-1~rack-a\"", "cam-1 → rack-a<"), ("cam-1~rack-a~zmq-udp\"", "over zmq-udp<")]
    {
        let list = &list.parts[1].1;
        assert!(list.contains(&format!("/links/{href}")) && list.contains(name), "{href}: {list}");
    }
    for (topic, network) in [
        ("cam-1~rack-a/10min/removed", "<span>zmq-tcp</span>"),
        ("cam-1~rack-a~zmq-tcp/10min/removed", "<span>zmq-tcp</span>"),
        ("cam-1~rack-a~zmq-udp/10min/removed", "<span>zmq-udp</span>"),
    ] {
        let update = link::update(&app, &live_state, topic).await.expect("renders");
        assert!(update.parts[0].1.contains(network), "{topic}: {}", update.parts[0].1);
    }
    assert!(link::update(&app, &live_state, "cam-1~rack-a~ros/10min/removed").await.is_err());
}

#[tokio::test]
async fn link_without_live_host_has_a_page() {
    use crate::view::link::Subject;
    use crate::view::link::time_series::LinkTimeSeries;
    let (app, _folder) = samples::app().await;
    let row = peernet_store::LinkRow {
        edge: peernet_logger::HostId::from_bytes([7; 16]),
        edge_name: samples::slug("cam-1"),
        cloud: peernet_logger::HostId::from_bytes([9; 16]),
        cloud_name: samples::slug("rack-a"),
        first: samples::NOW,
        last: samples::NOW,
        network: peernet_stream::NetworkName::default(),
    };
    for points in [Vec::new(), vec![samples::clock_point(samples::NOW, 1, Some(0.00065))]] {
        let subject = Subject::past(&row);
        let from = samples::NOW - Span::from_seconds(600);
        let time_series =
            LinkTimeSeries::stored(peernet_store::ClockSeries { bucket_s: 1, points }, from, samples::NOW);
        let live_state = snapshot(Vec::new(), Vec::new());
        let selected_series = None;
        let page = link::link_page(
            &app,
            &live_state,
            &subject,
            &time_series,
            selected_series,
            link::Query::default(),
            &[],
        );
        let html = askama::Template::render(&page).expect("renders");
        check(&html);
        assert!(html.contains("cam-1 last reported this link on 19 Nov 2026, 12:01:07"), "{html}");
        assert!(
            !html.contains("data-topic") && !html.contains("id=\"pause\""),
            "no part of the page is live"
        );
    }
}

#[tokio::test]
async fn link_with_one_clock_explains_exact_delays() {
    let (app, _folder) = samples::app().await;
    let mut live_state = live_state_with_link(Some(0.0), Verdict::Ok);
    std::sync::Arc::make_mut(&mut live_state.links[0]).live.same_clock = true;
    let update = link::update(&app, &live_state, "cam-1~rack-a/10min/removed").await.expect("renders");
    let html: String = update.parts.iter().map(|(_, html)| html.as_str()).collect();
    check(&html);
    assert!(
        html.contains("read one clock: delays between them are exact")
            && html.contains("proven to read one clock")
    );
    assert!(!html.contains("clock offset of"), "{html}");
}

#[tokio::test]
async fn verdict_other_than_ok_links_to_page_of_link() {
    let html = overview_of(&live_state_with_link(Some(0.00065), Verdict::Limited), Vec::new()).await;
    assert!(html.contains("href=\"/links/cam-1~rack-a\""), "{html}");
    let (app, _folder) = samples::app().await;
    let update =
        pipeline::update(&app, &live_state_with_link(Some(0.00065), Verdict::Stepped), "cam-1/line/10")
            .expect("renders");
    let title = &update.parts[0].1;
    assert!(title.contains("leave these delays out") && title.contains("/links/cam-1~rack-a"), "{title}");
}
