//! Test of `peernet calibrate` on a cable, with a cloud whose clock is a second ahead and drifts: its fitted lines
//! are compared with those of the true delays.

use std::collections::BTreeMap;
use std::path::Path;

use peernet_clock::{Span, WallTime};
use peernet_tests::truth::HostClock;
use peernet_tests::{Network, TwoHostTestbed, program};
use serde_json::Value;

use super::{faults, print_line};

/// Largest permitted error of an intercept.
const MAX_ERROR: Span = Span::from_micros(100);

/// Small sizes, so the intercept is close to the delay of an empty message even if the delay is not linear in size.
const SIZES: &str = "100,500,1kB,2kB,5kB,10kB";
/// Number of repeats. They take some seconds, in which the drift exceeds [`MAX_ERROR`].
const REPEATS: &str = "1001";

/// One direction of one iteration.
struct SampleDelay {
    payload: u64,
    is_warm_up: bool,
    /// Reported delay.
    value: Option<Span>,
    bounds: (Span, Span),
    /// True delay.
    truth: Span,
    /// Largest error of `truth`. The offset between the clocks at the time of the message is known only as the mean over the
    /// whole iteration.
    truth_error: Span,
}

/// Reads one direction from `samples.csv` of a calibration. `ahead` is the offset of the receiver's clock from the
/// sender's at each time.
fn sample_delays(samples: &Path, stage: &str, ahead: impl Fn(WallTime) -> Span) -> Vec<SampleDelay> {
    let text = std::fs::read_to_string(samples).expect("it was written");
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().expect("there is a header");
    let sample_delay = |row: Vec<&str>| {
        let cell = |name: &str| {
            let index = header.iter().position(|column| *column == name);
            row[index.unwrap_or_else(|| panic!("no column {name}"))]
        };
        let seconds = |name: &str| parse_seconds(cell(name)).unwrap_or_else(|| panic!("{name} in {row:?}"));
        let (start, total) = (WallTime::from_unix_nanos(seconds("at").nanos()), seconds("total"));
        let (first, last) = (ahead(start), ahead(start + total));
        let column = |part: &str| seconds(&format!("{stage}-{part}"));
        let middle = Span::from_nanos(i64::midpoint(first.nanos(), last.nanos()));
        SampleDelay {
            payload: cell("payload-bytes").parse().expect("a number"),
            is_warm_up: cell("warm-up") == "1",
            value: parse_seconds(cell(stage)),
            bounds: (column("lo"), column("hi")),
            truth: column("raw") - middle,
            // The column `raw` is the difference of two stamps of wall clocks. A host reads its
            // wall clock up to 3 µs after its free-running clock, by which delays are judged.
            // Rounding adds 2 ns.
            truth_error: (last - first).abs() + Span::from_nanos(3_002),
        }
    };
    rows.map(sample_delay).collect()
}

/// Parses decimal seconds, which have more digits than a float.
fn parse_seconds(text: &str) -> Option<Span> {
    let (whole, fraction) = text.split_once('.')?;
    let digits = format!("{whole}{fraction:0<9}");
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
    let sum = |value: &dyn Fn(&(f64, f64, f64)) -> f64| {
        points.iter().map(|point| point.2 * value(point)).sum::<f64>()
    };
    let total_weight = sum(&|_| 1.0);
    let (mean_x, mean_y) = (sum(&|point| point.0) / total_weight, sum(&|point| point.1) / total_weight);
    let slope =
        sum(&|point| (point.0 - mean_x) * (point.1 - mean_y)) / sum(&|point| (point.0 - mean_x).powi(2));
    mean_y - slope * mean_x
}

fn median(mut spans: Vec<Span>) -> f64 {
    spans.sort();
    let middle = spans.len() / 2;
    let above = spans[middle];
    let below = if spans.len().is_multiple_of(2) { spans[middle - 1] } else { above };
    f64::midpoint(above.seconds(), below.seconds())
}

/// Returns the intercept of a fit to the medians of these delays, with the weights of the calibration's fit.
fn refitted_intercept(direction: &Value, delays: &BTreeMap<u64, Vec<Span>>) -> f64 {
    /// Smallest error of a median in the weights, seconds.
    const MIN_MEDIAN_ERROR: f64 = 1e-7;
    let sizes = direction["sizes"].as_array().expect("a list").iter();
    let point = |size: &Value| {
        let payload = size["payload_bytes"].as_u64().expect("a number");
        let weight = number(&size["median_error"]).max(MIN_MEDIAN_ERROR).powi(-2);
        (number(&size["wire_bytes"]), median(delays[&payload].clone()), weight)
    };
    intercept(&sizes.map(point).collect::<Vec<_>>())
}

/// Groups the delays by size.
fn group_by_size<'a>(
    sample_delays: impl Iterator<Item = (&'a SampleDelay, Span)>,
) -> BTreeMap<u64, Vec<Span>> {
    let mut sizes = BTreeMap::<u64, Vec<Span>>::new();
    for (sample_delay, delay) in sample_delays {
        sizes.entry(sample_delay.payload).or_default().push(delay);
    }
    sizes
}

/// Compares the intervals of one direction with the true delays, and its intercept without the warm-up.
fn assert_intercept_is_right(stage: &str, direction: &Value, sample_delays: &[SampleDelay]) {
    for SampleDelay { payload, bounds: (lo, hi), truth, truth_error, .. } in sample_delays {
        let allowed = *lo - *truth_error..=*hi + *truth_error;
        assert!(allowed.contains(truth), "{stage} of {payload} B: {truth} is not in {allowed:?}");
    }
    let after_warm_up = || sample_delays.iter().filter(|sample_delay| !sample_delay.is_warm_up);
    let reported =
        group_by_size(after_warm_up().filter_map(|sample_delay| Some((sample_delay, sample_delay.value?))));
    let truths = group_by_size(after_warm_up().map(|sample_delay| (sample_delay, sample_delay.truth)));

    let fit = &direction["fits"]["medians"]["least_squares"]["intercept"];
    let (reported_intercept, claimed) = (number(&fit["value"]), pair(&direction["claimed"]["at_zero"]));
    let (refitted, truth) =
        (refitted_intercept(direction, &reported), refitted_intercept(direction, &truths));
    let span = Span::from_seconds_f64;
    let error = span(reported_intercept - truth);
    print_line(&format!(
        "{stage}: intercept {}, of the true delays {}, error {error}; claimed {} to {}",
        span(reported_intercept),
        span(truth),
        span(claimed.0),
        span(claimed.1),
    ));
    assert!(
        (reported_intercept - refitted).abs() < 1e-9,
        "{stage}: the reported intercept is {reported_intercept}, that of the same fit over the table {refitted}"
    );
    assert!(error.abs() <= MAX_ERROR, "{stage}: the intercept is wrong by {error}");
    assert!(
        (claimed.0..=claimed.1).contains(&reported_intercept),
        "{stage}: {reported_intercept} lies outside of the claimed interval {claimed:?}"
    );
}

#[test]
fn calibrated_intercepts_match_true_delays() {
    let testbed = TwoHostTestbed::new(|_| Network::direct());
    let _cloud = testbed.start_cloud(&faults(1_000.0, 50.0, ""));
    let cloud: HostClock = testbed.clock_of("cloud");
    let peer = testbed.peer();
    let sweep = ["--sizes", SIZES, "--repeats", REPEATS, "--seconds", "20"];
    let arguments = [&["calibrate", &peer, "--result-loc", "results"], &sweep[..]].concat();
    let end =
        testbed.network.edge().start(&program("peernet"), &arguments, testbed.folder(), &[]).wait_for_end();
    assert_eq!(end.code(), 0, "{}", end.log);

    let results = testbed.folder().join("results");
    let study = std::fs::read(results.join("calibration.json")).expect("it was written");
    let study: Value = serde_json::from_slice(&study).expect("it is JSON");
    print_line(&format!("verdict {}, {}", study["verdict"], study["counts"]));
    let samples = results.join("samples.csv");
    assert_intercept_is_right(
        "upload",
        &study["up"],
        &sample_delays(&samples, "upload", |at| cloud.ahead(at)),
    );
    assert_intercept_is_right(
        "download",
        &study["down"],
        &sample_delays(&samples, "download", |at| -cloud.ahead(at)),
    );
    assert_eq!(study["verdict"]["kind"], "trusted", "{}", study["verdict"]);
}
