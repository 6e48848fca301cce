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
    assert_eq!(html.matches("class=\"bar\"").count() - 1, 8);
    assert!(html.contains("Latency against payload") && html.contains("sizes"), "{html}");
    assert!(
        html.contains("total of A, B, C, D, E, F, G, H: ") && html.contains("more per MB sent"),
        "{html}"
    );
    assert_eq!(
        html.matches("<path class=\"fit").count(),
        2,
        "one through the totals, one through the uploads"
    );
    assert!(!html.contains("id=\"cd-h\""));
    assert_eq!(html.matches("<circle class=\"f-upload cut\"").count(), 8);
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
