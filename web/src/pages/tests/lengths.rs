//! Tests of the panel *Response length against latency* of the page that compares runs.

use peernet_logger::Name;
use peernet_stream::PlacementKind::Remote;

use super::super::compare::render_comparison;
use super::check;
use crate::pages::shell::Shell;
use crate::tests::samples;
use crate::view::compare::lengths::tests::{answers_of_lengths, sample_answers};
use crate::view::compare::tests::{comparison, configuration};
use crate::view::compare::{Configuration, RunMeans};

const HEADING: &str = "<h2 id=\"cr-h\">Response length against latency</h2>";

async fn page_of(configurations: Vec<Configuration>) -> String {
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    let (selected_stage, baseline) = (None, None);
    let (compared, means) = (comparison(configurations), RunMeans::new());
    let html = render_comparison(shell, &compared, &means, (selected_stage, baseline)).expect("renders");
    check(&html);
    html
}

fn panel(html: &str) -> &str {
    let rest = html.split(HEADING).nth(1).expect("a panel");
    rest.split("</section>").next().expect("its end")
}

#[tokio::test]
async fn configurations_with_answers_of_varying_length_are_drawn() {
    let html = page_of(vec![
        configuration(0, Remote, 1.0, 1e3),
        answers_of_lengths(1, "completion-tokens", &sample_answers(300)),
        answers_of_lengths(2, "completion-tokens", &sample_answers(900)),
    ])
    .await;
    let panel = panel(&html);
    assert_eq!(panel.matches("class=\"joint\" role=\"img\" aria-label=\"").count(), 2, "{panel}");
    assert!(
        panel.contains("<b>B</b>") && panel.contains("<b>C</b>") && !panel.contains("<b>A</b>"),
        "{panel}"
    );
    assert_eq!(panel.matches("class=\"dots d-inference\"").count(), 1, "three hundred are dots: {panel}");
    assert!(
        panel.contains("fill-opacity=") && panel.contains("the stronger the colour of a cell"),
        "{panel}"
    );
    assert!(panel.contains("500 of 900 iterations, evenly spread; histograms of all."), "{panel}");
    assert!(panel.contains("All 300 iterations.") && panel.contains("Each further token takes"), "{panel}");
    assert!(panel.len() < 60_000, "{}", panel.len());
}

#[tokio::test]
async fn panel_is_between_payload_and_accuracy() {
    let with_accuracy = |at: usize, bytes: f64| {
        let mut one = configuration(at, Remote, 1.0 + at as f64, bytes);
        let mut top = one.stages[0].clone();
        (top.stage, top.unit, top.statistics.mean) =
            (Name::from("top-1"), String::new(), 0.7 + 0.14 * at as f64);
        one.stages.push(top);
        one
    };
    let html = page_of(vec![
        with_accuracy(0, 1e5),
        with_accuracy(1, 3e5),
        answers_of_lengths(2, "completion-tokens", &sample_answers(300)),
    ])
    .await;
    let panels = ["Throughput against payload", HEADING, "Accuracy against latency"];
    let places = panels.map(|text| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}")));
    assert!(places.is_sorted(), "{places:?}");
}

#[tokio::test]
async fn without_answers_of_different_length_there_is_no_panel() {
    let html = page_of((0..3).map(|at| configuration(at, Remote, 1.0, 1e3)).collect()).await;
    assert!(!html.contains(HEADING), "{html}");
}

#[tokio::test]
async fn panel_without_usage_says_what_to_do() {
    let html = page_of(vec![answers_of_lengths(0, "output-chunks", &sample_answers(80))]).await;
    let panel = panel(&html);
    assert!(panel.contains("the server sent no `usage`; use --x output-chunks with peernet plot"), "{panel}");
    assert!(!panel.contains("<figure>"), "{panel}");
}

#[tokio::test]
async fn configurations_beyond_six_are_named() {
    let html =
        page_of((0..9).map(|at| answers_of_lengths(at, "download-bytes", &sample_answers(80))).collect())
            .await;
    let panel = panel(&html);
    assert_eq!(panel.matches("<figcaption>").count(), 6, "{panel}");
    assert!(
        panel.contains("Only the first 6 configurations whose answers differ in length are drawn; the answers of G; H; I differ"),
        "{panel}"
    );
}
