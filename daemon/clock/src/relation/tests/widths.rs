//! Widths of intervals and errors of estimates.

use super::*;

/// Returns the median width and the mean error of the estimate of the delays over a path, in milliseconds, and the
/// number of suspected jumps.
fn measure(path: Path, settings: RelationSettings, host_clocks: &HostClocks) -> (f64, f64, u32) {
    let mut relation = Relation::new(settings);
    let (mut widths, mut errors) = (Vec::new(), 0.0);
    for trip in path.trips(host_clocks, (0.0, 300.0), 10.0, &mut RandomSource::new(9)) {
        let judged = relation.judge(&trip.observation());
        for (delay, truth) in [(judged.up, trip.up), (judged.down, trip.down)] {
            if trip.end > 20e9 {
                widths.push(delay.bounds.expect("bounds").width().seconds() * 1e3);
                errors += (delay.value.expect("a value") - truth).abs().seconds() * 1e3;
            }
        }
    }
    widths.sort_by(f64::total_cmp);
    (widths[widths.len() / 2], errors / widths.len() as f64, relation.exchange_counts().restarts)
}

/// Returns the clocks of two ordinary machines, whose oscillators warm up and cool down.
fn host_clocks() -> HostClocks {
    let mut random = RandomSource::new(1);
    let mut clock =
        |offset| SimulatedClock::warming(offset, 20.0, 0.02, Span::from_seconds(320), &mut random);
    HostClocks { edge: clock(Span::ZERO), cloud: clock(Span::from_seconds(5)) }
}

/// Returns settings for wall clocks. The change of their drift has no limit.
fn wall_limit(max_drift_ppm: f64) -> RelationSettings {
    RelationSettings { clocks: RelatedClocks::Wall, max_drift_ppm, ..RelationSettings::default() }
}

/// Returns settings for free-running clocks. The change of their drift is limited, too.
fn free_running_limit(max_drift_ppm: f64) -> RelationSettings {
    RelationSettings { clocks: RelatedClocks::Raw, ..wall_limit(max_drift_ppm) }
}

#[test]
fn limit_of_drift_change_narrows_intervals_under_jitter() {
    let host_clocks = host_clocks();
    for (jitter, max_wide, max_narrow) in [(5e6, 1.2, 0.8), (20e6, 2.0, 1.8)] {
        let path = Path { up: 100e3, down: 100e3, jitter, loss: 0.0, burst: 0.0 };
        let (wide, ..) = measure(path, wall_limit(200.0), &host_clocks);
        let (narrow, _, jumps) = measure(path, free_running_limit(200.0), &host_clocks);
        assert!(narrow < wide && wide < max_wide && narrow < max_narrow, "{narrow} {wide}");
        assert_eq!(jumps, 0);
    }
}

/// A four times higher limit of drift does not widen intervals if the change of the drift is limited, too.
#[test]
fn higher_drift_limit_widens_no_intervals() {
    let host_clocks = host_clocks();
    let (low_limit_width, low_limit_error, _) = measure(Path::VETH, wall_limit(50.0), &host_clocks);
    let (width, error, jumps) = measure(Path::VETH, free_running_limit(200.0), &host_clocks);
    assert!(
        width <= low_limit_width && error <= low_limit_error && error < 0.001,
        "{width} {low_limit_width} {error}"
    );
    assert_eq!(jumps, 0);
}
