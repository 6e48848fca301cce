//! Test of `peernet calibrate` on a cable, with a cloud whose clock is a second ahead and drifts: its fitted lines
//! are compared with those of the true delays.

use std::collections::BTreeMap;
use std::path::Path;

use peernet_clock::{Span, WallTime};
use peernet_tests::truth::HostClock;
use peernet_tests::{Network, TwoHostTestbed, program};
use serde_json::Value;

use super::{faults, print_line};

/// Largest error of an intercept.
const ERROR: Span = Span::from_micros(100);

/// Similar sizes, so that the intercept is the delay of an empty message even if the link is not linear in size.
const SIZES: &str = "100,500,1kB,2kB,5kB,10kB";
/// Number of repeats: in some seconds the drift exceeds the largest error.
const REPEATS: &str = "1001";

/// One direction of one iteration.
struct Passage {
    payload: u64,
    warm_up: bool,
    /// Reported delay.
    value: Option<Span>,
    bounds: (Span, Span),
    /// True delay, and its largest error: the table contains the edge's time of the whole iteration only.
    truth: Span,
    slack: Span,
}

/// Reads one direction of a study's table. `ahead` is the offset of the receiver's clock from the sender's at each
/// time.
fn passages(samples: &Path, stage: &str, ahead: impl Fn(WallTime) -> Span) -> Vec<Passage> {
    let text = std::fs::read_to_string(samples).expect("it was written");
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("there is a header");
    let passage = |row: Vec<&str>| {
        let cell = |name: &str| {
            let at = header.iter().position(|column| *column == name);
            row[at.unwrap_or_else(|| panic!("no column {name}"))]
        };
        let seconds = |name: &str| nanos(cell(name)).unwrap_or_else(|| panic!("{name} in {row:?}"));
        let (start, total) = (WallTime::from_unix_nanos(seconds("at").nanos()), seconds("total"));
        let (first, last) = (ahead(start), ahead(start + total));
        let part = |part: &str| seconds(&format!("{stage}-{part}"));
        let middle = Span::from_nanos(i64::midpoint(first.nanos(), last.nanos()));
        Passage {
            payload: cell("payload-bytes").parse().expect("a number"),
            warm_up: cell("warm-up") == "1",
            value: nanos(cell(stage)),
            bounds: (part("lo"), part("hi")),
            truth: part("raw") - middle,
            // The truth is derived from stamps of the wall clocks, which are read up to 3 µs after those that delays
            // are judged by.
            slack: (last - first).abs() + Span::from_nanos(3_002),
        }
    };
    rows.map(passage).collect()
}

/// Parses decimal seconds, which have more digits than a float.
fn nanos(text: &str) -> Option<Span> {
    let (whole, part) = text.split_once('.')?;
    let digits = format!("{whole}{part:0<9}");
    digits.parse().ok().map(Span::from_nanos)
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn pair(value: &Value) -> (f64, f64) {
    (number(&value[0]), number(&value[1]))
}

/// Returns the intercept of weighted least squares over points (x, y, weight).
fn intercept(points: &[(f64, f64, f64)]) -> f64 {
    let sum =
        |of: &dyn Fn(&(f64, f64, f64)) -> f64| points.iter().map(|point| point.2 * of(point)).sum::<f64>();
    let all = sum(&|_| 1.0);
    let (x, y) = (sum(&|point| point.0) / all, sum(&|point| point.1) / all);
    let slope = sum(&|point| (point.0 - x) * (point.1 - y)) / sum(&|point| (point.0 - x).powi(2));
    y - slope * x
}

fn median(mut spans: Vec<Span>) -> f64 {
    spans.sort();
    let middle = spans.len() / 2;
    let above = spans[middle];
    let below = if spans.len().is_multiple_of(2) { spans[middle - 1] } else { above };
    f64::midpoint(above.seconds(), below.seconds())
}

/// Repeats the study's fit over the medians, with its weights, for other delays.
fn refitted(direction: &Value, delays: &BTreeMap<u64, Vec<Span>>) -> f64 {
    /// Smallest error of a median that counts, seconds.
    const CLOCK_READ: f64 = 1e-7;
    let sizes = direction["sizes"].as_array().expect("a list").iter();
    let point = |size: &Value| {
        let payload = size["payload_bytes"].as_u64().expect("a number");
        let weight = number(&size["median_error"]).max(CLOCK_READ).powi(-2);
        (number(&size["wire_bytes"]), median(delays[&payload].clone()), weight)
    };
    intercept(&sizes.map(point).collect::<Vec<_>>())
}

/// Groups the delays by size.
fn by_size<'a>(passages: impl Iterator<Item = (&'a Passage, Span)>) -> BTreeMap<u64, Vec<Span>> {
    let mut sizes = BTreeMap::<u64, Vec<Span>>::new();
    for (passage, delay) in passages {
        sizes.entry(passage.payload).or_default().push(delay);
    }
    sizes
}

/// Compares one direction with the truth, without its warm-up.
fn assert_intercept_is_right(stage: &str, direction: &Value, passages: &[Passage]) {
    for Passage { payload, bounds: (lo, hi), truth, slack, .. } in passages {
        let allowed = *lo - *slack..=*hi + *slack;
        assert!(allowed.contains(truth), "{stage} of {payload} B: {truth} is not in {allowed:?}");
    }
    let counted = || passages.iter().filter(|passage| !passage.warm_up);
    let reported = by_size(counted().filter_map(|passage| Some((passage, passage.value?))));
    let really = by_size(counted().map(|passage| (passage, passage.truth)));

    let main = &direction["fits"]["medians"]["least_squares"]["intercept"];
    let (told, claimed) = (number(&main["value"]), pair(&direction["claimed"]["at_zero"]));
    let (again, truth) = (refitted(direction, &reported), refitted(direction, &really));
    let span = Span::from_seconds_f64;
    let error = span(told - truth);
    print_line(&format!(
        "{stage}: intercept {}, of the true delays {}, error {error}; claimed {} to {}",
        span(told),
        span(truth),
        span(claimed.0),
        span(claimed.1),
    ));
    assert!((told - again).abs() < 1e-9, "{stage}: the fit is another one than is told, {told} and {again}");
    assert!(error.abs() <= ERROR, "{stage}: the intercept is wrong by {error}");
    assert!(
        (claimed.0..=claimed.1).contains(&told),
        "{stage}: {told} lies outside of what is claimed, {claimed:?}"
    );
}

#[test]
fn calibrated_intercepts_contain_the_true_delays() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let _cloud = testbed.start_cloud(&faults(1_000.0, 50.0, ""));
    let cloud: HostClock = testbed.clock_of("cloud");
    let peer = testbed.peer();
    let sweep = ["--sizes", SIZES, "--repeats", REPEATS, "--seconds", "20"];
    let arguments = [&["calibrate", &peer, "--result-loc", "results"], &sweep[..]].concat();
    let done =
        testbed.network.edge().start(&program("peernet"), &arguments, testbed.folder(), &[]).wait_for_end();
    assert_eq!(done.code(), 0, "{}", done.log);

    let results = testbed.folder().join("results");
    let study = std::fs::read(results.join("calibration.json")).expect("it was written");
    let study: Value = serde_json::from_slice(&study).expect("it is JSON");
    print_line(&format!("verdict {}, {}", study["verdict"], study["counts"]));
    let samples = results.join("samples.csv");
    assert_intercept_is_right("upload", &study["up"], &passages(&samples, "upload", |at| cloud.ahead(at)));
    assert_intercept_is_right(
        "download",
        &study["down"],
        &passages(&samples, "download", |at| -cloud.ahead(at)),
    );
    assert_eq!(study["verdict"]["kind"], "trusted", "{}", study["verdict"]);
}
