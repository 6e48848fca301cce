//! Benchmark of drawing figures: those of a run of 10,005 iterations, as in the paper, of a run of 100,000, and of an experiment. Prints
//! seconds, the peak memory so far, and the sizes of the files. The files stay in a folder that is named on the command line.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

mod rows;

use std::path::{Path, PathBuf};

use peernet_analysis::loaded::Loaded;
use peernet_clock::{Clock, ClockIdentity, SystemClock};
use peernet_figures::{self as figures, Columns, Kind};

fn main() {
    let kept = std::env::args().skip(1).find(|argument| !argument.starts_with('-')).map(PathBuf::from);
    let temporary = tempfile::tempdir().expect("a temporary folder");
    let folder = kept.unwrap_or_else(|| temporary.path().to_owned());
    println!("{:28}  {:>8}  {:>9}  {:>9}", "what", "seconds", "peak MiB", "files kB");
    let run = [rows::remote("efficientnet_v2_s", "zmq-tcp", 10_005)];
    let begun = peak_kib();
    timed("6 histograms, 10,005", &folder, &|folder| {
        figures::of_run(&run[0].record, &run[0].rows, folder).expect("writable")
    });
    for kind in [Kind::Cumulative, Kind::Series, Kind::Length] {
        timed(&format!("{}, 10,005", kind.name()), &folder, &|folder| drawn(kind, &run, folder));
    }
    println!("more than before: {:.1} MiB", (peak_kib() - begun) as f64 / 1024.0);
    let experiment = rows::experiment();
    timed("an experiment of 6 × 2,000", &folder, &|folder| {
        figures::of_experiment(&experiment, folder).expect("writable")
    });
    let teleoperation = rows::teleoperation();
    let of = folder.join("teleoperation");
    timed("bars of 7 × 500", &of, &|folder| drawn(Kind::Stacked, &teleoperation, folder));
    let payload = [rows::payload()];
    timed("payload of 7 × 200", &folder, &|folder| drawn(Kind::Payload, &payload, folder));
    let users = rows::users();
    timed("users, 62 × 200", &folder, &|folder| drawn(Kind::Users, &users, folder));
    let long = [rows::remote("efficientnet_v2_s", "zmq-tcp", 100_000)];
    let of = folder.join("long");
    timed("6 histograms, 100,000", &of, &|folder| {
        figures::of_run(&long[0].record, &long[0].rows, folder).expect("writable")
    });
    for kind in [Kind::Cumulative, Kind::Series, Kind::Length] {
        timed(&format!("{}, 100,000", kind.name()), &of, &|folder| drawn(kind, &long, folder));
    }
}

fn drawn(kind: Kind, runs: &[Loaded], folder: &Path) -> Vec<PathBuf> {
    figures::draw(kind, runs, &Columns::default(), folder).expect("there is something to draw").files
}

fn timed(what: &str, folder: &Path, work: &dyn Fn(&Path) -> Vec<PathBuf>) {
    std::fs::create_dir_all(folder).expect("a folder");
    let clock = SystemClock::new(ClockIdentity::new("bench", "system"));
    let begun = clock.mono();
    let files = work(folder);
    let seconds = (clock.mono() - begun).seconds();
    let size = |path: &PathBuf| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let largest = files.iter().map(size).max().unwrap_or_default() as f64 / 1e3;
    println!("{what:28}  {seconds:>8.3}  {:>9.1}  {largest:>9.1}", peak_kib() as f64 / 1024.0);
}

/// Returns the peak memory of this process so far, KiB.
fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a peak");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}
