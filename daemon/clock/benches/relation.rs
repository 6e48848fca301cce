//! Benchmark of the clock relation: time per exchange and per query, memory per pair of hosts, and the time of single
//! clock reads. Prints a table of medians over repeats.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::hint::black_box;

use peernet_clock::{
    Clock, ClockIdentity, Direction, Exchange, ExchangeObservation, RawTime, RelatedClocks, Relation,
    RelationSettings, Span, SystemClock, WallTime,
};
use peernet_statistics::SplitMix64;

/// Number of calls that are timed together.
const BATCH: usize = 500;
/// Length of the simulated traffic in seconds. The traffic is much longer than the window, so that the oldest exchanges
/// expire.
const SECONDS: i64 = 1_200;

/// A traffic pattern: exchanges per second, and the queueing delay of the n-th message in nanoseconds.
struct Traffic {
    name: &'static str,
    hz: i64,
    queueing_delay: fn(u64) -> i64,
}

const TRAFFIC: [Traffic; 4] = [
    Traffic { name: "probes, 10 a second", hz: 10, queueing_delay: |n| exponential(n, 15_000.0) },
    Traffic { name: "data, 1,000 a second", hz: 1_000, queueing_delay: |n| exponential(n, 15_000.0) },
    // Only the answers, which have odd numbers, are queued. Bounds of neighbouring exchanges differ by less than the
    // drift between them, so every exchange narrows the band.
    Traffic {
        name: "worst: all narrow the band, 1,000 a second",
        hz: 1_000,
        queueing_delay: |n| (n % 2 * 49) as i64,
    },
    Traffic { name: "worst, 50 a second", hz: 50, queueing_delay: |n| (n % 2 * 990) as i64 },
];

fn main() {
    let clock = SystemClock::new(ClockIdentity::new("bench", "system"));
    measure_clock_reads(&clock);
    println!(
        "{:<58}{:>10}{:>10}{:>10}{:>10}{:>12}",
        "nanoseconds per", "learn", "judge", "delay", "offset", "bytes"
    );
    let both_clocks = [RelatedClocks::Raw, RelatedClocks::Wall];
    let rows =
        both_clocks.into_iter().flat_map(|clocks| TRAFFIC.iter().map(move |traffic| (clocks, traffic)));
    for (clocks, traffic) in rows {
        let mut relation = relation(clocks);
        let exchanges: Vec<ExchangeObservation> =
            (0..SECONDS * traffic.hz).map(|n| traffic.exchange(n)).collect();
        let (learnt, judged) = exchanges.split_at(exchanges.len() / 2);
        let learn = timed(&clock, learnt, |observation| {
            black_box(relation.learn(observation));
        });
        let judge = timed(&clock, judged, |observation| {
            black_box(relation.judge(observation));
        });
        // The newest quarter of the exchanges. `judge` has learned them, too.
        let late = &judged[judged.len() / 2..];
        let delay = timed(&clock, late, |ExchangeObservation { exchange, .. }| {
            black_box(relation.delay(Direction::Up, exchange.sent, exchange.received));
        });
        let offset = timed(&clock, late, |observation| {
            drop(black_box(relation.offset(observation.exchange.sent, WallTime::default())));
        });
        println!(
            "{:<58}{learn:>10.0}{judge:>10.0}{delay:>10.0}{offset:>10.0}{:>12}",
            match clocks {
                RelatedClocks::Raw => traffic.name.to_owned(),
                RelatedClocks::RawToWall | RelatedClocks::Wall => format!("wall clocks: {}", traffic.name),
            },
            relation.memory_bytes()
        );
    }
    measure_reversed_exchanges(&clock);
}

/// Measures the worst order of arrival: all exchanges of 600 s backwards, so that each is inserted at the front.
fn measure_reversed_exchanges(clock: &SystemClock) {
    let mut relation = relation(RelatedClocks::Raw);
    let worst = &TRAFFIC[3];
    let exchanges: Vec<ExchangeObservation> = (0..600 * worst.hz).rev().map(|n| worst.exchange(n)).collect();
    let learn = timed(clock, &exchanges, |observation| {
        black_box(relation.learn(observation));
    });
    println!("{:<58}{learn:>10.0}{:>42}", "worst, 50 a second, backwards", relation.memory_bytes());
}

fn measure_clock_reads(clock: &SystemClock) {
    let calls = [(); 100 * BATCH];
    let rows: [(&str, &dyn Fn()); 7] = [
        ("Clock::mono", &|| _ = black_box(clock.mono())),
        ("Clock::wall", &|| _ = black_box(clock.wall())),
        ("Clock::raw", &|| _ = black_box(clock.raw())),
        ("Clock::stamp", &|| _ = black_box(clock.stamp())),
        ("Clock::epoch", &|| _ = black_box(clock.epoch())),
        ("Clock::wall_epoch", &|| _ = black_box(clock.wall_epoch())),
        ("Clock::readings", &|| _ = black_box(clock.readings())),
    ];
    for (name, read) in rows {
        println!("{name:<44}{:>10.1} ns", timed(clock, &calls, |()| read()));
    }
}

fn relation(clocks: RelatedClocks) -> Relation {
    let settings = RelationSettings { clocks, ..RelationSettings::default() };
    Relation::new(settings)
}

impl Traffic {
    /// Returns the `n`-th exchange with a cloud whose clock is one second ahead and 10 ppm fast, and whose path takes
    /// 30 µs.
    fn exchange(&self, n: i64) -> ExchangeObservation {
        let at = n * 1_000_000_000 / self.hz;
        let cloud = |edge: i64| RawTime::from_nanos(edge + 1_000_000_000 + edge / 100_000);
        let arrived_at = at + 30_000 + (self.queueing_delay)(2 * n as u64);
        let returned_at = arrived_at + 100_000 + 30_000 + (self.queueing_delay)(2 * n as u64 + 1);
        let exchange = Exchange {
            sent: RawTime::from_nanos(at),
            received: cloud(arrived_at),
            replied: cloud(arrived_at + 100_000),
            returned: RawTime::from_nanos(returned_at),
            uncertainty: Span::ZERO,
        };
        ExchangeObservation { exchange, cloud_elapsed: None, edge_epoch: 0, cloud_epoch: Some(0) }
    }
}

/// Returns a pseudo-random number from an exponential distribution; the same for the same `n` in every run.
fn exponential(n: u64, mean: f64) -> i64 {
    // SplitMix64 gives unrelated numbers for neighbouring seeds.
    (mean * SplitMix64::new(n).exponential()) as i64
}

/// Returns the nanoseconds per call as the median over batches.
fn timed<T>(clock: &SystemClock, items: &[T], mut call: impl FnMut(&T)) -> f64 {
    let mut batches: Vec<f64> = items
        .chunks_exact(BATCH)
        .map(|batch| {
            let started_at = clock.mono();
            batch.iter().for_each(&mut call);
            (clock.mono() - started_at).nanos() as f64 / BATCH as f64
        })
        .collect();
    batches.sort_by(f64::total_cmp);
    batches[batches.len() / 2]
}
