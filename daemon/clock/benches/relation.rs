//! What relating two clocks costs: time per exchange and per question, memory per pair of hosts, and the clock reads
//! themselves. Prints a table of medians over repeats.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::hint::black_box;

use peernet_clock::{
    Clock, ClockIdentity, Direction, Exchange, ExchangeObservation, RawTime, RelatedClocks, Relation,
    RelationSettings, Span, SystemClock, WallTime,
};
use peernet_statistics::SplitMix64;

/// Exchanges and questions are timed so many at once.
const BATCH: usize = 500;
/// Seconds of exchanges: the window and as much again, so that the oldest are forgotten.
const SECONDS: i64 = 1_200;

/// A way of exchanging: per second, and what each waits on either way by its number, nanoseconds.
struct Traffic {
    name: &'static str,
    hz: i64,
    wait: fn(u64) -> i64,
}

const TRAFFIC: [Traffic; 4] = [
    Traffic { name: "probes, 10 a second", hz: 10, wait: |n| exponential(n, 15_000.0) },
    Traffic { name: "data, 1,000 a second", hz: 1_000, wait: |n| exponential(n, 15_000.0) },
    // Neighbours differ by less than the drift between them: every one of them narrows.
    Traffic { name: "worst: none hides another, 1,000 a second", hz: 1_000, wait: |n| (n % 2 * 49) as i64 },
    Traffic { name: "worst, 50 a second", hz: 50, wait: |n| (n % 2 * 990) as i64 },
];

fn main() {
    let clock = SystemClock::new(ClockIdentity::new("bench", "system"));
    reads(&clock);
    println!(
        "{:<58}{:>10}{:>10}{:>10}{:>10}{:>12}",
        "nanoseconds per", "learn", "judge", "delay", "offset", "bytes"
    );
    let free = [RelatedClocks::Raw, RelatedClocks::Wall];
    for (clocks, traffic) in free.into_iter().flat_map(|clocks| TRAFFIC.iter().map(move |it| (clocks, it))) {
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
    late_arrivals(&clock);
}

/// The worst order: all exchanges of a window backwards, so that each is put in at the front.
fn late_arrivals(clock: &SystemClock) {
    let mut relation = relation(RelatedClocks::Raw);
    let worst = &TRAFFIC[3];
    let exchanges: Vec<ExchangeObservation> = (0..600 * worst.hz).rev().map(|n| worst.exchange(n)).collect();
    let learn = timed(clock, &exchanges, |observation| {
        black_box(relation.learn(observation));
    });
    println!("{:<58}{learn:>10.0}{:>42}", "worst, 50 a second, backwards", relation.memory_bytes());
}

fn reads(clock: &SystemClock) {
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
    /// The `n`th: a cloud one second ahead, 10 ppm fast, 30 µs away.
    fn exchange(&self, n: i64) -> ExchangeObservation {
        let at = n * 1_000_000_000 / self.hz;
        let cloud = |edge: i64| RawTime::from_nanos(edge + 1_000_000_000 + edge / 100_000);
        let there = at + 30_000 + (self.wait)(2 * n as u64);
        let back = there + 100_000 + 30_000 + (self.wait)(2 * n as u64 + 1);
        let exchange = Exchange {
            sent: RawTime::from_nanos(at),
            received: cloud(there),
            replied: cloud(there + 100_000),
            returned: RawTime::from_nanos(back),
            uncertainty: Span::ZERO,
        };
        ExchangeObservation { exchange, cloud_elapsed: None, edge_epoch: 0, cloud_epoch: Some(0) }
    }
}

/// Numbers that look random, the same in every run.
fn exponential(n: u64, mean: f64) -> i64 {
    // Neighbouring seeds give numbers that are not alike.
    (mean * SplitMix64::new(n).exponential()) as i64
}

/// Nanoseconds per call: the median over batches.
fn timed<T>(clock: &SystemClock, items: &[T], mut call: impl FnMut(&T)) -> f64 {
    let mut batches: Vec<f64> = items
        .chunks_exact(BATCH)
        .map(|batch| {
            let begun = clock.mono();
            batch.iter().for_each(&mut call);
            (clock.mono() - begun).nanos() as f64 / BATCH as f64
        })
        .collect();
    batches.sort_by(f64::total_cmp);
    batches[batches.len() / 2]
}
