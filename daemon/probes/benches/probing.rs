//! Cost of probing: one hundred links at ten probes per second over loopback. All probers run in one thread and their
//! reflector in another, with the kernel's packet stamps and with the program's. Prints a table.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use peernet_clock::{ClockIdentity, RelatedClocks, SharedClock, Span, SystemClock};
use peernet_probes::{Key, ProbeResult, Prober, ProberConfig, Reflector, ReflectorConfig, TimestampSource};
use rustix::time::{ClockId, clock_gettime};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

const LINKS: usize = 100;
const RATE_HZ: f64 = 10.0;
const WARM_UP: Duration = Duration::from_secs(1);
const MEASURED_DURATION: Duration = Duration::from_secs(8);

fn main() {
    println!(
        "{LINKS} links, {RATE_HZ} probes a second each, {} s over loopback",
        MEASURED_DURATION.as_secs()
    );
    println!(
        "{:<26}{:>10}{:>10}{:>8}{:>12}{:>14}{:>20}",
        "", "answers/s", "refined/s", "lost", "prober CPU", "reflector CPU", "round trip, median"
    );
    for (name, stamps, with_key) in [
        ("kernel's stamps", TimestampSource::Kernel, false),
        ("program's stamps", TimestampSource::Program, false),
        ("kernel's, authenticated", TimestampSource::Kernel, true),
    ] {
        let key = with_key.then(|| Key::from_bytes(&[7; 32]));
        let (address, stop, reflector_thread) = start_reflector(stamps, key.clone());
        let mut totals =
            thread::spawn(move || probe(address, stamps, key.as_ref())).join().expect("no panic");
        stop.cancel();
        let reflector_cpu_seconds = reflector_thread.join().expect("no panic");
        totals.round_trips.sort();
        let seconds = MEASURED_DURATION.as_secs_f64();
        println!(
            "{name:<26}{:>10.0}{:>10.0}{:>8}{:>9.2} % {:>11.2} % {:>17.1} µs",
            totals.round_trips.len() as f64 / seconds,
            totals.refined as f64 / seconds,
            totals.lost,
            100.0 * totals.cpu_seconds / seconds,
            // The reflector ran during the warm-up as well.
            100.0 * reflector_cpu_seconds / (MEASURED_DURATION + WARM_UP).as_secs_f64(),
            totals.round_trips[totals.round_trips.len() / 2].seconds() * 1e6,
        );
    }
}

/// Results of the probers during the measurement.
#[derive(Default)]
struct ProbeTotals {
    round_trips: Vec<Span>,
    refined: usize,
    lost: usize,
    /// CPU time. Seconds.
    cpu_seconds: f64,
}

fn start_reflector(
    stamps: TimestampSource,
    key: Option<Key>,
) -> (SocketAddr, CancellationToken, JoinHandle<f64>) {
    let stop = CancellationToken::new();
    let (address_sender, address_receiver) = oneshot::channel();
    let stop_of_reflector = stop.clone();
    let thread = thread::spawn(move || {
        runtime().block_on(async {
            let listen = SocketAddr::from(([127, 0, 0, 1], 0));
            let config = ReflectorConfig {
                listen,
                key,
                session_key: None,
                instance: 1,
                max_per_source_hz: 100_000,
                stamps,
                stateful: true,
            };
            let reflector = Reflector::bind(config, clock("cloud")).expect("a free port");
            address_sender.send(reflector.address()).expect("the caller waits for the address");
            let cpu_seconds_before = thread_cpu_seconds();
            reflector.run(stop_of_reflector).await.expect("the socket stays");
            thread_cpu_seconds() - cpu_seconds_before
        })
    });
    (address_receiver.blocking_recv().expect("the reflector was bound"), stop, thread)
}

fn probe(target: SocketAddr, stamps: TimestampSource, key: Option<&Key>) -> ProbeTotals {
    runtime().block_on(async {
        let stop = CancellationToken::new();
        let (_rate, rate_hz) = watch::channel(RATE_HZ);
        let (result_sender, mut results) = mpsc::channel(4096);
        let probers: Vec<_> = (0..LINKS)
            .map(|_| {
                let timeout = Duration::from_secs(1);
                let config = ProberConfig {
                    target,
                    key: key.cloned(),
                    instance: Some(1),
                    clocks: RelatedClocks::Raw,
                    padding_bytes: 0,
                    stamps,
                    timeout,
                };
                let prober = Prober::open(config, clock("edge")).expect("a socket");
                tokio::spawn(prober.run(rate_hz.clone(), result_sender.clone(), stop.clone()))
            })
            .collect();
        // Results of the warm-up are not counted.
        let warm_up = async { while results.recv().await.is_some() {} };
        let _ = tokio::time::timeout(WARM_UP, warm_up).await;
        let mut totals = ProbeTotals::default();
        let cpu_seconds_before = thread_cpu_seconds();
        let counting = async {
            while let Some(result) = results.recv().await {
                match result {
                    ProbeResult::Answered(observation) => {
                        totals.round_trips.push(observation.exchange.round_trip());
                    }
                    ProbeResult::Refined(_) => totals.refined += 1,
                    ProbeResult::Lost => totals.lost += 1,
                    ProbeResult::Sent | ProbeResult::Late => {}
                    ProbeResult::ClockInterrupted(_) => panic!("the clock was interrupted"),
                    ProbeResult::Refused(reason) => panic!("refused: {reason}"),
                }
            }
        };
        let _ = tokio::time::timeout(MEASURED_DURATION, counting).await;
        totals.cpu_seconds = thread_cpu_seconds() - cpu_seconds_before;
        stop.cancel();
        for prober in probers {
            prober.await.expect("no panic");
        }
        totals
    })
}

fn clock(name: &str) -> SharedClock {
    Arc::new(SystemClock::new(ClockIdentity::new("bench", name)))
}

fn runtime() -> Runtime {
    Builder::new_current_thread().enable_all().build().expect("a runtime")
}

/// Returns the CPU time of this thread. Seconds.
fn thread_cpu_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
