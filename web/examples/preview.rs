//! Preview of the pages with an artificial factory: `cargo run -p peernet-web --example preview`.
//!
//! `--late` lets the hosts connect after ten seconds, `--empty` shows the pages before the first host has reported, `--many` uses thirty
//! pipelines, `--grid` experiments of fifty configurations, of many users and with a repeated run, and long names, `--unrelated` clocks
//! that were never related, `--one-clock` a camera that reads the rack's clock, `--talking` a camera whose answers have all lengths,
//! `--clock-fault` a camera with an injected clock fault, `--backlog` an agent with hours of backlog, one whose disk is full, and a run
//! with gaps. The address is the first free argument, 127.0.0.1:8040 otherwise.

#[path = "../tests/it/factory/mod.rs"]
mod factory;

use std::sync::Arc;
use std::time::Duration;

use factory::{Factory, Line};
use peernet_aggregator::{Aggregator, AggregatorConfig};
use peernet_clock::{ClockIdentity, SharedClock, Span, SystemClock};
use peernet_web::{WebConfig, Zone};
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
    let server = peernet_web::serve(web, aggregator.handle.clone(), clock.clone(), stop.clone(), 64).await?;
    #[expect(clippy::print_stdout, reason = "an example prints where to look")]
    {
        println!("http://{}", server.address());
    }

    if !has("--empty") {
        let mut lines = vec![Line::local(), Line::full(), Line::resized()];
        if has("--unrelated") {
            lines.push(Line { host: "cam-4", ..Line::unrelated() });
        }
        if has("--clock-fault") {
            lines[2] = Line::with_clock_fault();
        }
        if has("--one-clock") {
            lines.push(Line { host: "cam-5", ..Line::one_clock() });
        }
        if has("--talking") {
            lines.push(Line { host: "cam-6", ..Line::talking() });
        }
        if has("--many") {
            lines = (0..30)
                .map(|index| Line {
                    name: NAMES[index],
                    host: HOSTS[index],
                    hz: 5.0,
                    ..lines[index % 3].clone()
                })
                .collect();
        }
        let pause = Duration::from_secs(if has("--late") { 10 } else { 0 });
        if has("--grid") {
            lines[0].name = "quality-control-of-the-welding-seam-with-a-name-of-63-characters";
            lines[1].host = "camera-above-the-second-conveyor-belt-in-hall-seven-to-the-left";
        }
        let (backlog, grid) = (has("--backlog"), has("--grid"));
        tokio::spawn(async move {
            tokio::time::sleep(pause).await;
            produce(listening, clock, lines, backlog, grid).await;
        });
    }
    tokio::signal::ctrl_c().await?;
    stop.cancel();
    server.join().await?;
    aggregator.join().await?;
    Ok(())
}

async fn produce(address: String, clock: SharedClock, lines: Vec<Line>, backlog: bool, grid: bool) {
    let mut factory = Factory::new(&address, clock.clone(), lines).await;
    let many = factory.lines.len() > 5;
    factory.report(clock.wall() - Span::from_seconds(590), clock.wall()).await;
    factory.store_incidents().await;
    factory.store_clocks(if many { 120 } else { 3_600 }).await;
    factory.store_runs(if many { 200 } else { 6_000 }, true).await;
    if backlog {
        factory.store_gaps(2, 42).await;
    }
    factory.store_experiment(600, 2).await;
    factory.store_episodes(2_000, 250).await;
    let sizes = [30e3, 150e3, 400e3, 800e3].map(|bytes| (bytes, None));
    factory.store_sizes(2.min(factory.lines.len() - 1), 300, &sizes).await;
    if grid {
        factory.store_grid(100, 50).await;
        factory.store_skipping(0, 600, 3).await;
        factory.store_attempts(200, &["stopped", "finished"]).await;
        factory.store_users(200, &[1, 2, 3]).await;
    }
    factory.store_runs(300, false).await;
    factory.backlog = backlog.then(|| clock.wall());
    let mut ticks = tokio::time::interval(Duration::from_millis(250));
    loop {
        ticks.tick().await;
        factory.report(clock.wall() - Span::from_seconds(1), clock.wall()).await;
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
