//! Pages over stored data.

use axum::http::StatusCode;
use peernet_clock::{ClockIdentity, Span};
use peernet_logger::HostId;
use peernet_stream::{HostDescription, ToAggregator};
use serde_json::json;

use crate::test_dashboard::TestDashboard;
use crate::test_site::{Agent, TestPipeline, host};

#[tokio::test]
async fn every_page_is_complete_without_script() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![
        TestPipeline::local(),
        TestPipeline::full(),
        TestPipeline::resized(),
    ])
    .await;
    let slowest = dashboard.get("/api/v1/runs/3/iterations?order=slowest&limit=1").await.json();
    let slowest = format!("/runs/3/iterations/{}", slowest["iterations"][0]["number"]);
    let pages = [
        ("/", "offload-resized"),
        ("/pipelines", "offload-full"),
        ("/pipelines/cam-2/offload-full", "±0.09"),
        ("/pipelines/cam-2/offload-full?window=60", "over the last 60"),
        ("/runs", "#3"),
        ("/runs?pipeline=local", "Runs of local"),
        ("/runs?pipeline=nobody", "No run of nobody is stored"),
        ("/runs?before=1", "No older run is stored"),
        ("/runs/3", "Slowest iterations"),
        ("/runs/3?stage=upload&view=cumulative&scale=log", "Distribution of upload"),
        (&slowest, "× the run&#39;s median: "),
        ("/links", "2 links: 1 can be trusted, 1 with some delays known only as intervals"),
        ("/links/cam-3~rack-a", "upload times can be trusted to ±0."),
        ("/links/cam-3~rack-a", "by wlan0, wireless, MTU 1,500\u{202f}bytes"),
        ("/links/cam-3~rack-a?range=1h&offset=measured", "clock offset of rack-a, ms"),
        ("/links/cam-3~rack-a?range=24h", "in-band, 6,120 exchanges"),
        ("/hosts", "4 hosts, all connected"),
        ("/hosts", "produced = acknowledged + waiting + dropped"),
        ("/hosts/cam-1", "In the database"),
        ("/hosts/cam-2", "within ±2.1\u{202f}ms of true time"),
        ("/hosts/cam-2", "1 model loaded, 96"),
        ("/incidents", "stepped by +18.2 ms"),
        ("/incidents", "model-unloaded"),
        ("/incidents?kind=clock-step&host=", "stepped by +18.2 ms"),
        ("/incidents?kind=control&host=nobody", "No incident of this kind and host is stored"),
    ];
    for (path, text) in pages {
        let answer = dashboard.get(path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}: {}", answer.text());
        assert!(answer.header("content-type").starts_with("text/html"), "{path}");
        assert!(answer.text().contains(text), "{path} lacks {text:?}: {}", answer.text());
        assert!(answer.text().contains("<h1"), "{path}");
        assert!(!answer.text().contains(" style="), "{path}: the policy refuses inline styles");
        let policy = answer.header("content-security-policy");
        assert!(
            policy.contains("script-src 'self';") && policy.contains("default-src 'none'"),
            "{path}: {policy}"
        );
        assert!(!policy.contains("unsafe"), "{path}: {policy}");
    }
}

#[tokio::test]
async fn empty_aggregator_shows_how_to_start_an_edge() {
    let dashboard = TestDashboard::empty().await;
    let home = dashboard.get("/").await;
    assert!(home.text().contains("No host has reported yet"));
    assert!(
        home.text().contains(&dashboard.listening)
            && home.text().contains("peernetd check configs/edge.toml")
    );
    for (path, text) in [
        ("/pipelines", "No pipeline has reported yet"),
        ("/runs", "No run is stored yet"),
        ("/links", "A link appears with the first pipeline whose placement is"),
        ("/hosts", "No host has reported yet"),
        ("/incidents", "No incident is stored"),
    ] {
        let answer = dashboard.get(path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}");
        assert!(answer.text().contains(text), "{path}: {}", answer.text());
    }
}

#[tokio::test]
async fn unrelated_clocks_show_dashes_and_exact_sum() {
    let (dashboard, _site) = TestDashboard::with_pipelines(vec![TestPipeline::unrelated()]).await;
    let run = dashboard.get("/runs/1").await;
    assert!(run.text().contains("unsynchronised"), "{}", run.text());
    assert!(run.text().contains(">up + down </tspan>"), "{}", run.text());
    let iteration = dashboard.get("/runs/1/iterations/100").await;
    assert!(iteration.text().contains("class=\"chip bad\""), "{}", iteration.text());
    assert!(iteration.text().contains("and so is upload + download = "), "{}", iteration.text());
    let delays = iteration.text().split("How the one-way delays were computed").nth(1).expect("a panel");
    let delays = delays.split("</section>").next().expect("an end tag");
    assert_eq!(delays.matches("<b>—</b>").count(), 2, "no direction has a value: {delays}");
}

#[tokio::test]
async fn missing_page_is_an_error_page() {
    let dashboard = TestDashboard::empty().await;
    for path in [
        "/nothing",
        "/runs/7",
        "/runs/seven",
        "/runs/7/iterations/1",
        "/hosts/nobody",
        "/pipelines/a/b",
        "/links/a~b",
        "/links/a",
    ] {
        let answer = dashboard.get(path).await;
        assert_eq!(answer.status, StatusCode::NOT_FOUND, "{path}");
        assert!(answer.header("content-type").starts_with("text/html"), "{path}");
        assert!(answer.text().contains("<h1>Not Found</h1>"), "{path}: {}", answer.text());
    }
    let answer = dashboard.get("/runs?bfore=3").await;
    assert_eq!(answer.status, StatusCode::BAD_REQUEST);
    assert!(answer.text().contains("bfore"), "{}", answer.text());
}

#[tokio::test]
async fn unrecorded_events_are_shown_with_reason() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    assert!(!dashboard.get("/runs/1").await.text().contains("of this run were not recorded"));
    // Three gaps of 974 events.
    site.store_gaps(0, 3).await;
    let page = dashboard.get("/runs/1").await;
    let expected = "2,922 events of this run were not recorded: no room in the agent&#39;s spool (from ";
    assert!(page.text().contains(expected) && page.text().contains(", in 3 gaps)."), "{}", page.text());
}

#[tokio::test]
async fn run_is_running_while_its_host_reports_it() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    site.store_unfinished_run_of_each_pipeline(30).await;
    for current in [Some(2), None] {
        if current.is_none() {
            site.pipelines[0].run = None;
        }
        let now = dashboard.clock.wall();
        site.report(now, now).await;
        dashboard.wait_until(|live_state| live_state.pipelines[0].run_number == current).await;
        let page = dashboard.get("/runs/2").await;
        assert_eq!(page.text().contains("still running"), current.is_some(), "{}", page.text());
        assert_eq!(page.text().contains("no end was reported; last iteration on"), current.is_none());
    }
    assert!(dashboard.get("/runs").await.text().contains("no end was reported, last iteration"));
}

#[tokio::test]
async fn links_with_all_clock_relations_are_shown() {
    let pipelines = vec![
        TestPipeline::with_clock_fault(),
        TestPipeline { host: "cam-4", ..TestPipeline::unrelated() },
        TestPipeline { host: "cam-5", ..TestPipeline::one_clock() },
    ];
    let (dashboard, _site) = TestDashboard::with_pipelines(pipelines).await;
    for (path, text) in [
        (
            "/links",
            "3 links: 1 can be trusted, 1 with some delays known only as intervals, 1 cannot be trusted",
        ),
        ("/links/cam-4~rack-a", "the two clocks were never related, so one-way delays are not known"),
        ("/links/cam-4~rack-a", ">nothing known in this time</text>"),
        ("/links/cam-5~rack-a", "cam-5 and rack-a read one clock: delays between them are exact"),
        (
            "/links/cam-3~rack-a",
            "cam-3&#39;s clock is made wrong on purpose (offset +1000 ms, drift +50 ppm)",
        ),
        ("/runs/1", "#i-clock-fault\"/></svg>clock fault"),
        ("/runs/1/iterations/100", "#i-clock-fault\"/></svg>clock fault"),
        ("/runs/1/iterations/100", "href=\"/links/cam-3~rack-a\""),
        ("/runs/1", "href=\"/links/cam-3~rack-a\""),
        ("/pipelines/cam-3/offload-resized", "#i-clock-fault\"/></svg>clock fault"),
        ("/incidents", "is made wrong on purpose"),
    ] {
        let answer = dashboard.get(path).await;
        assert_eq!(answer.status, StatusCode::OK, "{path}: {}", answer.text());
        assert!(answer.text().contains(text), "{path} lacks {text:?}: {}", answer.text());
    }
    assert!(!dashboard.get("/runs/2").await.text().contains("#i-clock-fault\"/></svg>clock fault"));
}

#[tokio::test]
async fn name_of_two_hosts_means_connected_host() {
    let (dashboard, mut site) = TestDashboard::with_pipelines(vec![TestPipeline::local()]).await;
    // The computer of cam-1 is installed again, so its host id changes.
    site.agents[0].send_message(&ToAggregator::Goodbye(site.agents[0].id())).await;
    dashboard.wait_until(|live_state| live_state.hosts.iter().any(|host| host.has_left)).await;
    let description = HostDescription {
        // This id is greater than every random id, so hosts that are sorted by their ids have the wrong order.
        id: HostId::from_bytes([0xff; 16]),
        ..host("cam-1", "NVIDIA Jetson Orin NX", ClockIdentity::new("cam-1", "system"))
    };
    site.agents[0] = Agent::new(description, &dashboard.listening, &dashboard.clock).await;
    site.agents[0].wait_until_connected().await;
    site.store_run_of_each_pipeline(100).await;
    let now = dashboard.clock.wall();
    site.report(now - Span::from_seconds(5), now).await;
    dashboard.wait_until(|live_state| live_state.pipelines.len() == 2).await;

    let id = site.agents[0].id().to_string();
    assert_eq!(dashboard.get("/api/v1/hosts/cam-1").await.json()["id"], json!(id));
    assert_eq!(dashboard.get("/api/v1/pipelines/cam-1/local").await.json()["host_id"], json!(id));
    let runs = dashboard.get("/api/v1/runs?host=cam-1").await.json();
    let numbers = runs["runs"].as_array().expect("runs").iter().map(|run| run["number"].clone());
    assert_eq!(numbers.collect::<Vec<_>>(), [json!(2)], "run 1 is a run of the old host");
    let host_page = dashboard.get("/hosts/cam-1").await;
    assert!(host_page.text().contains(&id), "{}", host_page.text());
    let pipeline_page = dashboard.get("/pipelines/cam-1/local").await;
    assert!(pipeline_page.text().contains("\"/runs/2\""), "{}", pipeline_page.text());
    assert!(!pipeline_page.text().contains("\"/runs/1\""), "{}", pipeline_page.text());
}
