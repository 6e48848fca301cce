//! The REST API.

use std::collections::{BTreeSet, HashSet};

use axum::body::Body;
use axum::http::{Request, StatusCode};
use serde_json::{Value, json};

use crate::test_dashboard::{ITERATIONS, TestDashboard};
use crate::test_site::{TestPipeline, WARM_UP_ITERATIONS};

/// Every route, with an address of that route that exists when two pipelines have a stored run each.
const ROUTES: &[(&str, &str)] = &[
    ("/api/v1/hosts", "/api/v1/hosts"),
    ("/api/v1/hosts/{host}", "/api/v1/hosts/cam-2"),
    ("/api/v1/links", "/api/v1/links"),
    ("/api/v1/links/{link}", "/api/v1/links/cam-2~rack-a"),
    ("/api/v1/links/{link}/clock", "/api/v1/links/cam-2~rack-a/clock?points=20"),
    ("/api/v1/pipelines", "/api/v1/pipelines"),
    ("/api/v1/pipelines/{host}/{pipeline}", "/api/v1/pipelines/cam-2/offload-full"),
    ("/api/v1/live", "/api/v1/live?topics=picture"),
    ("/api/v1/runs", "/api/v1/runs"),
    ("/api/v1/runs/{run}", "/api/v1/runs/2"),
    ("/api/v1/runs/{run}/stages", "/api/v1/runs/2/stages"),
    ("/api/v1/runs/{run}/series", "/api/v1/runs/2/series?stages=total,upload"),
    ("/api/v1/runs/{run}/histogram", "/api/v1/runs/2/histogram?stage=upload&bins=20"),
    ("/api/v1/runs/{run}/recomputed", "/api/v1/runs/2/recomputed"),
    ("/api/v1/runs/{run}/trust", "/api/v1/runs/2/trust"),
    ("/api/v1/compare", "/api/v1/compare?runs=1,2"),
    ("/api/v1/experiments", "/api/v1/experiments"),
    ("/api/v1/runs/{run}/iterations", "/api/v1/runs/2/iterations?limit=5"),
    ("/api/v1/runs/{run}/iterations/{iteration}", "/api/v1/runs/2/iterations/100"),
    ("/api/v1/runs/{run}/export", "/api/v1/runs/2/export?format=csv"),
    ("/api/v1/incidents", "/api/v1/incidents"),
    ("/healthz", "/healthz"),
    ("/readyz", "/readyz"),
    ("/metrics", "/metrics"),
];
/// Routes that only change something, and have no GET operation.
const CHANGES: [&str; 1] = ["/api/v1/runs/{run}/pin"];

#[tokio::test]
async fn openapi_describes_every_route() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let document = dashboard.get("/api/openapi.json").await.json();
    let paths = document["paths"].as_object().expect("paths");
    let described: BTreeSet<&str> = paths.keys().map(String::as_str).collect();
    let listed: BTreeSet<&str> = ROUTES.iter().map(|(route, _)| *route).chain(CHANGES).collect();
    let (untested, undescribed): (Vec<_>, Vec<_>) =
        (described.difference(&listed).collect(), listed.difference(&described).collect());
    assert!(
        untested.is_empty() && undescribed.is_empty(),
        "described but not in ROUTES: {untested:?}; in ROUTES but not described: {undescribed:?}"
    );
    let mut operations = HashSet::new();
    for &(route, address) in ROUTES {
        let id = document["paths"][route]["get"]["operationId"].as_str().unwrap_or_default().to_owned();
        assert!(
            !id.is_empty() && operations.insert(id.clone()),
            "{route}: the id {id:?} is empty or of another operation, too"
        );
        let operation = &document["paths"][route]["get"];
        assert!(!operation["summary"].as_str().unwrap_or_default().is_empty(), "{route} has no summary");
        // A stream never ends, so only the head of each answer is checked.
        let response = dashboard.send(Request::get(address).body(Body::empty()).expect("a request")).await;
        assert_eq!(response.status(), StatusCode::OK, "{address}");
    }
    let schemas = document["components"]["schemas"].as_object().expect("schemas");
    let text = document.to_string();
    let references = text.split("#/components/schemas/").skip(1);
    let names: BTreeSet<&str> =
        references.map(|rest| rest.split('"').next().expect("a split has a part")).collect();
    let missing: Vec<_> = names.iter().filter(|name| !schemas.contains_key(**name)).collect();
    assert!(
        names.len() > 10 && missing.is_empty(),
        "{} schemas are named, missing are {missing:?}",
        names.len()
    );
}

#[tokio::test]
async fn live_and_stored_figures_are_served() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;

    let pipelines = dashboard.get("/api/v1/pipelines").await.json();
    let full = &pipelines["pipelines"][1];
    assert_eq!(
        (&full["name"], &full["host"], &full["state"]),
        (&json!("offload-full"), &json!("cam-2"), &json!("running"))
    );
    assert_eq!(full["placement"]["peer"], "rack-a");
    let minute = &full["windows"][2];
    assert_eq!(minute["seconds"], 60);
    let total = minute["values"]
        .as_array()
        .expect("values")
        .iter()
        .find(|value| value["name"] == "total")
        .expect("a total");
    let p50 = total["p50"].as_f64().expect("a median");
    assert!((0.019..0.025).contains(&p50), "{p50}");
    assert_eq!(full["seconds"].as_array().expect("seconds").len(), 5, "a list has the last five seconds");
    let one = dashboard.get("/api/v1/pipelines/cam-2/offload-full").await.json();
    assert!(one["seconds"].as_array().expect("seconds").len() > 30);

    let runs = dashboard.get("/api/v1/runs").await.json();
    assert_eq!(runs["runs"][0]["number"], 2);
    assert_eq!(runs["next"], Value::Null);
    let run = dashboard.get("/api/v1/runs/2").await.json();
    assert_eq!((&run["reason"], &run["warm_up"]), (&json!("finished"), &json!(WARM_UP_ITERATIONS)));
    assert_eq!(run["counts"]["ok"], ITERATIONS - WARM_UP_ITERATIONS);
    assert!(run["started"].as_str().expect("a time").ends_with('Z'));

    let stages = dashboard.get("/api/v1/runs/2/stages").await.json();
    let share: f64 = stages["stages"]
        .as_array()
        .expect("stages")
        .iter()
        .filter(|stage| stage["is_stage"] == true)
        .filter_map(|stage| stage["share"].as_f64())
        .sum();
    assert!((0.95..=1.0).contains(&share), "{share}");
    assert_eq!(stages["bounds"][0]["stage"], "upload");
    let mean = |name: &str| {
        let found = stages["stages"].as_array().expect("stages").iter().find(|stage| stage["name"] == name);
        found.and_then(|stage| stage["mean"].as_f64()).expect("measured")
    };
    let speed = stages["speed_while_sending"]["upload_bits_per_second"].as_f64().expect("delays are known");
    let exact = 8.0 * (mean("upload-bytes") + mean("upload-logger-bytes")) / mean("upload");
    assert!((speed / exact - 1.0).abs() < 1e-9, "{speed}, but {exact}");

    let histogram = dashboard.get("/api/v1/runs/2/histogram?stage=upload&bins=20").await.json();
    let counts: u64 = histogram["counts"].as_array().expect("counts").iter().filter_map(Value::as_u64).sum();
    let outside = ["below", "beyond"].map(|end| histogram[end].as_u64().expect("a count"));
    assert_eq!(counts + outside.iter().sum::<u64>(), ITERATIONS - WARM_UP_ITERATIONS);

    let iteration = dashboard.get("/api/v1/runs/2/iterations/100").await.json();
    assert_eq!(
        (&iteration["number"], &iteration["previous"], &iteration["next"]),
        (&json!(100), &json!(99), &json!(101))
    );
    assert!(iteration["tree"]["nodes"].as_array().expect("nodes").len() > 10);
    let hosts = dashboard.get("/api/v1/hosts").await.json();
    assert_eq!(hosts["hosts"].as_array().expect("hosts").len(), 3);
    assert_eq!(hosts["hosts"][1]["description"]["gpus"][0], "NVIDIA Jetson Orin NX");
}

#[tokio::test]
async fn percentile_buckets_hold_sixty_iterations() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::full()]).await;
    let one = dashboard.get("/api/v1/pipelines/cam-2/offload-full").await.json();
    let over_time = &one["total_over_time"];
    assert_eq!(over_time["bucket_s"], 5, "150 iterations at 30 Hz; 2 s would hold 60 or 59: {over_time}");
    let points = over_time["points"].as_array().expect("points");
    assert!((12..=15).contains(&points.len()), "{over_time}");
    for point in points {
        assert_eq!(point["at"].as_i64().expect("a time") % 5, 0, "{point}");
        assert!(point["count"].as_u64().is_some_and(|count| count >= 60), "{point}");
        assert!(point["p95"].as_f64().is_some_and(|p95| p95 > 0.0), "{point}");
    }
    let seconds = one["seconds"].as_array().expect("seconds");
    assert!(!seconds.is_empty(), "{one}");
    assert!(
        seconds.iter().all(|second| second["total_p95"].is_null()),
        "30 iterations in a second: {seconds:?}"
    );

    let listed = &dashboard.get("/api/v1/pipelines").await.json()["pipelines"][0]["total_over_time"];
    let listed = listed["points"].as_array().expect("points").len();
    assert!((1..=2).contains(&listed), "the buckets of the last five seconds: {listed}");
}

#[tokio::test]
async fn speed_is_bytes_over_transfer_times() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let one = dashboard.get("/api/v1/pipelines/cam-2/offload-full").await.json();
    let minute = &one["windows"][2];
    let mean = |name: &str| {
        let values = minute["values"].as_array().expect("values");
        let found = values.iter().find(|value| value["name"] == name);
        found.and_then(|value| value["mean"].as_f64()).unwrap_or_default()
    };
    let bits = 8.0 * (mean("upload-bytes") + mean("upload-logger-bytes"));
    let upload = &minute["transfers"]["upload"];
    let speed = upload["speed_bits_per_second"].as_f64().expect("delays are known");
    assert!((speed / (bits / mean("upload")) - 1.0).abs() < 1e-6, "{upload}");
    let traffic = upload["traffic_bits_per_second"].as_f64().expect("something was sent");
    let rate =
        minute["counts"]["ok"].as_f64().expect("a count") / minute["covered_s"].as_f64().expect("seconds");
    assert!((traffic / (bits * rate) - 1.0).abs() < 1e-6 && traffic < speed, "{upload}");
    let second = &one["seconds"][1]["transfers"]["upload"];
    assert_eq!(second["bytes"], second["timed_bytes"], "all delays are known: {second}");

    let local =
        dashboard.get("/api/v1/pipelines").await.json()["pipelines"][0]["windows"][2]["transfers"].clone();
    assert_eq!(local, json!({ "upload": null, "download": null }));
}

#[tokio::test]
async fn pipeline_query_selects_window_and_stages() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::full()]).await;
    let all = dashboard.get("/api/v1/pipelines").await;
    let few = dashboard.get("/api/v1/pipelines?window=10&stage=total,upload").await;
    assert!(few.text().len() * 3 < all.text().len(), "{} of {}", few.text().len(), all.text().len());
    let one = dashboard.get("/api/v1/pipelines/cam-2/offload-full?window=10&stage=total,upload").await.json();
    for pipeline in [&few.json()["pipelines"][1], &one] {
        let windows = pipeline["windows"].as_array().expect("windows");
        assert_eq!((windows.len(), &windows[0]["seconds"]), (1, &json!(10)), "{pipeline}");
        let names = |list: &Value, key: &str| -> HashSet<String> {
            list.as_array()
                .expect("a list")
                .iter()
                .map(|one| one[key].as_str().expect("a name").to_owned())
                .collect()
        };
        let selected = HashSet::from(["total".to_owned(), "upload".to_owned()]);
        assert_eq!(names(&windows[0]["values"], "name"), selected, "{pipeline}");
        assert_eq!(names(&windows[0]["bounds"], "stage"), HashSet::from(["upload".to_owned()]), "{pipeline}");
        let seconds = pipeline["seconds"].as_array().expect("seconds");
        assert!((1..=10).contains(&seconds.len()), "{pipeline}");
        let mut lists = seconds.iter().flat_map(|second| [&second["means"], &second["parts"]]);
        assert!(lists.all(|list| list.get("inference").is_none()), "{pipeline}");
    }
    let unknown_stage = dashboard.get("/api/v1/pipelines?window=60&stage=no-such-stage").await.json();
    assert_eq!(unknown_stage["pipelines"][1]["windows"][0]["values"], json!([]), "{unknown_stage}");
}

#[tokio::test]
async fn lists_are_paged_without_loss_or_repetition() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    for _ in 0..4 {
        site.store_run_of_each_pipeline(5).await;
    }
    let mut seen = Vec::new();
    let mut next = String::new();
    loop {
        let page = dashboard.get(&format!("/api/v1/runs?limit=2{next}")).await.json();
        seen.extend(
            page["runs"]
                .as_array()
                .expect("runs")
                .iter()
                .map(|run| run["number"].as_i64().expect("a number")),
        );
        match page["next"].as_i64() {
            Some(before) => next = format!("&before={before}"),
            None => break,
        }
    }
    assert_eq!(seen, [5, 4, 3, 2, 1]);
    let mut after = 0;
    let mut numbers = Vec::new();
    while let Some(next) = {
        let page = dashboard.get(&format!("/api/v1/runs/1/iterations?limit=150&after={after}")).await.json();
        numbers.extend(
            page["iterations"].as_array().expect("rows").iter().filter_map(|row| row["number"].as_u64()),
        );
        page["next"].as_u64()
    } {
        after = next;
    }
    assert_eq!(numbers, (1..=ITERATIONS).collect::<Vec<_>>());
}

#[tokio::test]
async fn export_has_one_row_per_iteration() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::full()]).await;
    let answer = dashboard.get("/api/v1/runs/1/export?format=csv").await;
    assert!(answer.header("content-type").starts_with("text/csv"));
    assert_eq!(answer.header("content-disposition"), "attachment; filename=\"offload-full-1.csv\"");
    let mut table = csv::Reader::from_reader(answer.body.as_slice());
    let header = table.headers().expect("a header").clone();
    let published: Vec<&str> = peernet_analysis::rows::published_columns().collect();
    assert_eq!(header.iter().take(published.len()).collect::<Vec<_>>(), published);
    let upload = header.iter().position(|name| name == "upload").expect("a column");
    let rows: Vec<csv::StringRecord> = table.records().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len() as u64, ITERATIONS);
    let seconds: f64 = rows[99][upload].parse().expect("a number");
    assert!((0.005..0.1).contains(&seconds), "{seconds}");
    let cell = |name: &str| {
        let at = header.iter().position(|known| known == name).unwrap_or_else(|| panic!("no column {name}"));
        rows[99][at].to_owned()
    };
    let number =
        |name: &str| cell(name).parse::<f64>().unwrap_or_else(|_| panic!("{name}: {:?}", cell(name)));
    for direction in ["upload", "download"] {
        let (lo, hi) = (number(&format!("{direction}-lo")), number(&format!("{direction}-hi")));
        assert!(
            lo <= number(direction) && number(direction) <= hi && hi - lo < 0.001,
            "{direction}: {lo} to {hi}"
        );
        assert_eq!(cell(&format!("{direction}-source")), "in-band");
        assert!(number(&format!("{direction}-raw")).abs() > 1.0, "the rack's clock is 1.2 s ahead");
    }
    // The test's trees have a node `gpu-power` of 11.5 W.
    let sensing = number("capture") + number("transform");
    assert!((sensing - number("sensing")).abs() < 1e-9 && number("gpu-power") == 11.5, "{sensing}");
    assert!(number("upload-bytes") > 0.0 && number("upload-throughput-lo") < number("upload-throughput"));
    assert!((number("at") - dashboard.clock.wall().unix_nanos() as f64 / 1e9).abs() < 3_600.0);
    assert_eq!((cell("upload-verdict").as_str(), cell("warm-up").as_str()), ("ok", "0"));

    // The export can be opened like any other file of rows.
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("export.csv");
    std::fs::write(&file, &answer.body).expect("writable");
    let loaded = peernet_results::ResultFolder::open(&file).expect("a result file");
    let run = dashboard.get("/api/v1/runs/1").await.json();
    assert_eq!(serde_json::json!(loaded.record.counts.ok), run["counts"]["ok"]);
    assert_eq!(serde_json::json!(loaded.record.counts.warm_up), run["warm_up"], "{run}");
}

#[tokio::test]
async fn stages_and_both_ways_add_up_to_total() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::unrelated()]).await;
    let iteration = dashboard.get("/api/v1/runs/1/iterations/100").await.json();
    let number = |value: &Value| value.as_f64().expect("a number");
    let stages = iteration["stages"].as_array().expect("stages");
    let upload = stages.iter().find(|stage| stage["name"] == "upload").expect("the upload was judged");
    assert_eq!((&upload["seconds"], &upload["delay"]["lo_s"]), (&Value::Null, &Value::Null));
    assert_eq!(upload["delay"]["verdict"], "unsynchronised");
    assert!(number(&upload["delay"]["raw_s"]) > 1.0, "{upload}");
    assert_eq!(stages[0]["delay"], Value::Null, "sensing has no one-way delay: {}", stages[0]);
    let others: f64 = stages.iter().filter_map(|stage| stage["seconds"].as_f64()).sum();
    let all = others + number(&iteration["both_ways"]) + number(&iteration["unattributed"]);
    assert!((all - number(&iteration["total"])).abs() < 1e-9, "{iteration}");

    let csv = dashboard.get("/api/v1/runs/1/export").await;
    let mut table = csv::Reader::from_reader(csv.body.as_slice());
    let header = table.headers().expect("a header").clone();
    let row = table.records().nth(99).expect("a row").expect("complete");
    let cell = |name: &str| row[header.iter().position(|known| known == name).expect("a column")].to_owned();
    assert_eq!((cell("upload"), cell("upload-lo")), (String::new(), String::new()));
    assert_eq!(cell("upload-verdict"), "unsynchronised");
    assert!(!cell("upload-raw").is_empty() && !cell("unattributed").is_empty());
}

#[tokio::test]
async fn runs_with_clock_fault_are_marked_in_lists() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::with_clock_fault()]).await;
    let runs = dashboard.get("/api/v1/runs").await.json();
    let marks: Vec<&Value> =
        runs["runs"].as_array().expect("runs").iter().map(|run| &run["rehearsed"]).collect();
    assert_eq!(marks, [&json!(true), &json!(false)]);
    assert_eq!(dashboard.get("/api/v1/runs/2").await.json()["rehearsed"], json!(true));
    let page = dashboard.get("/runs").await.text().to_owned();
    let row = |number: u32| {
        let begin = page.find(&format!("\"/runs/{number}\"")).expect("a row");
        let rest = &page[begin..];
        rest[..rest.find("</tr>").expect("an end tag")].to_owned()
    };
    assert!(row(2).contains("clock fault") && !row(1).contains("clock fault"), "{page}");
}

#[tokio::test]
async fn links_and_clocks_are_served() {
    let (dashboard, _site) =
        TestDashboard::with_pipelines(vec![TestPipeline::local(), TestPipeline::with_clock_fault()]).await;
    let links = dashboard.get("/api/v1/links").await.json();
    let link = &links["links"][0];
    assert_eq!((&link["name"], &link["connected"]), (&json!("cam-3~rack-a"), &json!(true)));
    let now = &link["now"];
    assert_eq!((&now["same_clock"], &now["verdict"]), (&json!(false), &json!("limited")));
    assert_eq!((&now["probing"]["state"], &now["probing"]["rate_hz"]), (&json!("on"), &json!(10.0)));
    assert_eq!(now["edge_clock"]["rehearsal"]["offset_s"], json!(1.0));
    assert_eq!(now["exchanges"]["outliers"], json!(5));
    let offset = &now["offset"];
    let number = |value: &Value| value.as_f64().expect("a number");
    let (lo, estimate, hi) =
        (number(&offset["lo_s"]), number(&offset["estimate_s"]), number(&offset["hi_s"]));
    assert!(lo <= estimate && estimate <= hi && (1.2..1.21).contains(&estimate), "{offset}");
    assert_eq!(offset["sources"][1]["source"], "chrony");
    assert!(number(&now["up"]["median"]["lo_s"]) <= number(&now["up"]["median"]["value_s"]));
    assert_eq!(dashboard.get("/api/v1/links/cam-3~rack-a").await.json()["edge_id"], link["edge_id"]);
    let assumptions = json!({
        "clocks": "wall", "max_drift_ppm": 50.0, "max_drift_change_ppm_per_s": null, "claims_trusted": true,
        "probes_authenticated": false,
    });
    assert_eq!(link["assumptions"], assumptions);
    let promise = link["promise"].as_str().expect("a sentence");
    assert!(
        promise.contains("as long as the wall clocks of both hosts drift apart by at most 50"),
        "{promise}"
    );
    assert_eq!(now["proven_skew"], json!({ "min_ppm": 10.4, "max_ppm": 14.4 }));
    assert_eq!((&now["clocks"], &now["grown_window_s"]), (&json!("wall"), &Value::Null));
    assert_eq!(now["edge_clock"]["clocksource"], "kvm-clock");
    let slowest = dashboard.get("/api/v1/runs/2/iterations?order=slowest&limit=1").await.json();
    let stages = slowest["iterations"][0]["stages"].as_array().expect("stages").clone();
    let upload = stages.iter().find(|stage| stage["name"] == "upload").expect("an upload");
    assert_eq!(
        (&upload["delay"]["assumptions"], &upload["delay"]["claims_used"]),
        (&assumptions, &json!(false))
    );
    let connection = &now["connections"][0];
    assert_eq!(connection["up"]["retransmitted_datagrams"], json!(17));
    assert_eq!(connection["down"]["retransmitted_datagrams"], Value::Null, "only the cloud counts these");
    assert_eq!(connection["interface"], json!({ "name": "wlan0", "type": "wireless", "mtu_bytes": 1500 }));
    assert_eq!(connection["transport_round_trip"]["smoothed_s"], json!(0.00231));
    let cloud = &connection["cloud"];
    assert_eq!(cloud["up"]["bytes"], connection["up"]["bytes"], "the cloud received what the edge sent");
    assert_eq!(cloud["transport_round_trip"], Value::Null);

    let series = dashboard.get("/api/v1/links/cam-3~rack-a/clock?points=600").await.json();
    let points = series["points"].as_array().expect("points");
    assert!(series["bucket_s"] == 1 && points.len() >= 100, "{} points", points.len());
    assert!(points[0]["window"].is_string() && points[0]["probes"]["sent"] == 10, "{}", points[0]);
    let to = points[49]["at"].as_str().expect("a time");
    let half = dashboard.get(&format!("/api/v1/links/cam-3~rack-a/clock?to={to}&points=600")).await.json();
    assert_eq!(half["points"].as_array().expect("points").len(), 50);
    let few = dashboard.get("/api/v1/links/cam-3~rack-a/clock?points=10").await.json();
    assert!(few["points"].as_array().expect("points").len() <= 11, "{few}");

    let host = dashboard.get("/api/v1/hosts/cam-3").await.json();
    assert_eq!(host["clock"]["text"], "chrony, stratum 3, to ntp.plant");
    assert_eq!(
        (&host["now"]["loaded_models"], &host["now"]["model_memory_bytes"]),
        (&json!(1), &json!(96_000_000))
    );
    assert_eq!(host["clock"]["rehearsal"]["drift_ppm"], json!(50.0));

    let recomputed = dashboard.get("/api/v1/runs/2/recomputed").await.json();
    assert_eq!(recomputed["run"], 2);
    let stages: Vec<&Value> =
        recomputed["stages"].as_array().expect("stages").iter().map(|one| &one["stage"]).collect();
    assert_eq!(
        (stages.len(), &stages[..1], &recomputed["clocks"]),
        (2, &[&json!("upload")][..], &json!(["wall"]))
    );
    assert!(
        recomputed["stages"][0]["before"]["delay"]["count"].as_u64().expect("a count") > 300,
        "{recomputed}"
    );

    for (address, status, word) in [
        ("/api/v1/links/cam-3", 404, "EDGE~CLOUD"),
        ("/api/v1/links/cam-3/rack-a", 404, "EDGE~CLOUD, so try cam-3~rack-a"),
        ("/api/v1/links/cam-3~nobody/clock", 404, "nobody"),
        ("/api/v1/links/cam-3~rack-a/clock?from=yesterday", 400, "from"),
        ("/api/v1/links/cam-3~rack-a/clock?points=0", 400, "points"),
        ("/api/v1/links/cam-3~rack-a/clock?from=2026-01-02T00:00:00Z&to=2026-01-01T00:00:00Z", 400, "before"),
        ("/api/v1/runs/77/recomputed", 404, "77"),
    ] {
        let answer = dashboard.get(address).await;
        assert_eq!(answer.status.as_u16(), status, "{address}");
        assert!(
            answer.json()["detail"].as_str().expect("a detail").contains(word),
            "{address}: {}",
            answer.text()
        );
    }
}
