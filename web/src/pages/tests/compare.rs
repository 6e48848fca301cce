//! Tests of the page that compares runs, in every state that the runs may have.
//!
//! The arguments of [`configuration`] are: index, placement, factor of the usual stage means, bytes of an upload. The
//! last argument of [`render_comparison`] is the selected stage, and a run of the selected baseline.
//! The last argument of [`totals`] is the number of means over time of each run.

use std::sync::Arc;

use peernet_analysis::deadline::Misses;
use peernet_analysis::trust::{ReplayedLatencies, Report, TrustInput};
use peernet_clock::Verdict;
use peernet_logger::stage;
use peernet_statistics::Summary;
use peernet_store::{MergeableStatistics, RunSummary, StageStatistics};
use peernet_stream::ExperimentPosition;
use peernet_stream::PlacementKind::{Local, Remote};

use super::super::compare::render_comparison;
use super::check;
use crate::error::WebError;
use crate::pages::shell::Shell;
use crate::tests::samples;
use crate::view::compare::tests::{comparison, configuration, totals};
use crate::view::compare::{Comparison, Configuration, RunMeans};

/// Returns the HTML of a comparison of runs without means over time, so that the differences have no intervals.
async fn page_of(configurations: Vec<Configuration>) -> String {
    let comparison = comparison(configurations);
    page_with_means(&comparison, &RunMeans::new()).await
}

/// Returns the HTML of a comparison of runs with enough means over time for intervals of the differences.
async fn page_of_long_runs(configurations: Vec<Configuration>) -> String {
    let comparison = comparison(configurations);
    page_with_means(&comparison, &totals(&comparison, 20)).await
}

async fn page_with_means(comparison: &Comparison, means: &RunMeans) -> String {
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    let html = render_comparison(shell, comparison, means, (None, None)).expect("renders");
    check(&html);
    html
}

/// Returns the HTML of a comparison that shows the distributions of one stage.
async fn page_of_stage(configurations: &[Configuration], stage: &str) -> Result<String, WebError> {
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    render_comparison(shell, &comparison(configurations.to_vec()), &RunMeans::new(), (Some(stage), None))
        .inspect(|html| check(html))
}

/// Returns the panel whose heading has this id.
fn panel<'a>(html: &'a str, heading: &str) -> &'a str {
    let rest = html.split(&format!("id=\"{heading}\"")).nth(1).expect("a panel");
    rest.split("</section>").next().expect("its end")
}

#[tokio::test]
async fn two_configurations_have_a_difference_with_its_interval() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of_long_runs(two).await;
    assert!(
        html.contains("<h2 id=\"cd-h\">Difference to B</h2>") && html.contains("95&#x202f;% interval"),
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
    let html = page_of(many.collect()).await;
    let before_spread = html.split("How the total spreads").next().expect("the text before");
    let stacked = before_spread.split("id=\"differences\"").next().expect("the text before");
    // The heading of the column of bars has the same class.
    assert_eq!(stacked.matches("class=\"bar\"").count() - 1, 8);
    let latency = panel(&html, "cl-h");
    assert!(latency.contains("upload: ") && latency.contains(" ms + size ÷ ("), "{latency}");
    assert_eq!(latency.matches("class=\"g-upload fit\" d=\"M").count(), 1, "a line: {latency}");
    assert_eq!(latency.matches("class=\"g-upload bar\"").count(), 8, "5th to 95th percentile: {latency}");
    assert!(latency.contains("point: median") && latency.contains("messages of 8 runs, pooled"), "{latency}");
    assert!(latency.contains("messages of each size: 300"), "{latency}");
    // `page_of` gives no means over time, as if retention had deleted them.
    let differences = panel(&html, "cd-h");
    assert!(differences.contains("an interval needs at least"), "{differences}");
}

#[tokio::test]
async fn accuracies_are_columns_next_to_latencies() {
    let mut one = configuration(0, Local, 1.0, 1e3);
    let mut top = one.stages[0].clone();
    (top.stage, top.unit, top.statistics.mean) = (peernet_logger::Name::from("top-1"), String::new(), 0.84);
    one.stages.push(top);
    let html = page_of(vec![one, configuration(1, Remote, 1.0, 1e3)]).await;
    assert!(
        html.contains(">Top-1<span class=\"u\"> %</span></th>")
            && html.contains(">84.0 <span class=\"pm\">("),
        "{html}"
    );
}

#[tokio::test]
async fn accuracy_is_drawn_against_the_median_of_the_total() {
    let with = |at: usize, share: f64| {
        let mut one = configuration(at, Local, 1.0 + at as f64 * 15.0, 1e3);
        let mut top = one.stages[0].clone();
        (top.stage, top.unit, top.statistics.mean) =
            (peernet_logger::Name::from("top-1"), String::new(), share);
        one.stages.push(top);
        one
    };
    let html = page_of(vec![with(0, 0.7), with(1, 0.84)]).await;
    assert!(html.contains("Accuracy against latency") && html.contains("B 84.0\u{202f}% at"), "{html}");
    let panel = html.split("id=\"ca-1\"").nth(1).and_then(|rest| rest.split("</section>").next());
    let panel = panel.expect("a panel");
    assert!(panel.contains(">ms, logarithmic<"), "one configuration takes sixteen times as long: {panel}");
    assert_eq!(panel.matches("class=\"f-ink\"").count(), 2, "{panel}");
    let row = "<td class=\"num\" data-h=\"number\">2</td><th scope=\"row\">B</th><td class=\"num\" data-h=\"Top-1, %\">84.0</td>";
    assert!(panel.contains(row), "{panel}");
    let html = page_of(vec![with(0, 0.7), configuration(1, Local, 2.0, 1e3)]).await;
    assert!(!html.contains("Accuracy against latency"), "one point makes no plot");
    let mut without_total = with(1, 0.84);
    without_total.stages.retain(|stage| !["total", "stages-total"].contains(&stage.stage.as_str()));
    let html = page_of(vec![with(0, 0.7), without_total]).await;
    assert!(!html.contains("Accuracy against latency"), "no other stage replaces a missing total");
}

#[tokio::test]
async fn latency_is_drawn_against_number_of_users() {
    let with_users = |at: usize, users: usize| {
        let mut one = configuration(at, Remote, 1.0 + users as f64, 1e3);
        one.values = vec![users.to_string(), "zmq-tcp".to_owned()];
        let run = one.runs.remove(0);
        // There are two repeats, and the first user is missing in the second one.
        for (repeat, user) in (0..users).map(|user| (0, user)).chain((1..users).map(|user| (1, user))) {
            let host_name = samples::slug(&format!("user-{}", user + 1));
            let position = ExperimentPosition {
                name: "n".to_owned(),
                id: "a".to_owned(),
                configuration: Vec::new(),
                repeat,
                ..ExperimentPosition::default()
            };
            one.runs.push(RunSummary { host_name, experiment: Some(position), ..run.clone() });
        }
        one
    };
    let html = page_of(vec![with_users(0, 1), with_users(1, 2), with_users(2, 4)]).await;
    assert!(html.contains("Latency against the number of edges"), "{html}");
    assert!(html.contains("B: 48.3\u{202f}ms at 2 edges, C: 80.5\u{202f}ms at 4 edges"), "{html}");
    // Each edge gets 300 answers in 59 s, which are 5.08 per second. Two edges get 10.2 per second.
    assert!(html.contains(">10.2</td>") && html.contains(">5.08</td>"), "{html}");
    assert!(html.contains("data-h=\"fairness\">1.000</td>"), "{html}");
    let html = page_of(vec![with_users(0, 1), with_users(1, 1)]).await;
    assert!(!html.contains("id=\"cu-h\""), "no edges ran at the same time");
    let html = page_of(vec![with_users(0, 2), with_users(1, 2)]).await;
    assert!(!html.contains("number of edges"), "equal numbers are no curve: {html}");
    assert_eq!(
        html.matches("data-h=\"fairness\">1.000</td>").count(),
        2,
        "but there is a table, as in the files of an experiment: {html}"
    );
}

#[tokio::test]
async fn missing_interval_is_explained() {
    let two = comparison(vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)]);
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    let html = render_comparison(shell, &two, &totals(&two, 3), (None, None)).expect("renders");
    check(&html);
    assert!(
        html.contains("an interval needs at least 30 iterations of each run, in at least 5 stretches"),
        "{html}"
    );
    assert!(
        html.contains("cannot be told")
            && html.contains("too short for this page (needs 5\u{202f}s): peernet compare can tell"),
        "{html}"
    );
}

#[tokio::test]
async fn configuration_that_is_not_ranked_is_named() {
    let mut echo = configuration(1, Remote, 1.0, 1e3);
    echo.model_computes = false;
    let html = page_of_long_runs(vec![configuration(0, Local, 1.5, 1e3), echo]).await;
    assert!(html.contains("Only A is ranked, because the model of B computes nothing</h1>"), "{html}");
    assert!(html.contains("Not ranked, because the model computes nothing: B.</p>"), "{html}");
    assert!(!html.contains("lowest mean"), "no configuration is the best: {html}");
}

#[tokio::test]
async fn verdict_and_replayed_latencies_have_chips() {
    let mut two = comparison(vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)]);
    let input = TrustInput { failure: Some("the cloud is gone".to_owned()), ..TrustInput::default() };
    two.trust_by_run.insert(2, Report::new(&input));
    let facts = [("Replayed".to_owned(), "inference is drawn from x".to_owned())];
    let replayed = ReplayedLatencies::from_facts(&facts).expect("is replayed");
    two.replayed_by_run.insert(1, replayed);
    let (app, _folder) = samples::app().await;
    let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
    let html = render_comparison(shell, &two, &RunMeans::new(), (None, None)).expect("renders");
    check(&html);
    let notes = html.split("<ul class=\"notes\">").nth(1).and_then(|rest| rest.split("</ul>").next());
    let lines: Vec<&str> = notes.expect("caveats").split("<li>").skip(1).collect();
    assert!(lines[0].contains("\"chip bad\"") && lines[0].contains("cannot be published: #2 ("), "{lines:?}");
    let text = "replayed</span><span>Replayed latencies, not measured: A: inference is drawn from x.";
    assert!(lines[1].contains("\"chip warn\"") && lines[1].contains(text), "{lines:?}");
}

#[tokio::test]
async fn baseline_can_be_chosen_among_configurations() {
    let three = comparison((0..3).map(|at| configuration(at, Remote, 1.0 + at as f64, 1e3)).collect());
    let (app, _folder) = samples::app().await;
    let page = |baseline| {
        let shell = Shell::new(&app, &app.live_state(), "/compare", "Compare");
        render_comparison(shell, &three, &totals(&three, 20), (None, Some(baseline)))
    };
    let html = page("2").expect("run 2 is compared");
    check(&html);
    assert!(
        html.contains("Difference to B</h2>") && html.contains("<option value=\"2\" selected>B</option>"),
        "{html}"
    );
    let differences = html.split("id=\"cd-h\"").nth(1).expect("a panel");
    assert_eq!(differences.matches("<details class=\"other\"").count(), 2, "{differences}");
    assert!(differences.contains("<b>A</b>") && differences.contains("<b>C</b>"), "{differences}");
    assert!(matches!(page("9"), Err(WebError::BadRequest(_))));
}

#[tokio::test]
async fn iterations_are_compared_with_those_of_baseline() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of_long_runs(two).await;
    let pairs = html.split("class=\"bars pairs\"").nth(1).and_then(|rest| rest.split("</table>").next());
    let pairs = pairs.expect("a table");
    assert!(
        pairs.contains("total of an iteration of A minus total of an iteration of B: median "),
        "{pairs}"
    );
    assert!(pairs.contains("data-h=\"faster in %\">") && pairs.contains("more than chance"), "{pairs}");
}

#[tokio::test]
async fn run_with_deadline_adds_column_of_missed_deadlines() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    assert!(!page_of(two.clone()).await.contains("missed"));
    let run = &mut two[1].runs[0];
    (run.deadline_s, run.misses) = (Some(0.1), Some(Misses { missed: 3, iterations: 300 }));
    let html = page_of(two).await;
    assert!(
        html.contains("title=\"3 of 300 iterations, longer than 100\u{202f}ms or failed\">1.0</span>"),
        "{html}"
    );
    assert!(html.contains("title=\"no deadline\""), "{html}");
}

#[tokio::test]
async fn page_of_runs_without_iterations_renders() {
    let mut empty = configuration(0, Remote, 1.0, 1e3);
    empty.stages.clear();
    let html = page_of(vec![empty.clone(), Configuration { name: "B".to_owned(), ..empty }]).await;
    assert!(html.contains("No successful iteration of these runs is stored yet"), "{html}");
}

#[tokio::test]
async fn skipped_starts_are_named_below_title() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    assert!(!page_of(two.clone()).await.contains("skipped"));
    (two[1].runs[0].counts.ok, two[1].runs[0].skipped_starts) = (127, 73);
    let html = page_of(two).await;
    let head = html.split("<section").next().expect("a head");
    assert!(head.contains("configured rate: B: 73 of 200 starts (36\u{202f}%).</span>"), "{head}");
}

#[tokio::test]
async fn throughput_is_drawn_against_payload_with_its_numbers() {
    let many: Vec<_> =
        (0..5).map(|at| configuration(at, Remote, 1.0 + at as f64 * 0.3, 1e5 * (at + 1) as f64)).collect();
    let html = page_of(many.clone()).await;
    let panel = panel(&html, "cw-h");
    // 100 kB in 6.3 ms are 15.9 MB/s.
    assert!(panel.contains("data-h=\"size\">100\u{202f}kB</td>") && panel.contains(">15.9</td>"), "{panel}");
    assert_eq!(panel.matches("<th scope=\"row\">upload</th>").count(), 5, "downloads have no size: {panel}");
    assert!(panel.contains("point: size ÷ median delay"), "{panel}");
    let two = page_of(many[..2].to_vec()).await;
    assert!(
        two.contains("Throughput against payload") && !two.contains(" fit\" d=\"M"),
        "points without a line"
    );
    // There is no plot, because the largest size must be at least twice the smallest.
    let similar: Vec<_> = (0..3).map(|at| configuration(at, Remote, 1.0, 1e3 + 3e2 * at as f64)).collect();
    assert!(!page_of(similar).await.contains("against payload"));
}

#[tokio::test]
async fn each_link_has_its_own_plot_of_latency() {
    // A plot needs two sizes, the larger at least twice the smaller.
    let mut four: Vec<_> =
        (0..4).map(|at| configuration(at, Remote, 1.0, 1e4 * (1 + at % 2) as f64)).collect();
    for one in &mut four[2..] {
        one.runs[0].host_name = samples::slug("cam-2");
    }
    let html = page_of(four).await;
    let latency = panel(&html, "cl-h");
    assert_eq!(latency.matches("class=\"plot-with-axes sizes\"").count(), 2, "{latency}");
    assert!(
        ["cam-1 → ", "cam-2 → "]
            .iter()
            .all(|link| latency.contains(&format!("<h3 class=\"quantity\">{link}"))),
        "{latency}"
    );
}

#[tokio::test]
async fn totals_and_inferences_are_boxes() {
    let two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of(two).await;
    assert!(html.contains("How the total spreads") && html.contains("whiskers from p5 to p95"), "{html}");
    assert_eq!(html.matches("class=\"stages thin boxed\"").count(), 4, "two totals, two inferences: {html}");
}

#[tokio::test]
async fn all_panels_name_the_sum_of_stages() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    for one in &mut two {
        let total = one.stages.iter().find(|statistics| statistics.stage == stage::TOTAL).expect("a total");
        let sum = StageStatistics { stage: stage::STAGES_TOTAL, ..total.clone() };
        one.stages.push(sum);
        let summary = one.summary(&stage::TOTAL).expect("samples").clone();
        Arc::make_mut(&mut one.mergeable).add(stage::STAGES_TOTAL, "s", &summary);
    }
    // One iteration has no total. All configurations are therefore compared by the sum of their stages.
    two[0].runs[0].counts.ok += 1;
    let html = page_of(two).await;
    assert!(html.contains("How the sum of stages spreads") && html.contains(">sum of stages, ms<"), "{html}");
    let differences = panel(&html, "cd-h");
    assert!(differences.contains(">sum of stages<span class=\"u\"> ms"), "{differences}");
    let over_time = panel(&html, "cc-h");
    assert!(over_time.contains("</svg>median of the sum of stages<"), "{over_time}");
    // Each iteration of run 2 has a total.
    assert!(over_time.contains("aria-label=\"Run 2, stages-total over time: "), "{over_time}");
}

#[tokio::test]
async fn few_runs_show_all_distributions_or_selected_one() {
    let mut two = vec![configuration(0, Local, 1.5, 1e3), configuration(1, Remote, 1.0, 1e3)];
    let html = page_of(two.clone()).await;
    let all = panel(&html, "distributions");
    let titles =
        ["Total", "Sensing time", "Upload time", "Inference time", "Download time", "Upload throughput"];
    let found: Vec<&str> = all.split("<h3 class=\"quantity\">").skip(1).collect();
    assert_eq!(found.len(), titles.len(), "no run has a throughput of the download: {all}");
    for (group, title) in found.iter().zip(titles) {
        assert!(group.starts_with(title) && group.matches("<figcaption>").count() == 2, "{title}: {group}");
    }
    assert!(all.contains("Upload throughput<span class=\"u\"> MB/s"), "{all}");
    assert!(all.contains("<a href=\"/runs/2#distribution\">#2</a>"), "{all}");
    assert!(all.contains("<a href=\"/runs/2?stage=upload#distribution\">#2</a>"), "{all}");
    assert!(
        all.contains("href=\"?experiment=a#distributions\" data-swap=\"distributions\" aria-current"),
        "{all}"
    );
    assert!(all.contains("bin f-upload\"") && all.contains("bin f-sensing\""), "{all}");

    let html = page_of_stage(&two, "upload").await.expect("a measured stage");
    let one = panel(&html, "distributions");
    assert_eq!((one.matches("<h3").count(), one.matches("<figcaption>").count()), (1, 2), "{one}");
    assert!(
        one.contains(
            "?experiment=a&amp;stage=upload#distributions\" data-swap=\"distributions\" aria-current"
        )
    );
    // Any stage that a run has can be selected, even one that the page does not offer for all comparisons.
    let html = page_of_stage(&two, "preprocessing").await.expect("a measured stage");
    assert!(panel(&html, "distributions").contains("aria-current=\"true\">preprocessing</a>"), "{html}");
    let html = page_of_stage(&two, "download-throughput").await.expect("a standard stage");
    assert!(panel(&html, "distributions").contains("No compared run has measured this quantity."), "{html}");
    let refused = page_of_stage(&two, "<b>").await.expect_err("no run has this stage").to_string();
    assert!(refused.contains("none of the compared runs has \"<b>\"; ask for"), "{refused}");

    let alone = page_of(two[..1].to_vec()).await;
    assert_eq!(panel(&alone, "distributions").matches("<figcaption>").count(), 6);
    two.iter_mut().for_each(|one| {
        one.stages.clear();
        one.mergeable = Default::default();
    });
    assert!(!page_of(two).await.contains("id=\"distributions\""));
}

#[tokio::test]
async fn many_runs_show_at_most_24_distributions() {
    let mut many: Vec<_> = (0..20).map(|at| configuration(at, Remote, 1.0 + at as f64, 1e3)).collect();
    for one in &mut many {
        let again =
            (1..5).map(|n| RunSummary { number: one.runs[0].number + 100 * n, ..one.runs[0].clone() });
        let again: Vec<_> = again.collect();
        one.runs.extend(again);
    }
    let html = page_of(many).await;
    let drawn = panel(&html, "distributions");
    assert_eq!((drawn.matches("<h3").count(), drawn.matches("<figcaption>").count()), (1, 24), "{drawn}");
    assert!(drawn.contains("24 of 100 runs: ") && drawn.contains("> ms, logarithmic</span>"), "{drawn}");
    assert!(drawn.contains("aria-current=\"true\">total</a>") && !drawn.contains(">all</a>"), "{drawn}");
    // The first run of each of the 20 configurations, and the second run of the first four.
    for run in (1..=20).chain(101..=104) {
        assert!(drawn.contains(&format!("<a href=\"/runs/{run}#distribution\">")), "{run}: {drawn}");
    }
}

#[tokio::test]
async fn delay_with_wide_interval_is_drawn_as_band() {
    let with_half_width = |at: usize, half: f64, verdict| {
        let mut one = configuration(at, Remote, 1.0, 1e3);
        let mut widths = Summary::default();
        (0..300).for_each(|_| widths.record(half));
        let mut mergeable = MergeableStatistics::clone(&one.mergeable);
        mergeable.add_half_widths(stage::UPLOAD, &widths);
        mergeable.add_verdicts(stage::UPLOAD, verdict, 300);
        one.mergeable = Arc::new(mergeable);
        one
    };
    let two = vec![with_half_width(0, 0.000_65, Verdict::Ok), with_half_width(1, 0.004, Verdict::Limited)];
    let html = page_of_stage(&two, "upload").await.expect("a measured stage");
    let drawn = panel(&html, "distributions");
    assert_eq!(drawn.matches("class=\"band\"").count(), 2, "{drawn}");
    assert!(
        drawn.contains("ms, clock bounds 5.") && drawn.contains("median within the clock bounds 2."),
        "{drawn}"
    );
    assert_eq!(
        drawn.matches("chip warn").count(),
        1,
        "only the verdict of the second run is limited: {drawn}"
    );
    let html = page_of_stage(&two, "upload-throughput").await.expect("a measured stage");
    assert_eq!(
        panel(&html, "distributions").matches("class=\"band\"").count(),
        2,
        "a throughput is as uncertain as its delay: {html}"
    );
    let mut undetermined = configuration(2, Remote, 1.0, 1e3);
    let mut mergeable = MergeableStatistics::default();
    mergeable.add(stage::TOTAL, "s", undetermined.summary(&stage::TOTAL).expect("measured"));
    mergeable.add_verdicts(stage::UPLOAD, Verdict::Unsynchronised, 300);
    undetermined.mergeable = Arc::new(mergeable);
    let html = page_of_stage(&[two[0].clone(), undetermined], "upload").await.expect("a measured stage");
    assert!(
        panel(&html, "distributions").contains("The clocks do not determine this quantity for 1 run."),
        "{html}"
    );
}
