//! Trust reports and comparisons of stored runs.

use axum::http::StatusCode;
use peernet_analysis::compare::{Comparison, Differences};
use peernet_analysis::trust::{Report, TrustInput};
use peernet_analysis::users::Users;
use peernet_results::ResultFolder;
use peernet_statistics::number::{fixed_or_less_than, join_ends, mean_std_ms, rate};
use peernet_stream::ExperimentPosition;

use crate::test_dashboard::TestDashboard;
use crate::test_site::TestPipeline;

#[tokio::test]
async fn run_page_states_trust_and_reasons() {
    let (dashboard, mut site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let trust = dashboard.get("/api/v1/runs/1/trust").await.json();
    let about = |subject: &str| {
        let sentences = trust["sentences"].as_array().expect("sentences");
        let found = sentences.iter().find(|sentence| sentence["about"] == subject);
        found.unwrap_or_else(|| panic!("nothing about {subject}: {trust}")).clone()
    };
    assert_eq!(about("amount")["grade"], "good", "{trust}");
    assert_eq!(about("missing events")["grade"], "good", "{trust}");
    for subject in ["stationarity", "warm-up", "outliers", "unattributed", "hosts"] {
        assert!(!about(subject)["text"].as_str().expect("text").is_empty(), "{subject}");
    }
    let page = dashboard.get("/runs/1").await;
    assert!(page.text().contains("Can this run be published?"), "{}", page.text());
    assert!(page.text().contains("CPU governor (performance)"), "{}", page.text());
    let remote_run = dashboard.get("/api/v1/runs/2/trust").await;
    assert!(remote_run.text().contains("Of the delays of `upload`"), "{}", remote_run.text());

    // Three gaps of 974 events.
    site.store_gaps(0, 3).await;
    let trust = dashboard.get("/api/v1/runs/1/trust").await.json();
    assert_eq!(trust["verdict"], "no", "{trust}");
    let first = &trust["sentences"][0];
    assert_eq!((&first["about"], &first["grade"]), (&"missing events".into(), &"bad".into()), "{trust}");
    assert!(dashboard.get("/runs/1").await.text().contains("2,922 events"));
    assert_eq!(dashboard.get("/api/v1/runs/99/trust").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn skipped_starts_before_failed_iterations_are_shown() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    // 20 of the 120 iterations are the warm-up, and 10 of the other 100 timed out. 7 starts were skipped before each
    // iteration that timed out.
    site.store_overloaded_run(0, 120, 7).await;
    assert_eq!(dashboard.get("/api/v1/runs/1").await.json()["skipped_starts"], 0);
    assert_eq!(dashboard.get("/api/v1/runs/2").await.json()["skipped_starts"], 70);
    let trust = dashboard.get("/api/v1/runs/2/trust").await.json();
    let sentences = trust["sentences"].as_array().expect("sentences");
    let finding =
        sentences.iter().find(|sentence| sentence["about"] == "skipped starts").expect("the finding exists");
    assert_eq!(finding["grade"], "bad", "{finding}");
    assert!(
        finding["text"].as_str().expect("text").starts_with("70 of 170 starts (41\u{202f}%)"),
        "{finding}"
    );
    let page = dashboard.get("/runs/2").await;
    let skipped = "<dt>Skipped starts</dt><dd>70</dd><dd>70 of 170 starts (41\u{202f}%)</dd>";
    assert!(page.text().contains(skipped), "{}", page.text());
    // Of the first eight failed iterations, two belong to the warm-up, which no count includes.
    let panel = page.text().split("Failed iterations</h2>").nth(1).expect("a panel");
    let panel = panel.split("</section>").next().expect("an end tag");
    let count_of = |cell: &str| panel.matches(&format!("<td>{cell}</td>")).count();
    assert_eq!((count_of("timed out, warm-up"), count_of("timed out")), (2, 6), "{panel}");
    let finding =
        sentences.iter().find(|sentence| sentence["about"] == "losses").expect("the finding exists");
    let text = "10 of 100 iterations failed (10\u{202f}%): 10 timed out.";
    assert_eq!(finding["text"], text);
    // The same sentence follows from the file of the run.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("run.csv");
    std::fs::write(&file, dashboard.get("/api/v1/runs/2/export").await.text()).expect("writable");
    let rows = ResultFolder::open(&file).expect("a file of results").rows;
    let report = Report::new(&TrustInput::from_rows(&rows, &[]));
    let of_file =
        report.findings.iter().find(|finding| finding.about == "losses").expect("the finding exists");
    assert_eq!(of_file.text, text);

    let compared = dashboard.get("/api/v1/compare?runs=1,2").await.json();
    let counts = |at: usize| {
        let one = &compared["configurations"][at];
        (one["starts"].as_u64(), one["skipped_starts"].as_u64())
    };
    assert_eq!((counts(0), counts(1)), ((Some(380), Some(0)), (Some(170), Some(70))), "{compared}");
    let [publication, skipped] = [0, 1].map(|at| compared["doubts"][at].as_str().expect("a sentence"));
    assert!(publication.starts_with("1 of 2 runs cannot be published: #2 (skipped starts"), "{publication}");
    assert!(skipped.ends_with(" of the configured rate: #2: 70 of 170 starts (41\u{202f}%)."), "{skipped}");
    let page = dashboard.get("/compare?runs=1,2").await;
    assert!(page.text().contains(publication) && page.text().contains(skipped), "{}", page.text());
    assert_eq!(dashboard.get("/api/v1/compare?runs=1").await.json()["doubts"], serde_json::json!([]));
}

#[tokio::test]
async fn values_of_repeated_nodes_are_not_called_iterations() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    // 20 of the 120 iterations are the warm-up, and 10 of the other 100 timed out. Each of the 90 successful iterations
    // has two nodes `crop`.
    site.store_overloaded_run(0, 120, 7).await;
    let page = dashboard.get("/compare?runs=2&stage=crop").await;
    assert!(page.text().contains("180 values, median "), "{}", page.text());
    let page = dashboard.get("/compare?runs=2&stage=inference").await;
    assert!(page.text().contains("90 iterations, median "), "{}", page.text());
    let [crop, inference] = ["crop", "inference"].map(|name| format!("/runs/2?stage={name}"));
    for (address, title) in [(crop, ">values<"), (inference, ">iterations<")] {
        let page = dashboard.get(&address).await;
        let panel = page.text().split("id=\"distribution\"").nth(1).expect("a panel");
        let panel = panel.split("</section>").next().expect("an end tag");
        assert!(panel.contains(title), "{panel}");
    }
    let exported = dashboard.get("/api/v1/runs/2/export").await;
    let header = exported.text().lines().next().expect("a header").to_owned();
    assert!(
        header.split(',').any(|column| column == "crop_2"),
        "a file has a column for each repeated node: {header}"
    );
}

/// Returns the HTML of the panel of distributions.
fn distributions(page: &str) -> &str {
    let panel = page.split("id=\"distributions\"").nth(1).expect("a panel");
    panel.split("</section>").next().expect("an end tag")
}

#[tokio::test]
async fn repeats_of_an_experiment_are_combined() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![
        TestPipeline::local(),
        TestPipeline::full(),
        TestPipeline::resized(),
    ])
    .await;
    assert_eq!(dashboard.get("/api/v1/experiments").await.json()["experiments"], serde_json::json!([]));
    assert!(dashboard.get("/compare").await.text().contains("No run of an experiment is stored yet"));
    assert!(
        dashboard
            .get("/compare")
            .await
            .text()
            .contains("in its table <span class=\"mono\">[experiment]</span>")
    );
    site.store_experiment(200, 2).await;

    let listed = dashboard.get("/api/v1/experiments").await.json();
    let experiment = &listed["experiments"][0];
    assert_eq!((&experiment["name"], &experiment["runs"]), (&"pictures".into(), &6.into()), "{listed}");
    let id = experiment["id"].as_str().expect("an id");
    let compared = dashboard.get(&format!("/api/v1/compare?experiment={id}")).await.json();
    assert_eq!(compared["axes"], serde_json::json!(["picture", "where"]));
    let configurations = compared["configurations"].as_array().expect("configurations");
    assert_eq!(configurations.len(), 3, "{compared}");
    assert!(configurations.iter().all(|one| one["runs"].as_array().expect("runs").len() == 2), "{compared}");

    // A configuration of two runs has the iterations of both.
    let runs = configurations[0]["runs"].as_array().expect("runs");
    let (mut counts, mut medians) = (0, Vec::new());
    for run in runs {
        let total = &dashboard.get(&format!("/api/v1/runs/{run}")).await.json()["total"];
        counts += total["count"].as_u64().expect("a count");
        medians.push(total["p50"].as_f64().expect("a median"));
        assert_eq!(total["p99"], serde_json::Value::Null, "one run has too few values for a p99: {total}");
    }
    let total = configurations[0]["stages"].as_array().expect("stages");
    let total = total.iter().find(|stage| stage["name"] == "total").expect("a total");
    assert_eq!(total["count"], counts, "{total}");
    // Both runs together have enough values for a p99, and their median lies between the medians of each.
    let [p50, p95, p99, max] = ["p50", "p95", "p99", "max"].map(|name| total[name].as_f64().expect(name));
    assert!(p50 < p95 && p95 <= p99 && p99 <= max, "{total}");
    medians.sort_by(f64::total_cmp);
    assert!((medians[0]..=medians[1]).contains(&p50), "{medians:?} {total}");

    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert_eq!(page.status, StatusCode::OK, "{}", page.text());
    assert!(page.text().contains(" is the fastest: "), "{}", page.text());
    assert!(page.text().contains("<span>experiment pictures</span>"), "{}", page.text());
    // Each of the six runs has a distribution, and each of the three configurations has a box for its two runs
    // together.
    assert_eq!(page.text().matches("#distribution\">#").count(), 6, "{}", page.text());
    assert!(page.text().contains(&format!("; {counts} samples\"")), "{}", page.text());
    let address = format!("/compare?experiment={id}&stage=");
    let page = dashboard.get(&format!("{address}upload")).await;
    let drawn = distributions(page.text());
    assert!(drawn.contains(">Upload time<") && !drawn.contains(">Total<"), "{drawn}");
    assert_eq!(drawn.matches("<figcaption>").count(), 4, "two configurations offload: {drawn}");
    assert!(drawn.contains("#distributions\" data-swap=\"distributions\""), "{drawn}");
    let page = dashboard.get(&format!("{address}telepathy")).await;
    assert_eq!(page.status, StatusCode::BAD_REQUEST);
    assert!(page.text().contains("none of the compared runs has"), "{}", page.text());
    let run = dashboard.get(&format!("/runs/{}", runs[0])).await;
    assert!(run.text().contains(&format!("/compare?experiment={id}")), "{}", run.text());
    assert!(run.text().contains("On cam-1, CPU governor: schedutil"), "{}", run.text());
    assert!(dashboard.get("/runs").await.text().contains(">pictures</a>"));
    assert!(dashboard.get("/compare").await.text().contains(">pictures</a>"));
}

#[tokio::test]
async fn sizes_are_sorted_by_value_or_file_order() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::resized()]).await;
    let without_index = [600e3, 30e3, 2_000e3, 150e3].map(|bytes| (bytes, None));
    site.store_run_of_each_size(0, 100, &without_index).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert!(page.text().contains("Latency against payload"), "{}", page.text());
    assert!(page.text().contains("ms, logarithmic"), "{}", page.text());
    let compared = dashboard.get(&format!("/api/v1/compare?experiment={id}")).await.json();
    let sizes: Vec<_> =
        compared["configurations"].as_array().expect("some").iter().map(|one| &one["values"][0]).collect();
    assert_eq!(
        sizes,
        ["30 kB", "150 kB", "600 kB", "2000 kB"],
        "sorted by value, not by the time of the runs: {compared}"
    );
    assert!(dashboard.get("/runs").await.text().contains("size = 2000 kB, repeat 1"));

    let with_index = [(600e3, Some(1)), (30e3, Some(2)), (150e3, Some(0))];
    site.store_run_of_each_size(0, 100, &with_index).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let compared = dashboard.get(&format!("/api/v1/compare?experiment={id}")).await.json();
    let sizes: Vec<_> =
        compared["configurations"].as_array().expect("some").iter().map(|one| &one["values"][0]).collect();
    assert_eq!(sizes, ["150 kB", "600 kB", "30 kB"], "in the order of the file: {compared}");
}

#[tokio::test]
async fn many_users_count_as_one_configuration() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![
        TestPipeline::local(),
        TestPipeline::full(),
        TestPipeline::resized(),
    ])
    .await;
    site.store_runs_with_users(100, &[1, 3]).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert!(page.text().contains("Latency against the number of edges"), "{}", page.text());
    assert!(page.text().contains(">3</td>") && page.text().contains("at 3 edges"), "{}", page.text());
}

#[tokio::test]
async fn baseline_can_be_any_of_fifty_configurations() {
    let (dashboard, mut site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    site.store_run_of_each_configuration(30, 50).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert!(
        page.text().contains("<option value=") && page.text().contains("Difference to "),
        "{}",
        page.text()
    );
    assert_eq!(page.text().matches("<option value=").count(), 50, "{}", page.text());
    assert!(!page.text().contains("number of edges"), "no configuration has several edges");
}

#[tokio::test]
async fn rates_of_users_are_equal_on_page_and_in_files() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![
        TestPipeline::local(),
        TestPipeline::full(),
        TestPipeline::resized(),
    ])
    .await;
    site.store_runs_with_users(400, &[1, 3]).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let compared = dashboard.get(&format!("/api/v1/compare?experiment={id}")).await.json();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut runs = Vec::new();
    for one in compared["configurations"].as_array().expect("configurations") {
        for run in one["runs"].as_array().expect("runs") {
            let file = folder.path().join(format!("run-{run}.csv"));
            let exported = dashboard.get(&format!("/api/v1/runs/{run}/export")).await;
            std::fs::write(&file, exported.text()).expect("the folder is writable");
            let mut loaded = ResultFolder::open(&file).expect("a file of results");
            let users = one["values"][0].as_str().expect("a number of users").to_owned();
            let configuration = vec![("Users".to_owned(), users)];
            loaded.record.experiment = Some(ExperimentPosition {
                name: "users".to_owned(),
                id: id.to_owned(),
                configuration,
                repeat: 0,
                ..ExperimentPosition::default()
            });
            loaded.record.edge.name = run.to_string();
            runs.push(loaded);
        }
    }
    let of_files = Users::from_runs(&runs).expect("several edges");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert!(
        page.text().contains("Answers are counted only while all edges of a repeat were measuring."),
        "{}",
        page.text()
    );
    assert_eq!(of_files.lines.len(), 2);
    for line in &of_files.lines {
        let (least, most) = line.rate_range().expect("a common time");
        let cells = [
            format!("data-h=\"edges\">{}</td>", line.edges),
            format!("data-h=\"answers, /s\">{}</td>", rate(line.rate.expect("a common time"))),
            format!("data-h=\"answers per edge, /s\">{}</td>", join_ends([least, most].map(rate))),
            format!(
                "data-h=\"fairness\">{}</td>",
                fixed_or_less_than(line.fairness.expect("a common time"), 3)
            ),
        ];
        assert!(page.text().contains(&cells.join("<td class=\"num\" ")), "{cells:?} {}", page.text());
        let mean = mean_std_ms(line.totals.mean.expect("totals"), None).0;
        assert!(page.text().contains(&format!("data-h=\"mean total, ms\">{mean}</td>")), "{mean}");
    }
}

#[tokio::test]
async fn difference_of_two_runs_states_its_significance() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let compared = dashboard.get("/api/v1/compare?runs=1,2").await.json();
    let total_of = |compared: &serde_json::Value| {
        let mut differences = compared["differences"].as_array().expect("differences").iter();
        differences.find(|difference| difference["name"] == "total").expect("of the total").clone()
    };
    let total = total_of(&compared);
    assert_eq!(total["certain"], true, "{compared}");
    let [lo, value, hi] = [&total["interval"][0], &total["value"], &total["interval"][1]]
        .map(|it| it.as_f64().expect("a number"));
    assert!(lo < value && value < hi, "{total}");
    // The form on the list of runs sends the parameter `runs` once for each run.
    let page = dashboard.get("/compare?runs=1&runs=2").await;
    assert!(page.text().contains("<h2 id=\"cd-h\">Difference to "), "{}", page.text());
    let other_way = dashboard.get("/api/v1/compare?runs=1,2&baseline=2").await.json();
    assert_eq!((&compared["baseline"], &other_way["baseline"]), (&"A".into(), &"B".into()));
    let reversed = total_of(&other_way);
    assert_eq!(reversed["value"].as_f64(), Some(-value), "{reversed}");
    assert_eq!((&total["configuration"], &reversed["configuration"]), (&"B".into(), &"A".into()));
    assert!(page.text().contains("http://127.0.0.1:8040/api/v1/runs/{1,2}/export"), "{}", page.text());
    assert!(page.text().contains("peernet compare run-1.csv run-2.csv"), "{}", page.text());
    // A run that is given twice is compared once.
    let again = dashboard.get("/api/v1/compare?runs=1,1").await.json();
    assert_eq!(
        (&again["best"], again["configurations"].as_array().map(Vec::len)),
        (&serde_json::Value::Null, Some(1))
    );

    for (address, status) in [
        ("/compare?runs=99", StatusCode::NOT_FOUND),
        ("/compare?experiment=none", StatusCode::NOT_FOUND),
        ("/compare?runs=x", StatusCode::BAD_REQUEST),
        ("/compare?run=1", StatusCode::BAD_REQUEST),
        ("/compare?runs=1,2&baseline=3", StatusCode::BAD_REQUEST),
        ("/api/v1/compare?runs=1&stage=upload", StatusCode::BAD_REQUEST),
        ("/api/v1/compare", StatusCode::BAD_REQUEST),
    ] {
        assert_eq!(dashboard.get(address).await.status, status, "{address}");
    }
    let (page, api) = (dashboard.get("/compare?run=1").await, dashboard.get("/api/v1/compare?run=1").await);
    let known = "run: unknown parameter; valid are runs or experiment";
    assert!(page.text().contains(&format!("{known}, and optionally stage and baseline")), "{}", page.text());
    assert!(api.text().contains(&format!("{known}, and optionally baseline\"")), "{}", api.text());
}

/// Counts and means are equal, and standard deviations are equal up to their last digits. The quantiles differ by at
/// most the 1 % of the sketch. Intervals come from 30 batches of the run. The store has one mean for each second and
/// the file has each iteration, so their batches begin at different times. The width of such an interval varies by 13 %
/// (standard deviation), so the test permits a difference of half the width at each end.
#[tokio::test]
async fn run_files_and_store_give_same_comparison() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut runs = Vec::new();
    for run in [1, 2] {
        let file = folder.path().join(format!("run-{run}.csv"));
        let exported = dashboard.get(&format!("/api/v1/runs/{run}/export")).await;
        std::fs::write(&file, exported.text()).expect("the folder is writable");
        runs.push(ResultFolder::open(&file).expect("a file of results"));
    }
    let of_files = Comparison::new(&runs);
    let (baseline, other, seed) = (0, 1, 1);
    let differences = Differences::between_lines(&of_files, &runs, baseline, other, seed);
    let of_store = dashboard.get("/api/v1/compare?runs=1,2").await.json();
    for (at, line) in of_files.lines.iter().enumerate() {
        for name in ["sensing", "inference", "total"] {
            let latency = line.latency(name).expect("measured");
            let stages = of_store["configurations"][at]["stages"].as_array().expect("stages");
            let stage = stages.iter().find(|stage| stage["name"] == name).expect("measured");
            let stored = |key: &str| stage[key].as_f64().expect("a number");
            assert_eq!(stage["count"], latency.count, "{name}");
            assert!((stored("mean") / latency.mean - 1.0).abs() < 1e-9, "{name}: {stage} {latency:?}");
            let std = latency.std.expect("several values");
            assert!(
                (stored("std") - std).abs() < 1e-9 * std.max(latency.mean),
                "{name}: {stage} {latency:?}"
            );
        }
    }
    assert_eq!(of_store["best"], ["A", "B"][of_files.best.expect("both have a mean")]);
    for stage in &differences.stages {
        let of_stage = |found: &&serde_json::Value| found["name"] == stage.stage.as_str();
        let found = of_store["differences"].as_array().expect("differences").iter().find(of_stage);
        let found = found.unwrap_or_else(|| panic!("{} is compared in files only", stage.stage));
        let difference = stage.mean_difference;
        assert!((found["value"].as_f64().expect("a number") - difference.value).abs() < 1e-9, "{found}");
        let (lo, hi) = difference.interval.expect("enough iterations");
        // Constant values have a width of 0, apart from rounding.
        let tolerance = 0.5 * (hi - lo) + 1e-12;
        for (end, of_file) in found["interval"].as_array().expect("two ends").iter().zip([lo, hi]) {
            let end = end.as_f64().expect("a number");
            assert!((end - of_file).abs() <= tolerance, "{}: {found} {lo} {hi}", stage.stage);
        }
        let is_near_zero = lo.abs().min(hi.abs()) < tolerance;
        assert!(is_near_zero || found["certain"].as_bool() == difference.is_distinct(), "{found} {stage:?}");
    }
    assert!(differences.stages.len() >= 3, "{of_store}");
}

#[tokio::test]
async fn repeated_run_after_interruption_counts_once() {
    let (dashboard, mut site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    site.store_run_with_each_end_reason(100, &["stopped", "finished"]).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let (id, first) =
        (listed["experiments"][0]["id"].as_str().expect("an id"), &listed["experiments"][0]["oldest"]);
    let first = first.as_i64().expect("a number");
    let compared = dashboard.get(&format!("/api/v1/compare?experiment={id}")).await.json();
    let configurations = compared["configurations"].as_array().expect("configurations");
    assert_eq!(configurations.len(), 1, "{compared}");
    assert_eq!(configurations[0]["runs"], serde_json::json!([first + 1]), "{compared}");
    assert_eq!(compared["left_out"], serde_json::json!([{ "run": first, "why": "interrupted" }]));
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    let expected = format!("<a href=\"/runs/{first}\">#{first}</a> (interrupted)</span>");
    assert!(page.text().contains(&expected), "{}", page.text());
    assert!(page.text().contains("<span>1 run</span>"), "{}", page.text());

    // A run that is selected by its number is compared even if it was interrupted.
    let named = dashboard.get(&format!("/api/v1/compare?runs={first},{}", first + 1)).await.json();
    assert_eq!(named["configurations"].as_array().map(Vec::len), Some(2), "{named}");
    assert_eq!(named["left_out"], serde_json::json!([]));
    // The trust report says that the run was interrupted.
    let doubts = named["doubts"].as_array().expect("sentences");
    assert_eq!(doubts.len(), 1, "{doubts:?}");
    assert!(
        doubts[0].as_str().is_some_and(|text| text.contains("can be published only with caveats")),
        "{doubts:?}"
    );

    site.store_run_with_each_end_reason(50, &["stopped"]).await;
    let listed = dashboard.get("/api/v1/experiments").await.json();
    let id = listed["experiments"][0]["id"].as_str().expect("an id");
    let page = dashboard.get(&format!("/compare?experiment={id}")).await;
    assert_eq!(page.status, StatusCode::OK, "{}", page.text());
    assert!(page.text().contains("No run of this experiment has finished yet"), "{}", page.text());
}
