use super::*;

fn micros(micros: i64) -> Span {
    Span::from_micros(micros)
}

/// Returns the readings after the machine was awake for `awake`, with a wall clock that is ahead by `ahead`.
fn readings(awake: Span, ahead: Span) -> Readings {
    let mono = MonoTime::default() + awake;
    let raw = RawTime::from_nanos(1 << 50) + awake;
    Readings { wall: WallTime::from_unix_nanos(1 << 60) + awake + ahead, mono, raw, boot: mono }
}

fn pair(at: Span, ahead: Span, gap: Span) -> PairedReading {
    let before = MonoTime::default() + at;
    let between = WallTime::from_unix_nanos(1 << 60) + at + ahead + Span::from_nanos(gap.nanos() / 2);
    PairedReading { before, between: between.unix_nanos(), after: before + gap }
}

#[test]
fn difference_within_reading_uncertainty_is_no_step() {
    let calm = Span::from_nanos(80);
    let mut steps = StepWatch::default();
    // Returns the number of steps so far.
    let compare = |steps: &mut StepWatch, millis, ahead, gap| {
        steps.compare(pair(Span::from_millis(millis), ahead, gap))
    };
    assert_eq!(compare(&mut steps, 0, Span::ZERO, calm), 0);
    assert_eq!(compare(&mut steps, 10, micros(15), calm), 0);
    assert_eq!(compare(&mut steps, 20, micros(50), calm), 1);
    assert_eq!(steps.last_step(), Some(micros(35)));
    assert_eq!(compare(&mut steps, 30, micros(-3_000_000), calm), 2);
    // The reading was interrupted, so a step of 40 µs cannot be told from the gap.
    assert_eq!(compare(&mut steps, 40, micros(-3_000_040), micros(200)), 2);
    // An uninterrupted reading shows the same difference, which is now certain.
    assert_eq!(compare(&mut steps, 41, micros(-3_000_040), calm), 3);
    steps.begin_epoch();
    assert_eq!(compare(&mut steps, 42, micros(-3_000_040), calm), 4);
}

/// A clocksource without a fast path takes some microseconds for each reading, so no reading is uninterrupted.
#[test]
fn step_is_detected_with_slow_clocksource() {
    let mut steps = StepWatch::default();
    let mut compare = |second: i64, ahead, gap| steps.compare(pair(Span::from_seconds(second), ahead, gap));
    // The first reading has the shortest gap.
    assert_eq!(compare(0, Span::ZERO, micros(4)), 0);
    for second in 1..3_600 {
        assert_eq!(compare(second, Span::ZERO, micros(5 + second % 3)), 0);
    }
    // In an hour, a difference in rate could explain 720 ms.
    assert_eq!(compare(3_600, Span::from_millis(100), micros(5)), 1);
}

#[test]
fn constant_drift_is_no_step() {
    let mut steps = StepWatch::default();
    for second in 0..600 {
        let at = Span::from_seconds(second);
        assert_eq!(steps.compare(pair(at, Span::from_micros(100 * second), Span::from_nanos(80))), 0);
    }
}

#[test]
fn interrupted_read_is_repeated() {
    let mut reads = [50, 40, 2, 1].into_iter().map(|gap| pair(Span::ZERO, Span::ZERO, micros(gap)));
    let best = PairedReading::read_uninterrupted(|| reads.next().expect("another reading"));
    assert_eq!(best.after - best.before, micros(2));
    // If all readings are interrupted, the clocks are read eight times. The ninth reading is not taken.
    let mut interrupted_reads =
        [50, 40, 30, 90, 20, 60, 70, 80, 10].into_iter().map(|gap| pair(Span::ZERO, Span::ZERO, micros(gap)));
    let best = PairedReading::read_uninterrupted(|| interrupted_reads.next().expect("another reading"));
    assert_eq!(best.after - best.before, micros(20));
}

/// Returns the disturbances that a watch with a drift limit of `max_drift_ppm` reports. `readings_at` returns the
/// readings at a tenth of a second.
fn disturbances_of(
    max_drift_ppm: f64,
    seconds: i64,
    readings_at: impl Fn(i64) -> Readings,
) -> Vec<Disturbance> {
    let mut watch = ClockWatch::new(max_drift_ppm);
    (0..seconds * 10).flat_map(|tenth| watch.compare(readings_at(tenth))).collect()
}

#[test]
fn step_is_reported_once_and_steady_clock_never() {
    let tenths = |tenth: i64| Span::from_millis(100 * tenth);
    assert_eq!(disturbances_of(50.0, 60, |tenth| readings(tenths(tenth), Span::ZERO)), []);
    for by in [micros(150), micros(-150), Span::from_seconds(3), Span::from_seconds(-3600)] {
        let stepped = |tenth| readings(tenths(tenth), if tenth < 111 { Span::ZERO } else { by });
        assert_eq!(disturbances_of(50.0, 60, stepped), [Disturbance::Step(by)]);
    }
}

#[test]
fn slew_is_distinguished_from_constant_drift() {
    // The rate is a constant 60 ppm, for which a time daemon compensates.
    let rate =
        |tenth: i64, ppm: i64| readings(Span::from_millis(100 * tenth), Span::from_nanos(tenth * 100 * ppm));
    assert_eq!(disturbances_of(50.0, 60, |tenth| rate(tenth, 60)), []);
    // The rate is higher by 300 ppm for twenty seconds. The monotonic clock is slewed as well, so no step shows.
    let slewed = |tenth: i64| {
        let slew = Span::from_nanos((tenth - 300).clamp(0, 200) * 100 * 300);
        let plain = rate(tenth, 60);
        Readings { wall: plain.wall + slew, mono: plain.mono + slew, boot: plain.boot + slew, ..plain }
    };
    let reported = disturbances_of(50.0, 90, slewed);
    assert!((3..=5).contains(&reported.len()), "{reported:?}");
    assert!(
        reported
            .iter()
            .all(|disturbance| matches!(disturbance, Disturbance::Slew(ppm) if (100.0..320.0).contains(ppm))),
        "{reported:?}"
    );
    // No crystal is off by 400 ppm. The slew is reported from the start, and repeatedly.
    assert!(disturbances_of(50.0, 60, |tenth| rate(tenth, 400)).len() >= 9);
    assert_eq!(disturbances_of(150.0, 60, |tenth| rate(tenth, 100)), []);
}

#[test]
fn suspend_is_reported_and_is_no_step() {
    let sleep = Span::from_seconds(7);
    let readings_with_sleep = |wake_step: Span| {
        move |tenth: i64| {
            let plain = readings(Span::from_millis(100 * tenth), Span::ZERO);
            if tenth < 50 {
                return plain;
            }
            Readings { wall: plain.wall + sleep + wake_step, boot: plain.boot + sleep, ..plain }
        }
    };
    assert_eq!(disturbances_of(50.0, 20, readings_with_sleep(Span::ZERO)), [Disturbance::Suspend(sleep)]);
    let wake_step = Span::from_millis(-400);
    assert_eq!(
        disturbances_of(50.0, 20, readings_with_sleep(wake_step)),
        [Disturbance::Suspend(sleep), Disturbance::Step(wake_step)]
    );
}
