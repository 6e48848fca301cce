use peernet_clock::{DelaySource, Interval, Offset, OneWayDelay, Span, Verdict as DelayVerdict, WallTime};
use peernet_logger::HostId;
use peernet_stream::{NetworkName, ProbeCounts};

use super::*;
use crate::rows::Outcome;

const SIZES: [u64; 8] = [100, 1_000, 10_000, 50_000, 100_000, 400_000, 1_000_000, 4_000_000];
const REPEATS: u64 = 100;
/// Seconds that an empty message takes: 60 µs.
const EMPTY_MESSAGE_S: f64 = 60e-6;
/// Seconds that each byte takes: 1 GB/s.
const PER_BYTE_S: f64 = 1e-9;
/// Half the width of the clock bounds, seconds.
const HALF_WIDTH_S: f64 = 50e-6;

/// Parameters in which a simulated link differs from a good one.
#[derive(Clone, Copy)]
struct Link {
    /// Error of the estimated delay: added to upload, subtracted from download. The bounds do not follow the error.
    estimate_error: f64,
    /// Offset of the clocks in the raw stamps.
    raw_offset: f64,
    /// Seconds per byte squared.
    curvature: f64,
    verdict: DelayVerdict,
    source: DelaySource,
}

const GOOD: Link = Link {
    estimate_error: 0.0,
    raw_offset: 1.0,
    curvature: 0.0,
    verdict: DelayVerdict::Limited,
    source: DelaySource::InBand,
};

/// Returns the queueing time of message `number`, in seconds: exponentially distributed with a mean of 5 µs, and every
/// tenth message is late by up to 300 µs more.
fn queueing_time(number: u64) -> f64 {
    let random = (number.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 11) as f64 / (1_u64 << 53) as f64;
    let late = if number % 10 == 3 { 300e-6 } else { 0.0 };
    -5e-6 * (1.0 - random).ln() + late * random
}

/// Returns message `number` with a payload of `payload` bytes. `sign` is 1 for an upload and −1 for
/// a download: a positive clock error lengthens an upload and shortens a download.
fn passage(link: Link, payload: u64, number: u64, sign: f64) -> Passage {
    let wire = payload + 120;
    let bytes = wire as f64;
    let true_delay =
        EMPTY_MESSAGE_S + PER_BYTE_S * bytes + link.curvature * bytes * bytes + queueing_time(number);
    let value = true_delay + sign * link.estimate_error;
    let span = |seconds: f64| Span::from_seconds_f64(seconds);
    let is_known = matches!(link.verdict, DelayVerdict::Ok | DelayVerdict::Limited);
    let bounds =
        Interval { lo: span((true_delay - HALF_WIDTH_S).max(0.0)), hi: span(true_delay + HALF_WIDTH_S) };
    let delay = OneWayDelay {
        raw: span(true_delay + sign * link.raw_offset),
        value: is_known.then(|| span(value)),
        bounds: is_known.then_some(bounds),
        source: link.source,
        verdict: link.verdict,
    };
    Passage { payload_bytes: payload, metadata_bytes: 120, delay }
}

/// Returns the samples of a study over a link: `REPEATS` rounds of all `SIZES`. The first round is
/// warm-up.
fn sweep(link: Link) -> Vec<Sample> {
    let rounds = (0..REPEATS).flat_map(|round| SIZES.iter().map(move |size| (round, *size)));
    rounds
        .zip(1..)
        .map(|((round, payload_bytes), number)| Sample {
            number,
            at: number as f64,
            payload_bytes,
            warm_up: round == 0,
            outcome: Outcome::Ok,
            reason: None,
            total: Some(1e-3),
            up: Some(passage(link, payload_bytes, 2 * number, 1.0)),
            down: Some(passage(link, payload_bytes, 2 * number + 1, -1.0)),
        })
        .collect()
}

fn study(samples: Vec<Sample>) -> Study {
    let setting = Setting {
        peer: "tcp://cloud:5551".to_owned(),
        edge: "edge".to_owned(),
        cloud: Some("cloud".to_owned()),
        network: "zmq-tcp".to_owned(),
        sizes_bytes: SIZES.to_vec(),
        repeats: REPEATS,
        ..Setting::default()
    };
    Study::new(setting, samples, &[])
}

#[test]
fn median_delay_equals_median_of_study() {
    let mut samples = sweep(GOOD);
    // Slow messages that neither median may count: those of the warm-up, and those of requests that timed out.
    let slow = passage(Link { curvature: 1e-6, ..GOOD }, SIZES[0], 3, 1.0);
    for sample in samples.iter_mut().filter(|sample| sample.warm_up) {
        sample.up = Some(slow);
    }
    let answered =
        samples.iter().find(|sample| sample.is_in_statistics()).cloned().expect("a sample in the statistics");
    samples.extend((0..200).map(|_| Sample {
        outcome: Outcome::Timeout,
        up: Some(slow),
        ..answered.clone()
    }));
    let study = study(samples.clone());
    let [up, _] = study.directions();
    for size in &up.sizes {
        assert_eq!(median_delay(up.direction, &samples, size.payload_bytes), Some(size.median));
    }
    assert_eq!((up.sizes.len(), median_delay(up.direction, &samples, 7)), (SIZES.len(), None));
}

#[test]
fn good_link_is_trusted_and_line_is_fitted() {
    let study = study(sweep(GOOD));
    assert_eq!(study.counts, Counts { measured: 792, warm_up: 8, failed: 0 });
    assert_eq!(study.verdict.kind, VerdictKind::Trusted, "{}", study.verdict.sentence);
    // Each estimate lies in the middle of its bounds.
    assert!((study.verdict.max_error.expect("trusted") - HALF_WIDTH_S).abs() < 10e-6);
    for direction in study.directions() {
        let fits = direction.fits.expect("eight sizes");
        // The intercept includes the median of the queueing time: 3.5 µs.
        for fit in [fits.medians.least_squares, fits.medians.theil_sen, fits.samples.theil_sen] {
            assert!((fit.intercept.value - EMPTY_MESSAGE_S - 3.5e-6).abs() < 4e-6, "{fit:?}");
            assert!((fit.slope.value / PER_BYTE_S - 1.0).abs() < 0.01, "{fit:?}");
        }
        let throughput = direction.throughput.expect("delays grow with size");
        assert!((throughput.value / 8e9 - 1.0).abs() < 0.01, "{throughput:?}");
        let (lo, hi) = throughput.bounds.expect("there are clock bounds");
        assert!(
            lo < throughput.value
                && throughput.value < hi.expect("delays grow by more than the width of the bounds")
        );
    }
    assert!((study.clocks.offset.expect("delays are corrected by it") - 1.0).abs() < 1e-6);
    // The raw differences, as in the paper's study, contain the offset of the clocks: added to upload, subtracted from
    // download.
    let raw = study.directions().map(|direction| direction.fits.expect("eight sizes").raw.intercept.value);
    assert!((raw[0] - 1.0).abs() < 1e-3 && (raw[1] + 1.0).abs() < 1e-3, "{raw:?}");
}

#[test]
fn wrong_clock_relation_is_distinguished_from_bent_line() {
    let wrong = study(sweep(Link { estimate_error: 130e-6, ..GOOD }));
    assert_eq!(wrong.verdict.kind, VerdictKind::Contradicted, "{}", wrong.verdict.sentence);
    assert!(wrong.verdict.sentence.contains("the clocks are at fault"), "{}", wrong.verdict.sentence);
    // The fitted delay of an empty message is negative, which is impossible.
    assert!(wrong.down.main_fit().expect("a line").intercept.value < 0.0);

    let bent = study(sweep(Link { curvature: 4e-15, ..GOOD }));
    assert_eq!(bent.verdict.kind, VerdictKind::Inconclusive, "{}", bent.verdict.sentence);
    assert!(bent.verdict.sentence.contains("straight line"), "{}", bent.verdict.sentence);
}

#[test]
fn each_kind_of_sweep_has_own_verdict() {
    let kind = |link: Link| study(sweep(link)).verdict.kind;
    assert_eq!(kind(Link { verdict: DelayVerdict::Stepped, ..GOOD }), VerdictKind::Stepped);
    assert_eq!(kind(Link { verdict: DelayVerdict::Inconsistent, ..GOOD }), VerdictKind::Inconsistent);
    assert_eq!(kind(Link { verdict: DelayVerdict::Unsynchronised, ..GOOD }), VerdictKind::Unsynchronised);
    assert_eq!(
        kind(Link { verdict: DelayVerdict::Ok, source: DelaySource::SameClock, ..GOOD }),
        VerdictKind::Exact
    );
    assert_eq!(study(Vec::new()).verdict.kind, VerdictKind::Insufficient);
    let mut two_sizes = sweep(GOOD);
    two_sizes.retain(|sample| sample.payload_bytes < 5_000);
    assert_eq!(study(two_sizes).verdict.kind, VerdictKind::Insufficient);
}

#[test]
fn lost_answers_are_counted_and_written() {
    let mut samples = sweep(GOOD);
    let lost = samples.last_mut().expect("there are some");
    (lost.outcome, lost.up, lost.down) = (Outcome::Lost, None, None);
    lost.reason = Some("the connection broke: reset".to_owned());
    let study = study(samples);
    assert_eq!(study.counts, Counts { measured: 791, warm_up: 8, failed: 1 });
    let folder = tempfile::tempdir().expect("a folder");
    study.write(folder.path()).expect("writes");
    let rows = std::fs::read_to_string(folder.path().join("samples.csv")).expect("written");
    assert_eq!(rows.lines().count(), 801);
    let lost = rows.lines().last().expect("there are rows");
    assert!(lost.starts_with("800,800.000000,4000000,0,lost,0.001000000,,,"), "{lost}");
    assert!(lost.ends_with(",the connection broke: reset"), "{lost}");
}

#[test]
fn reasons_for_unanswered_payloads_are_counted() {
    let mut samples = sweep(GOOD);
    let fail = |samples: &mut [Sample], count: usize, outcome: Outcome, reason: Option<&str>| {
        let answered = samples.iter_mut().filter(|sample| sample.is_in_statistics());
        for sample in answered.take(count) {
            (sample.outcome, sample.up, sample.down) = (outcome, None, None);
            sample.reason = reason.map(str::to_owned);
        }
    };
    fail(&mut samples, 3, Outcome::Failed, Some("too large"));
    fail(&mut samples, 1, Outcome::Failed, Some("overloaded"));
    fail(&mut samples, 2, Outcome::Timeout, None);
    let study = study(samples);
    let failures = [(Outcome::Failed, 4, Some("too large")), (Outcome::Timeout, 2, None)];
    let failures = failures.map(|(outcome, count, reason)| Failures {
        outcome,
        count,
        commonest_reason: reason.map(str::to_owned),
    });
    assert_eq!(study.failures, failures);
    let sentence = "6 of 792 payloads were not answered: 4 failed (most often: too large), 2 timed out";
    assert!(study.text().contains(sentence), "{}", study.text());
}

#[test]
fn same_clock_study_prints_exact_instead_of_bounds() {
    let study = study(sweep(Link { verdict: DelayVerdict::Ok, source: DelaySource::SameClock, ..GOOD }));
    let text = study.text();
    let rows: Vec<&str> = text.lines().filter(|line| line.contains("exact")).collect();
    // Lines with `exact`: a row for each size, the row of the clock bounds of each direction, and the verdict.
    assert_eq!(rows.len(), SIZES.len() + 3, "{text}");
}

/// Returns a clock sample at second `at` that says that the cloud's clock is ahead by `ahead_ms` milliseconds.
fn clock_sample(at: i64, relation_period: u64, ahead_ms: i64) -> ClockSample {
    let at = WallTime::from_unix_nanos(at * 1_000_000_000);
    let estimate = Span::from_millis(ahead_ms);
    let offset = Offset {
        at,
        estimate,
        bounds: Interval { lo: estimate - Span::from_micros(50), hi: estimate + Span::from_micros(50) },
        source: DelaySource::InBand,
        sources: Vec::new(),
        verdict: DelayVerdict::Ok,
        skew_ppm: None,
        exchanges: 100,
        age: None,
    };
    ClockSample {
        peer: HostId::random(),
        peer_name: "cloud".parse().expect("a name"),
        at,
        relation_period,
        max_drift_ppm: 50.0,
        upper: None,
        lower: None,
        offset: Some(offset),
        probes: ProbeCounts::default(),
        exchanges: peernet_clock::ExchangeCounts::default(),
        round_trip: None,
        up: None,
        down: None,
        network: NetworkName::default(),
        basis: None,
    }
}

#[test]
fn returned_peer_is_trusted_if_clock_is_unchanged() {
    let study = |clock_samples: &[ClockSample]| {
        Study::new(Setting { reconnections: 1, ..Setting::default() }, sweep(GOOD), clock_samples)
    };
    let unchanged = study(&[clock_sample(1, 7, 1_000), clock_sample(2, 7, 1_000), clock_sample(9, 8, 1_000)]);
    assert_eq!(
        (unchanged.verdict.kind, unchanged.clocks.steps),
        (VerdictKind::Trusted, 0),
        "{}",
        unchanged.verdict.sentence
    );
    assert!(unchanged.verdict.sentence.contains("the peer went away once"), "{}", unchanged.verdict.sentence);
    assert!(unchanged.verdict.sentence.contains("related again"), "{}", unchanged.verdict.sentence);
    // Ten minutes of drift by 50 ppm are 30 ms.
    let drifted = study(&[clock_sample(1, 7, 1_000), clock_sample(601, 8, 1_029)]);
    assert_eq!(drifted.clocks.steps, 0);
    let changed = study(&[clock_sample(1, 7, 1_000), clock_sample(9, 8, 1_001)]);
    assert_eq!((changed.verdict.kind, changed.clocks.steps), (VerdictKind::Stepped, 1));
}

#[test]
fn contradictory_offset_gives_no_skew() {
    let with_skew = |second: i64, verdict: DelayVerdict, skew_ppm: f64| {
        let mut sample = clock_sample(second, 7, 1_000);
        sample.offset = sample.offset.map(|offset| Offset { verdict, skew_ppm: Some(skew_ppm), ..offset });
        sample
    };
    let samples = [with_skew(1, DelayVerdict::Ok, 12.4), with_skew(2, DelayVerdict::Inconsistent, 900.0)];
    let study = Study::new(Setting::default(), sweep(GOOD), &samples);
    assert_eq!(study.clocks.skew_ppm, Some(12.4));
}

#[test]
fn all_study_files_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let written = study(sweep(GOOD)).write(folder.path()).expect("writes");
    let names: Vec<_> = written.iter().filter_map(|path| path.file_name()?.to_str()).collect();
    assert_eq!(names, ["samples.csv", "summary.csv", "calibration.json"]);
    let json = std::fs::read(folder.path().join("calibration.json")).expect("written");
    let json: serde_json::Value = serde_json::from_slice(&json).expect("JSON");
    assert_eq!((&json["verdict"]["kind"], &json["up"]["direction"]), (&"trusted".into(), &"up".into()));
    assert_eq!(json["down"]["sizes"].as_array().map(Vec::len), Some(SIZES.len()));
}

#[test]
fn text_shows_sizes_lines_and_verdict() {
    let text = study(sweep(GOOD)).text();
    for part in [
        "100 B ",
        "4 MB ",
        "upload: least squares, medians",
        "download: as published: raw stamps",
        "can be trusted to ±",
    ] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
    // The first nine lines are the table of the sizes.
    let widest = text.lines().take(9).map(|line| line.chars().count()).max();
    assert!(widest.is_some_and(|widest| widest <= 120), "{text}");
}
