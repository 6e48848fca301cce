//! Runs side by side, in every state that they may have.

use peernet_aggregator::RunSummary;
use peernet_logger::stream::ExperimentPlace;
use peernet_logger::stream::PlacementKind::{Local, Remote};

use super::super::compare::rendered;
use super::check;
use crate::view::compare::Configuration;
use crate::view::compare::tests::{comparison, configuration, course};
use crate::view::samples;
use crate::view::shell::{Place, Shell};

async fn page_of(configurations: Vec<Configuration>, means: Option<(f64, f64)>) -> String {
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.picture(), Place::Compare, "Compare");
    let courses = means.map(|(a, b)| (vec![course(a, 20)], vec![course(b, 20)]));
    let html = rendered(shell, &comparison(configurations), courses.as_ref());
    check(&html);
    html
}

#[tokio::test]
async fn two_configurations_have_a_difference_with_its_interval() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of(two, Some((0.0241, 0.0160))).await;
    assert!(
        html.contains("<h2 id=\"cd-h\">B less A</h2>") && html.contains("95&#x202f;% interval"),
        "{html}"
    );
    assert!(
        html.contains("lowest mean</span>") && html.contains("Inference on board and in the cloud"),
        "{html}"
    );
    assert!(html.contains("class=\"halo\""), "the error bar of the total");
    assert!(!html.contains("Latency against payload"));
}

#[tokio::test]
async fn several_configurations_have_a_table_bars_and_a_plot() {
    let many = (0..8).map(|at| configuration(at, Remote, 1.0 + at as f64 * 0.3, 1e3 * (at + 1) as f64));
    let html = page_of(many.collect(), None).await;
    let stacked = html.split("How the total spreads").next().expect("what stands before");
    assert_eq!(stacked.matches("class=\"bar\"").count() - 1, 8);
    assert!(html.contains("Latency against payload") && html.contains("sizes"), "{html}");
    assert!(
        html.contains("total of A, B, C, D, E, F, G, H: ") && html.contains("more per MB sent"),
        "{html}"
    );
    let latency = html.split("id=\"cw-h\"").next().expect("what stands before");
    assert_eq!(
        latency.matches("<path class=\"fit").count(),
        2,
        "one through the totals, one through the uploads"
    );
    assert!(!html.contains("id=\"cd-h\""));
    assert_eq!(latency.matches("<circle class=\"f-upload cut\"").count(), 8);
}

#[tokio::test]
async fn accuracies_stand_beside_the_latencies() {
    let mut one = configuration(0, Local, 1.0, 1e3);
    let mut top = one.stages[0].clone();
    (top.stage, top.unit, top.figures.mean) = (peernet_logger::Name::from("top-1"), String::new(), 0.842);
    one.stages.push(top);
    let html = page_of(vec![one, configuration(1, Remote, 1.0, 1e3)], None).await;
    assert!(html.contains(">Top-1</th>") && html.contains(">84.2 <span class=\"pm\">("), "{html}");
}

#[tokio::test]
async fn accuracy_is_drawn_against_the_median_of_the_total() {
    let with = |at: usize, share: f64| {
        let mut one = configuration(at, Local, 1.0 + at as f64 * 15.0, 1e3);
        let mut top = one.stages[0].clone();
        (top.stage, top.unit, top.figures.mean) = (peernet_logger::Name::from("top-1"), String::new(), share);
        one.stages.push(top);
        one
    };
    let html = page_of(vec![with(0, 0.7), with(1, 0.842)], None).await;
    assert!(html.contains("Accuracy against latency") && html.contains("B 84.2\u{202f}% at"), "{html}");
    assert!(html.contains("median total, ms, logarithmic"), "one takes sixteen times as long: {html}");
    let panel = html.split("Accuracy against latency").nth(1).expect("a panel");
    assert_eq!(panel.matches("class=\"whisk\"").count(), 2, "each with its interval: {panel}");
    let html = page_of(vec![with(0, 0.7), configuration(1, Local, 2.0, 1e3)], None).await;
    assert!(!html.contains("Accuracy against latency"), "one point is no plot");
}

#[tokio::test]
async fn users_that_measured_at_once_are_drawn_against_their_number() {
    let with = |at: usize, users: usize| {
        let mut one = configuration(at, Remote, 1.0 + users as f64, 1e3);
        one.values = vec![users.to_string(), "zmq-tcp".to_owned()];
        let usual = one.runs.remove(0);
        // Twice, and in the second repeat one of the users is missing.
        for (repeat, user) in (0..users).map(|user| (0, user)).chain((1..users).map(|user| (1, user))) {
            let host_name = samples::slug(&format!("user-{}", user + 1));
            let place = ExperimentPlace {
                name: "n".to_owned(),
                id: "a".to_owned(),
                configuration: Vec::new(),
                repeat,
            };
            one.runs.push(RunSummary { host_name, experiment: Some(place), ..usual.clone() });
        }
        one
    };
    let html = page_of(vec![with(0, 1), with(1, 2), with(2, 4)], None).await;
    assert!(html.contains("Latency against the number of users"), "{html}");
    assert!(html.contains("B: 48.1\u{202f}ms at 2 users, C: 80.2\u{202f}ms at 4 users"), "{html}");
    // 305 answers of each in a minute.
    assert!(html.contains(">10.2</td>") && html.contains(">5.08 – 5.08</td>"), "{html}");
    assert!(html.contains("data-h=\"fairness\">1.000</td>"), "{html}");
    let html = page_of(vec![with(0, 1), with(1, 1)], None).await;
    assert!(!html.contains("number of users"), "each was alone");
}

#[tokio::test]
async fn too_little_for_an_interval_is_said_with_who_has_how_little() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.picture(), Place::Compare, "Compare");
    let courses = (vec![course(0.0241, 3)], vec![course(0.0160, 20)]);
    let html = rendered(shell, &comparison(two), Some(&courses));
    check(&html);
    assert!(html.contains("an interval needs 5 stretches on each side"), "{html}");
    assert!(html.contains("of total, A has 3 and B has 20: A is too short to tell."), "{html}");
}

#[tokio::test]
async fn runs_without_an_iteration_can_be_looked_at() {
    let mut empty = configuration(0, Remote, 1.0, 1e3);
    empty.stages.clear();
    let html = page_of(vec![empty.clone(), Configuration { letter: "B".to_owned(), ..empty }], None).await;
    assert!(html.contains("No successful iteration of these runs is stored yet"), "{html}");
}

#[tokio::test]
async fn starts_that_were_skipped_stand_below_the_title() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    assert!(!page_of(two.clone(), None).await.contains("skipped"));
    (two[1].runs[0].counts.ok, two[1].runs[0].skipped_starts) = (127, 73);
    let html = page_of(two, None).await;
    let head = html.split("<section").next().expect("a head");
    assert!(head.contains("that was ordered: B: 73 of 200 starts (36.5 %).</span>"), "{head}");
}

#[tokio::test]
async fn throughput_is_drawn_against_payload_with_its_numbers() {
    let many: Vec<_> =
        (0..5).map(|at| configuration(at, Remote, 1.0 + at as f64 * 0.3, 1e5 * (at + 1) as f64)).collect();
    let html = page_of(many.clone(), None).await;
    let panel = html.split("id=\"cw-h\"").nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("its end");
    assert_eq!(panel.matches("<circle class=\"f-upload cut\"").count(), 5, "{panel}");
    // 100 kB in 6.3 ms.
    assert!(panel.contains("data-h=\"size\">100\u{202f}kB</td>") && panel.contains(">15.9 <span"), "{panel}");
    assert_eq!(
        panel.matches("data-h=\"way\">upload</td>").count(),
        5,
        "downloads are all of one size: {panel}"
    );
    assert!(
        panel.contains("upload of A, B, C, D, E: ") && panel.contains("by the slope of a line"),
        "{panel}"
    );
    assert!(
        !page_of(many[..2].to_vec(), None).await.contains("Throughput against payload"),
        "two are no plot"
    );
}

#[tokio::test]
async fn totals_and_inferences_are_boxes_and_each_run_has_a_distribution() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of(two.clone(), None).await;
    assert!(html.contains("How the total spreads") && html.contains("whiskers from p5 to p95"), "{html}");
    assert_eq!(html.matches("class=\"stages thin boxed\"").count(), 4, "two totals, two inferences: {html}");
    assert_eq!(html.matches("<figcaption>").count(), 2);
    assert!(html.contains("<a href=\"/runs/2#distribution\">#2</a>"), "{html}");
    assert!(!html.contains("of 2 runs"), "none is left out: {html}");
    assert_eq!(page_of(two[..1].to_vec(), None).await.matches("<figcaption>").count(), 1);

    let mut many: Vec<_> = (0..20).map(|at| configuration(at, Remote, 1.0 + at as f64, 1e3)).collect();
    for one in &mut many {
        let again =
            (1..5).map(|n| RunSummary { number: one.runs[0].number + 100 * n, ..one.runs[0].clone() });
        let again: Vec<_> = again.collect();
        one.runs.extend(again);
    }
    let html = page_of(many, None).await;
    assert_eq!(html.matches("<figcaption>").count(), 24);
    assert!(html.contains("24 of 100 runs: ") && html.contains("ms, logarithmic, one axis"), "{html}");
    for run in (1..=20).chain(101..=104) {
        assert!(html.contains(&format!("<a href=\"/runs/{run}#distribution\">")), "{run}: {html}");
    }
}
