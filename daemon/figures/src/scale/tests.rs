//! Scales and their ticks.

use proptest::prelude::*;

use super::*;

fn texts(scale: Scale, max_ticks: usize) -> Vec<String> {
    scale.ticks(max_ticks).into_iter().map(|tick| tick.text).collect()
}

#[test]
fn steps_are_one_two_or_five() {
    let cases = [(10.0, 5, 2.0), (15.0, 3, 5.0), (0.37, 5, 0.1), (1_800.0, 4, 500.0), (9.0, 1, 10.0)];
    for (range, max_steps, step) in cases {
        assert!(
            (round_step(range, max_steps) / step - 1.0).abs() < 1e-9,
            "{range} {max_steps}: {}",
            round_step(range, max_steps)
        );
    }
    assert_eq!([0.0, -3.0, f64::NAN, f64::INFINITY].map(|range| round_step(range, 5)), [1.0; 4]);
}

#[test]
fn logarithmic_positions_stay_within_scale() {
    let scale = Scale::logarithmic((1.0, 1e4));
    let percents = [1.0, 10.0, 1e4, 0.0, 1e9].map(|value| (scale.at(value) * 100.0).round());
    assert_eq!(percents, [0.0, 25.0, 100.0, 0.0, 100.0]);
    assert_eq!(scale.ticks(9).len(), 5);
    assert_eq!(texts(Scale::logarithmic((0.3, 7.0)), 9), ["0.5", "1", "2", "5"]);
    assert_eq!(
        texts(Scale::logarithmic((0.029, 0.092)), 5),
        ["0.04", "0.06", "0.08"],
        "1, 2 and 5 times the powers of ten give fewer than three ticks, so the ticks are evenly spaced"
    );
    assert_eq!(
        texts(Scale::logarithmic((1e-9, 1e9)), 5).len(),
        10,
        "every second of 19 powers of ten has a tick"
    );
}

#[test]
fn range_above_ratio_is_wide() {
    assert_eq!(
        [(1.0, 12.0), (1.0, 12.1), (0.0, 9.0), (-1.0, 90.0)].map(is_wide),
        [false, true, false, false]
    );
}

#[test]
fn extreme_values_have_few_ticks_and_finite_positions() {
    let extremes =
        [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, -1e308, 1e17, 0.0, 5e-324, 1e-308, 7.0];
    for values in extremes.into_iter().flat_map(|lo| extremes.map(|hi| (lo, hi))) {
        for make in [Scale::linear, Scale::from_zero, Scale::logarithmic] {
            for scale in [make(values), make(values).widened(5)] {
                assert!(scale.ticks(6).len() <= 13, "{values:?}");
                assert!(extremes.iter().all(|value| (0.0..=1.0).contains(&scale.at(*value))), "{values:?}");
                assert!(scale.along(9).all(f64::is_finite), "{values:?}");
            }
        }
    }
}

#[test]
fn linear_scale_has_ticks_at_round_numbers() {
    let scale = Scale::linear((0.0, 10.0));
    assert_eq!([0.0, 2.5, 10.0, -3.0, 99.0].map(|value| scale.at(value)), [0.0, 0.25, 1.0, 0.0, 1.0]);
    assert_eq!(texts(scale, 5), ["0", "2", "4", "6", "8", "10"]);
    assert_eq!(texts(Scale::linear((0.0612, 0.0618)), 4), ["0.0612", "0.0614", "0.0616", "0.0618"]);
    assert_eq!(texts(Scale::linear((-1500.0, 2600.0)), 5), ["−1,000", "0", "1,000", "2,000"]);
    assert_eq!(texts(Scale::from_zero((0.0, 2.0)).whole(), 5), ["0", "1", "2"]);
    assert_eq!(texts(Scale::linear((7.0, 7.0)), 5), ["6.5", "7.0", "7.5"]);
    assert_eq!(Scale::from_zero((3.0, 3.0)).ends(), (0.0, 3.12));
    assert_eq!(Scale::from_zero((0.0, 0.0)).ends(), (0.0, 1.0));
    assert_eq!(Scale::from_zero((-5.0, -5.0)).ends(), (-5.2, 0.0));
}

#[test]
fn widened_scale_ends_at_ticks() {
    assert_eq!(texts(Scale::linear((0.0, 14.2)).widened(3), 9), ["0", "5", "10", "15"]);
    let signed = Scale::linear((-2.4, 2.4)).widened(6).signed();
    assert_eq!(texts(signed, 6), ["−3", "−2", "−1", "0", "+1", "+2", "+3"]);
    assert_eq!(
        texts(Scale::linear((1_203.53, 1_204.83)).widened(3), 3),
        ["1,203.5", "1,204.0", "1,204.5", "1,205.0"]
    );
}

#[test]
fn scale_up_to_value_ends_above_value() {
    assert_eq!(texts(Scale::up_to(25.7, 6), 9), ["0", "5", "10", "15", "20", "25", "30"]);
    assert_eq!(texts(Scale::up_to(0.37, 5), 9), ["0", "0.1", "0.2", "0.3", "0.4"]);
    assert_eq!(texts(Scale::up_to(1_800.0, 4), 9), ["0", "500", "1,000", "1,500", "2,000"]);
    assert_eq!(
        [0.0, -3.0, f64::NAN, f64::INFINITY].map(|largest| Scale::up_to(largest, 5).ends().1),
        [1.0; 4]
    );
    let scale = Scale::up_to(10.0, 5);
    assert_eq!(
        [-99.0, 5.0, 99.0].map(|value| scale.at_or_outside(value)),
        [-0.05, 0.5, 1.05],
        "a value beyond an end lies outside of the plot"
    );
}

proptest! {
    #[test]
    fn widened_scale_contains_values_with_few_ticks(lo in -1e6f64..1e6, width in 1e-3f64..1e6, max_ticks in 2usize..8) {
        let scale = Scale::linear((lo, lo + width)).widened(max_ticks);
        let (from, to) = scale.ends();
        prop_assert!(from <= lo + width * 1e-6 && to >= lo + width * (1.0 - 1e-6));
        let ticks = scale.ticks(max_ticks);
        prop_assert!((2..=max_ticks + 3).contains(&ticks.len()), "{ticks:?}");
        prop_assert!(ticks[0].at.abs() < 1e-6 && (ticks[ticks.len() - 1].at - 1.0).abs() < 1e-6, "{ticks:?}");
    }
}
