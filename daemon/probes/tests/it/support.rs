//! A prober and a reflector on loopback, and their configurations.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use peernet_clock::{ClockIdentity, Interval, RelatedClocks, SharedClock, Span, SystemClock};
use peernet_probes::{
    Key, ProbeResult, Prober, ProberConfig, ReceiveError, Reflector, ReflectorConfig, ReflectorCounters,
    TimestampSource,
};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Instance number of the reflectors in these tests.
pub(crate) const INSTANCE: u64 = 0x0123_4567_89AB_CDEF;

/// Longest time that a test waits for a result.
pub(crate) const MAX_WAIT: Duration = Duration::from_secs(30);

pub(crate) fn system_clock(name: &str) -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("test", name)))
}

/// Returns the interval that contains the wall clock minus the free-running clock, for a wall clock that is `ahead` of
/// this host's. The interval has a tolerance for the slewing of a time daemon during a test.
pub(crate) fn wall_minus_raw(ahead: Span) -> Interval {
    let tolerance = Span::from_micros(200);
    let Interval { lo, hi } = system_clock("truth").wall_ahead();
    Interval { lo: lo + ahead - tolerance, hi: hi + ahead + tolerance }
}

pub(crate) fn loopback() -> SocketAddr {
    "127.0.0.1:0".parse().expect("an address")
}

pub(crate) fn key(byte: u8) -> Key {
    Key::from_bytes(&[byte; 32])
}

pub(crate) fn reflector_config() -> ReflectorConfig {
    ReflectorConfig {
        listen: loopback(),
        key: None,
        session_key: None,
        instance: INSTANCE,
        max_per_source_hz: 10_000,
        stamps: TimestampSource::Kernel,
        stateful: true,
    }
}

pub(crate) fn prober_config(target: SocketAddr) -> ProberConfig {
    ProberConfig {
        target,
        key: None,
        instance: None,
        clocks: RelatedClocks::Raw,
        padding_bytes: 0,
        stamps: TimestampSource::Kernel,
        timeout: Duration::from_secs(20),
    }
}

/// A running reflector.
pub(crate) struct RunningReflector {
    pub(crate) address: SocketAddr,
    pub(crate) counters: ReflectorCounters,
    pub(crate) peers: watch::Sender<Vec<IpAddr>>,
    stop: CancellationToken,
    task: JoinHandle<Result<(), ReceiveError>>,
}

impl RunningReflector {
    pub(crate) fn start(config: ReflectorConfig, clock: SharedClock) -> Self {
        let reflector = Reflector::bind(config, clock).expect("loopback has free ports");
        let (address, counters) = (reflector.address(), reflector.counters());
        let peers = reflector.peers();
        let stop = CancellationToken::new();
        let task = tokio::spawn(reflector.run(stop.clone()));
        Self { address, counters, peers, stop, task }
    }

    pub(crate) async fn stop(self) {
        self.stop.cancel();
        self.task.await.expect("no panic").expect("the socket was not lost");
    }
}

/// A running prober.
pub(crate) struct RunningProber {
    pub(crate) rate_hz: watch::Sender<f64>,
    pub(crate) results: mpsc::Receiver<ProbeResult>,
    stop: CancellationToken,
    task: JoinHandle<()>,
}

impl RunningProber {
    pub(crate) fn start(config: ProberConfig, rate_hz: f64, clock: SharedClock) -> Self {
        let prober = Prober::open(config, clock).expect("a socket");
        let (rate_hz, rate) = watch::channel(rate_hz);
        let (result_sender, results) = mpsc::channel(1024);
        let stop = CancellationToken::new();
        let task = tokio::spawn(prober.run(rate, result_sender, stop.clone()));
        Self { rate_hz, results, stop, task }
    }

    pub(crate) async fn next(&mut self) -> ProbeResult {
        let next = tokio::time::timeout(MAX_WAIT, self.results.recv()).await;
        next.expect("a result comes in time").expect("the prober runs")
    }

    /// Returns the next wanted result, and all results before it.
    pub(crate) async fn until<T>(
        &mut self,
        wanted: impl Fn(&ProbeResult) -> Option<T>,
    ) -> (T, Vec<ProbeResult>) {
        let mut earlier_results = Vec::new();
        loop {
            let result = self.next().await;
            match wanted(&result) {
                Some(value) => return (value, earlier_results),
                None => earlier_results.push(result),
            }
        }
    }

    /// Stops the prober. Returns the remaining results.
    pub(crate) async fn stop(mut self) -> Vec<ProbeResult> {
        self.stop.cancel();
        self.task.await.expect("no panic");
        let mut remaining_results = Vec::new();
        while let Ok(result) = self.results.try_recv() {
            remaining_results.push(result);
        }
        remaining_results
    }
}
