//! Benchmark of results: rows from trees, `data.csv`, summary, reading and comparing, for the paper's 10,005
//! iterations and for up to fifty times as many. The benchmark prints the duration and the peak memory of each step.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

use std::hint::black_box;
use std::sync::Arc;

use peernet_analysis::compare::{Comparison, Differences, needs_column};
use peernet_analysis::loaded::Loaded;
use peernet_analysis::record::RunRecord;
use peernet_analysis::rows::{Row, Rows};
use peernet_analysis::summary::Summary;
use peernet_analysis::trust::{Report, TrustInput};
use peernet_clock::{Clock, ClockIdentity, DelaySource, Interval, OneWayDelay, Span, SystemClock, Verdict};
use peernet_logger::{Anchor, HostId, Measure, NodeId, Rate, RunId, Transit, Tree, Unit, stage};
use peernet_results::{Overwrite, ResultFolder};
use peernet_stream::{Iteration, Outcome};

fn main() {
    let clock = Arc::new(SystemClock::new(ClockIdentity::new("bench", "system")));
    println!("{:>10}  {:32}  {:>9}  {:>9}", "iterations", "step", "seconds", "peak MiB");
    for iterations in [10_005, 100_000, 500_000] {
        let time_step = |step: &str, work: &mut dyn FnMut()| {
            reset_peak();
            let started_at = clock.mono();
            work();
            let seconds = (clock.mono() - started_at).seconds();
            println!("{iterations:>10}  {step:32}  {seconds:>9.3}  {:>9.1}", peak_kib() as f64 / 1024.0);
        };
        let temporary = tempfile::tempdir().expect("a temporary folder");
        let folder = ResultFolder::create(temporary.path(), Overwrite::Refuse).expect("it is empty");
        let mut rows = Rows::default();
        time_step("rows from trees, data.csv", &mut || {
            let mut writer = folder.create_writer().expect("writable");
            for row in (1..=iterations).map(|number| Row::from_iteration(&iteration(number))) {
                writer.write(&row);
                rows.push(&row);
            }
            writer.finish().expect("writable");
        });
        time_step("summary", &mut || drop(black_box(Summary::from_rows(&rows))));
        time_step("trust report", &mut || drop(black_box(Report::new(&TrustInput::from_rows(&rows, &[])))));
        time_step("run.json, summary.*, check rows", &mut || {
            folder.finish(&RunRecord::default(), &rows).expect("writable");
        });
        drop(std::mem::take(&mut rows));
        time_step("read back", &mut || drop(ResultFolder::open(temporary.path()).expect("readable")));
        let mut loaded = Vec::new();
        time_step("read back two runs for a table", &mut || {
            let open = || ResultFolder::open_columns(temporary.path(), &needs_column).expect("readable");
            loaded = vec![open(), Loaded { folder: "another".into(), ..open() }];
        });
        time_step("table of two runs", &mut || drop(black_box(Comparison::new(&loaded))));
        let comparison = Comparison::new(&loaded);
        let (baseline, other, seed) = (0, 1, 1);
        time_step("differences of every stage", &mut || {
            drop(black_box(Differences::between_lines(&comparison, &loaded, baseline, other, seed)));
        });
    }
}

/// Resets the peak memory, if the system permits it.
fn reset_peak() {
    // proc(5): "5" resets the peak resident set size to the current one.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Returns the peak memory of this process since the reset, KiB.
fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a peak");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

/// Returns a typical offloaded iteration. The iterations of different numbers have different durations.
fn iteration(number: u64) -> Iteration {
    let anchor = Anchor { host: HostId::from_bytes([7; 16]), wall: wall(number) };
    let mut tree = Tree::new(stage::ITERATION, anchor);
    // Up to 2²⁰ ns, about 1 ms, different for each salt below 16. The multiplier is that of Knuth's
    // generator MMIX.
    let noise = |salt: u64| ((16 * number + salt).wrapping_mul(6_364_136_223_846_793_005) >> 44) as i64;
    let timer = |micros: i64, salt: u64| Measure::Timer(Some(Span::from_nanos(micros * 1000 + noise(salt))));
    let transit = |micros: i64, salt: u64| {
        let value = Span::from_nanos(micros * 1000 + noise(salt));
        let half = Span::from_micros(20);
        let delay = OneWayDelay {
            raw: value + Span::from_millis(3),
            value: Some(value),
            bounds: Some(Interval { lo: value - half, hi: value + half }),
            source: DelaySource::InBand,
            verdict: Verdict::Ok,
        };
        Measure::Transit(Box::new(Transit {
            sent: wall(number),
            received: None,
            delay: Some(delay),
            raw_stamps: None,
        }))
    };
    let rate =
        |rate: f64| Measure::Throughput(Rate { value: Some(rate), bounds: Some((rate * 0.9, rate * 1.1)) });
    let bytes = |bytes: f64| Measure::Value(bytes, Unit::BYTES);
    let sensing = tree.add(NodeId::ROOT, stage::SENSING, Span::ZERO, timer(700, 1));
    tree.add(sensing, stage::CAPTURE, Span::ZERO, timer(600, 2));
    tree.add(sensing, stage::TRANSFORM, Span::ZERO, timer(90, 3));
    let nodes = [
        (stage::ENCODE, timer(30, 4)),
        (stage::SEND_QUEUE, timer(5, 5)),
        (stage::UPLOAD, transit(17_000, 6)),
        (stage::QUEUE, timer(8, 7)),
        (stage::PREPROCESSING, timer(900, 8)),
        (stage::INFERENCE, timer(3_700, 9)),
        (stage::POSTPROCESSING, timer(40, 10)),
        (stage::DOWNLOAD, transit(370, 11)),
        (stage::UPLOAD_BYTES, bytes(150_528.0)),
        (stage::UPLOAD_LOGGER_BYTES, bytes(120.0)),
        (stage::DOWNLOAD_BYTES, bytes(96.0)),
        (stage::DOWNLOAD_LOGGER_BYTES, bytes(130.0)),
        (stage::UPLOAD_THROUGHPUT, rate(7e7)),
        (stage::DOWNLOAD_THROUGHPUT, rate(4e6)),
        (stage::TOTAL, timer(22_800, 12)),
        (stage::STAGES_TOTAL, timer(22_700, 12)),
        (stage::UNATTRIBUTED, timer(100, 13)),
    ];
    for (name, measure) in nodes {
        tree.add(NodeId::ROOT, name, Span::ZERO, measure);
    }
    Iteration {
        run: RunId::from_bytes([1; 16]),
        number,
        episode: 0,
        step: number as u32,
        warm_up: number <= 5,
        outcome: Outcome::Ok,
        tree,
    }
}

fn wall(number: u64) -> peernet_clock::WallTime {
    peernet_clock::WallTime::from_unix_nanos(1_795_179_293_000_000_000 + number as i64 * 22_800_000)
}
