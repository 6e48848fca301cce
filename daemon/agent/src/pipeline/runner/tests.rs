//! A pipeline whose task panics.

use std::sync::atomic::{AtomicBool, Ordering};

use peernet_clock::{Clock, ClockIdentity, MonoTime, SharedClock, SystemClock, WallTime};
use peernet_inference::Bank;
use peernet_logger::HostId;
use peernet_logger::stream::{Event, HostClock};
use tokio::sync::watch;

use super::*;
use crate::config::{AgentConfig, HostConfig};
use crate::incidents::Incidents;
use crate::link::{Links, Near, ProbeSettings};
use crate::runs::Runs;

/// A clock that breaks once, when it is told to.
#[derive(Debug)]
struct Fragile {
    clock: SystemClock,
    broken: AtomicBool,
}

impl Clock for Fragile {
    fn wall(&self) -> WallTime {
        self.clock.wall()
    }

    fn mono(&self) -> MonoTime {
        assert!(!self.broken.swap(false, Ordering::Relaxed), "as planned");
        self.clock.mono()
    }

    fn identity(&self) -> &ClockIdentity {
        self.clock.identity()
    }
}

#[tokio::test]
async fn a_panic_fails_its_pipeline_with_the_reason_and_ends_its_run() {
    let system = SystemClock::new(ClockIdentity::new("boot", "system"));
    let fragile = Arc::new(Fragile { clock: system, broken: AtomicBool::new(false) });
    let clock: SharedClock = Arc::<Fragile>::clone(&fragile);
    let tables = "[[model]]\nname = 'echo'\nkind = 'echo'\n\
        [[pipeline]]\nname = 'line'\nsensor = { kind = 'synthetic', size_bytes = 1 }\n\
        placement = { kind = 'local', model = 'echo' }\nload = { mode = 'rate', hz = 100.0 }";
    let config: AgentConfig = toml::from_str(tables).expect("reads");
    let aggregator = Some("tcp://127.0.0.1:1".parse().expect("an address"));
    let (feed, exit) = crate::outbox::entrance(&HostConfig { aggregator, ..HostConfig::default() }, &clock);
    let mut exit = exit.expect("there is an aggregator");
    let incidents = Incidents::new(Arc::clone(&clock), feed.clone());
    let (_own, own) = watch::channel(HostClock::default());
    let near = Near {
        name: "edge".parse().expect("a name"),
        clock: Arc::clone(&clock),
        own: own.clone(),
        feed: feed.clone(),
        incidents: incidents.clone(),
    };
    let probes = ProbeSettings::read(&config.probes, &config.clock).expect("no key is needed");
    let host = Host {
        id: HostId::random(),
        name: near.name.clone(),
        bank: Arc::new(Bank::new(config.models, config.onnxruntime, Arc::clone(&clock))),
        incidents,
        runs: Runs::default(),
        links: Links::new(near, &config.clock, probes),
        own,
        feed,
        clock,
        places: Arc::default(),
    };
    let pipeline = config.pipelines.into_iter().next().expect("one");
    let placement = crate::pipeline::intended(&pipeline.placement);
    let display = Arc::new(Display::new(pipeline.name.clone(), pipeline.load.describe(), placement));
    let running =
        run(Arc::new(pipeline), Arc::clone(&display), host, CancellationToken::new(), Duration::from_secs(1));
    let running = tokio::spawn(running);
    let mut started = None;
    while let Some(event) = exit.next().await {
        match event {
            Event::RunStarted(run) => started = Some(run.run),
            Event::Iteration(_) => break,
            _ => {}
        }
    }
    fragile.broken.store(true, Ordering::Relaxed);
    running.await.expect("the panic ends in the pipeline");

    let (mut ended, mut incident) = (None, None);
    while ended.is_none() || incident.is_none() {
        match exit.next().await.expect("the run ends and the failure is reported") {
            Event::RunEnded(end) => ended = Some(end),
            Event::Incident(what) if what.kind == IncidentKind::PipelineFailed => incident = Some(what),
            _ => {}
        }
    }
    let ended = ended.expect("seen");
    assert_eq!(Some(ended.run), started);
    assert!(ended.reason.contains("as planned"), "{}", ended.reason);
    assert!(incident.expect("seen").text.contains("as planned"));
    let (shown, _) = crate::live::Board::new(vec![display]).look();
    assert!(matches!(&shown[0].state, PipelineState::Failed(reason) if reason.contains("panicked")));
}
