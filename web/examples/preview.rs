//! Preview of the pages with a simulated site: `cargo run -p peernet-web --example preview`.
//!
//! The first argument without dashes is the address, by default 127.0.0.1:8040. Options:
//!
//! - `--late`: the hosts connect after ten seconds
//! - `--empty`: no host ever reports
//! - `--many`: thirty pipelines
//! - `--grid`: experiments of fifty configurations, of many users and with a repeated run, and long names
//! - `--unrelated`: clocks that were never related
//! - `--one-clock`: a camera that reads the rack's clock
//! - `--varying-answers`: a camera whose answers differ in length
//! - `--clock-fault`: a camera with an injected clock fault
//! - `--backlog`: an agent with hours of backlog, an agent whose disk is full, and a run with gaps

#[path = "../tests/it/test_site/mod.rs"]
mod test_site;

use std::sync::Arc;
use std::time::Duration;

use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_web::{WebConfig, Zone};
use test_site::{TestPipeline, TestSite};
use tokio_util::sync::CancellationToken;

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |name: &str| arguments.iter().any(|argument| argument == name);
    let listen = arguments.iter().find(|argument| !argument.starts_with("--"));

    let clock: SharedClock = Arc::new(SystemClock::new(ClockIdentity::new("rack-a", "system")));
    let stop = CancellationToken::new();
    let folder = tempfile::tempdir()?;
    let config = AggregatorConfig {
        name: Some("rack-a".parse()?),
        listen: "tcp://127.0.0.1:0".into(),
        database: folder.path().join("preview.sqlite"),
        ..AggregatorConfig::default()
    };
    let aggregator = Aggregator::start(config, clock.clone(), stop.clone()).await?;
    let listening = aggregator.handle.live().borrow().listening.clone();
    let web = WebConfig {
        listen: listen.cloned().unwrap_or_else(|| "127.0.0.1:8040".into()),
        time_zone: "+01:00".parse::<Zone>()?,
        ..WebConfig::default()
    };
    let max_connections = 64;
    let server =
        peernet_web::serve(web, aggregator.handle.clone(), clock.clone(), stop.clone(), max_connections)
            .await?;
    #[expect(clippy::print_stdout, reason = "an example prints where to look")]
    {
        println!("http://{}", server.address());
    }

    if !has("--empty") {
        let mut pipelines = vec![TestPipeline::local(), TestPipeline::full(), TestPipeline::resized()];
        if has("--unrelated") {
            pipelines.push(TestPipeline { host: "cam-4", ..TestPipeline::unrelated() });
        }
        if has("--clock-fault") {
            pipelines[2] = TestPipeline::with_clock_fault();
        }
        if has("--one-clock") {
            pipelines.push(TestPipeline { host: "cam-5", ..TestPipeline::one_clock() });
        }
        if has("--varying-answers") {
            pipelines.push(TestPipeline { host: "cam-6", ..TestPipeline::varying_answers() });
        }
        if has("--many") {
            pipelines = (0..30)
                .map(|index| TestPipeline {
                    name: NAMES[index],
                    host: HOSTS[index],
                    hz: 5.0,
                    ..pipelines[index % 3].clone()
                })
                .collect();
        }
        let pause = Duration::from_secs(if has("--late") { 10 } else { 0 });
        if has("--grid") {
            pipelines[0].name = "quality-control-of-the-welding-seam-with-a-name-of-63-characters";
            pipelines[1].host = "camera-above-the-second-conveyor-belt-in-hall-seven-to-the-left";
        }
        let (backlog, grid) = (has("--backlog"), has("--grid"));
        tokio::spawn(async move {
            tokio::time::sleep(pause).await;
            produce(listening, clock, pipelines, backlog, grid).await;
        });
    }
    tokio::signal::ctrl_c().await?;
    stop.cancel();
    server.join().await?;
    aggregator.join().await?;
    Ok(())
}

async fn produce(
    address: String,
    clock: SharedClock,
    pipelines: Vec<TestPipeline>,
    backlog: bool,
    grid: bool,
) {
    let mut site = TestSite::new(&address, clock.clone(), pipelines).await;
    // With `--many`, each pipeline has less data, so that the preview starts soon.
    let many = site.pipelines.len() >= NAMES.len();
    site.report(clock.wall() - Span::from_seconds(590), clock.wall()).await;
    site.store_incidents().await;
    site.store_clocks(if many { 120 } else { 3_600 }).await;
    site.store_run_of_each_pipeline(if many { 200 } else { 6_000 }).await;
    if backlog {
        site.store_gaps(2, 42).await;
    }
    site.store_experiment(600, 2).await;
    site.store_episodes(2_000, 250).await;
    let sizes = [30e3, 150e3, 400e3, 800e3].map(|bytes| (bytes, None));
    site.store_run_of_each_size(2.min(site.pipelines.len() - 1), 300, &sizes).await;
    if grid {
        site.store_run_of_each_configuration(100, 50).await;
        site.store_overloaded_run(0, 600, 3).await;
        site.store_run_with_each_end_reason(200, &["stopped", "finished"]).await;
        site.store_runs_with_users(200, &[1, 2, 3]).await;
    }
    site.store_unfinished_run_of_each_pipeline(300).await;
    site.backlog = backlog.then(|| clock.wall());
    let mut ticks = tokio::time::interval(Duration::from_millis(250));
    loop {
        ticks.tick().await;
        site.report(clock.wall() - Span::from_seconds(1), clock.wall()).await;
    }
}

const NAMES: [&str; 30] = [
    "p01", "p02", "p03", "p04", "p05", "p06", "p07", "p08", "p09", "p10", "p11", "p12", "p13", "p14", "p15",
    "p16", "p17", "p18", "p19", "p20", "p21", "p22", "p23", "p24", "p25", "p26", "p27", "p28", "p29", "p30",
];
const HOSTS: [&str; 30] = [
    "h01", "h02", "h03", "h04", "h05", "h06", "h07", "h08", "h09", "h10", "h11", "h12", "h13", "h14", "h15",
    "h16", "h17", "h18", "h19", "h20", "h21", "h22", "h23", "h24", "h25", "h26", "h27", "h28", "h29", "h30",
];
