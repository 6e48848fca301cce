//! Benchmark that draws figures of a run of 10,005 iterations, as in the paper, of a run of 100,000 iterations, and of
//! several experiments. It prints the time, the peak memory so far, and the size of the largest file. If a folder is
//! named on the command line, the files stay in this folder.
#![expect(clippy::print_stdout, reason = "a benchmark prints its table")]

mod rows;

use std::path::{Path, PathBuf};

use peernet_analysis::loaded::Loaded;
use peernet_clock::{Clock, ClockIdentity, SystemClock};
use peernet_figures::{self as figures, Columns, Kind};

fn main() {
    let named_folder =
        std::env::args().skip(1).find(|argument| !argument.starts_with('-')).map(PathBuf::from);
    let temporary = tempfile::tempdir().expect("a temporary folder");
    let folder = named_folder.unwrap_or_else(|| temporary.path().to_owned());
    println!("{:28}  {:>8}  {:>9}  {:>9}", "what", "seconds", "peak MiB", "largest kB");
    let run = [rows::remote("efficientnet_v2_s", "zmq-tcp", 10_005)];
    let peak_before = peak_kib();
    print_time("6 histograms, 10,005", &folder, &|folder| {
        figures::of_run(&run[0].record, &run[0].rows, folder).expect("writable")
    });
    for kind in [Kind::Cumulative, Kind::Series, Kind::Length] {
        print_time(&format!("{}, 10,005", kind.name()), &folder, &|folder| draw(kind, &run, folder));
    }
    println!("peak memory grew by {:.1} MiB", (peak_kib() - peak_before) as f64 / 1024.0);
    let experiment = rows::experiment();
    print_time("an experiment of 6 × 2,000", &folder, &|folder| {
        figures::of_experiment(&experiment, folder).expect("writable")
    });
    let teleoperation = rows::teleoperation();
    // The bars of the previous experiment have files with the same names.
    let subfolder = folder.join("teleoperation");
    print_time("bars of 7 × 500", &subfolder, &|folder| draw(Kind::Stacked, &teleoperation, folder));
    let payload = [rows::payload()];
    print_time("payload of 7 × 200", &folder, &|folder| draw(Kind::Payload, &payload, folder));
    let users = rows::users();
    print_time("users, 62 × 200", &folder, &|folder| draw(Kind::Users, &users, folder));
    let long = [rows::remote("efficientnet_v2_s", "zmq-tcp", 100_000)];
    // The figures of the first run have files with the same names.
    let subfolder = folder.join("long");
    print_time("6 histograms, 100,000", &subfolder, &|folder| {
        figures::of_run(&long[0].record, &long[0].rows, folder).expect("writable")
    });
    for kind in [Kind::Cumulative, Kind::Series, Kind::Length] {
        print_time(&format!("{}, 100,000", kind.name()), &subfolder, &|folder| draw(kind, &long, folder));
    }
}

fn draw(kind: Kind, runs: &[Loaded], folder: &Path) -> Vec<PathBuf> {
    figures::draw(kind, runs, &Columns::default(), folder).expect("there is something to draw").files
}

/// Draws figures into a folder and prints a line of the table.
fn print_time(what: &str, folder: &Path, draw: &dyn Fn(&Path) -> Vec<PathBuf>) {
    std::fs::create_dir_all(folder).expect("a folder");
    let clock = SystemClock::new(ClockIdentity::new("bench", "system"));
    let start = clock.mono();
    let files = draw(folder);
    let seconds = (clock.mono() - start).seconds();
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
