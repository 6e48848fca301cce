//! Tests of the panel that shows compared runs over time, in every state that the runs may have.

use std::sync::Arc;

use peernet_clock::Span;
use peernet_logger::stage;
use peernet_store::{Episodes, MergeableStatistics, RunSummary};
use peernet_stream::PlacementKind::{Local, Remote};

use super::super::compare::render_comparison;
use super::check;
use crate::pages::shell::Shell;
use crate::tests::samples;
use crate::view::compare::tests::{comparison, configuration, run_time_series};
use crate::view::compare::{Configuration, RunMeans, over_time};

async fn panel_of(configurations: Vec<Configuration>) -> Option<String> {
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    let (selected_stage, baseline) = (None, None);
    let (compared, means) = (comparison(configurations), RunMeans::new());
    let html = render_comparison(shell, &compared, &means, (selected_stage, baseline)).expect("renders");
    check(&html);
    let panel = html.split("id=\"cc-h\"").nth(1)?;
    panel.split("</section>").next().map(str::to_owned)
}

#[tokio::test]
async fn each_run_is_drawn_with_episodes_and_losses() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    two[0].runs[0].counts.lost = 3;
    let panel = panel_of(two).await.expect("a panel");
    assert_eq!(panel.matches("<figure>").count(), 2, "{panel}");
    let [first, second] = [1, 2].map(|at| panel.split("<figure>").nth(at).expect("a picture").to_owned());
    assert!(first.contains("<b>A</b> <a href=\"/runs/1#course\">#1</a>"), "{first}");
    assert!(
        first.contains("4 episodes of 900 steps began, 3 iterations failed, points of 1\u{202f}s<"),
        "{first}"
    );
    assert!(
        second.contains("4 episodes of 900 steps began, points of") && !second.contains("class=\"lost\"")
    );
    for picture in [&first, &second] {
        let path = |class: &str| picture.split(&format!("class=\"{class}\" d=\"")).nth(1).expect("a path");
        let borders = path("border").split('"').next().expect("its end");
        assert_eq!(borders.matches('M').count(), 3, "one between each two of the 4 episodes: {borders}");
        let median = path("median").split('"').next().expect("its end");
        assert_eq!(median.matches('M').count(), 2, "nothing is drawn over the gap: {median}");
        assert!(picture.contains("class=\"f-upload\""), "{picture}");
        assert_eq!(picture.matches("class=\"warm-up\"").count(), 2, "in episodes 1 and 3: {picture}");
    }
    assert!(panel.contains("to a little above the largest p95, over seconds since the first"), "{panel}");
    assert!(panel.contains("encode, ipc</li>"), "{panel}");
    assert!(panel.contains("</svg>new episode</li>") && panel.contains("</svg>failed</li>"), "{panel}");
    // All runs share the axes: a value half as large is drawn half as high.
    let values = |picture: &str| {
        let axis = picture.split("class=\"yaxis\"").nth(1).expect("an axis");
        axis.split("</svg>").next().expect("its end").to_owned()
    };
    assert_eq!(values(&first), values(&second));
}

#[tokio::test]
async fn at_most_24_runs_are_drawn_over_time() {
    let mut many: Vec<_> = (0..20).map(|at| configuration(at, Remote, 1.0, 1e3)).collect();
    for one in &mut many {
        let again = RunSummary { number: one.runs[0].number + 100, ..one.runs[0].clone() };
        one.runs.push(again);
    }
    let panel = panel_of(many).await.expect("a panel");
    assert_eq!(panel.matches("<figure>").count(), 24);
    assert!(panel.contains("24 of 40 runs: the first of each configuration"), "{panel}");
}

#[tokio::test]
async fn sensing_is_shown_over_time_if_total_is_missing() {
    let mut one = configuration(0, Local, 1.0, 1e3);
    one.stages.retain(|statistics| statistics.stage == stage::SENSING);
    let sensing = one.summary(&stage::SENSING).expect("samples").clone();
    let mut mergeable = MergeableStatistics::default();
    mergeable.add(stage::SENSING, "s", &sensing);
    one.mergeable = Arc::new(mergeable);
    let panel = panel_of(vec![one.clone()]).await.expect("a panel");
    assert!(panel.contains("aria-label=\"Run 1, sensing over time: medians from "), "{panel}");
    assert_eq!(panel.matches("<path class=\"f-").count(), 1, "{panel}");
    assert!(panel.contains("<path class=\"f-sensing\""), "{panel}");

    one.stages.clear();
    one.mergeable = Arc::default();
    assert_eq!(panel_of(vec![one]).await, None);
}

#[tokio::test]
async fn runs_without_successful_iteration_are_named() {
    let mut all: Vec<_> = (0..12).map(|at| configuration(at, Remote, 1.0, 1e3)).collect();
    for one in &mut all[2..] {
        one.stages.clear();
        one.mergeable = Arc::default();
        (one.runs[0].counts.lost, one.runs[0].counts.ok) = (one.runs[0].counts.ok, 0);
    }
    let (app, _folder) = samples::app().await;
    let page = |all: &[Configuration]| {
        let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
        render_comparison(shell, &comparison(all.to_vec()), &RunMeans::new(), (None, None)).expect("renders")
    };
    let html = page(&all);
    check(&html);
    let said = "No successful iteration after the warm-up: #3, #4, #5, #6, #7, #8, #9, #10 and 2 more.";
    assert_eq!(html.matches(said).count(), 2, "over time and distributions: {html}");
    assert!(page(&all[..4]).contains("warm-up: #3, #4."));
    assert!(!page(&all[..2]).contains("No successful iteration"));
}

#[tokio::test]
async fn caption_states_length_of_short_run() {
    let mut one = configuration(0, Local, 1.0, 1e3);
    let panel_of_a_minute = panel_of(vec![one.clone()]).await.expect("a panel");
    assert!(!panel_of_a_minute.contains("between the starts of"), "{panel_of_a_minute}");
    one.runs[0].last_iteration = Some(samples::NOW + Span::from_millis(2_530));
    let compared = comparison(vec![one]);
    let over_time_of_points = |count: usize| {
        let mut series_by_run = run_time_series(&compared);
        for time_series in series_by_run.values_mut() {
            time_series.series.stages[0].points.truncate(count);
            for (at, point) in time_series.series.stages[0].points.iter_mut().enumerate() {
                point.at = samples::NOW + Span::from_seconds(at as i64) - Span::from_millis(150);
            }
            time_series.episodes = Episodes { first: Some(samples::NOW), count: 1, ..Episodes::default() };
        }
        over_time(&compared, &series_by_run)
    };
    let short = over_time_of_points(3).expect("three points");
    assert_eq!(
        short.runs[0].caption,
        "points of 1\u{202f}s, 2.5\u{202f}s between the starts of the first and the last iteration"
    );
    assert!(over_time_of_points(2).is_none(), "two points are too few for a plot");
}
