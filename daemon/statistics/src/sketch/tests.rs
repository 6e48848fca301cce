use proptest::prelude::*;

use super::*;

fn sketch_of(values: &[f64]) -> Sketch {
    let mut sketch = Sketch::default();
    values.iter().for_each(|value| sketch.record(*value));
    sketch
}

/// Returns the exact quantile, and the permitted error: 1 % of each neighbour, weighted as in the interpolation.
fn exact_quantile(values: &[f64], q: f64) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = q * (sorted.len() - 1) as f64;
    let (lower, upper) = (sorted[rank.floor() as usize], sorted[rank.ceil() as usize]);
    let interpolate = |lower: f64, upper: f64| lower * (1.0 - rank.fract()) + upper * rank.fract();
    (interpolate(lower, upper), interpolate(lower.abs(), upper.abs()) * Sketch::RELATIVE_ERROR)
}

/// Generates durations, throughputs and temperatures, and distributions that are difficult for sketches. The numbers
/// span less than the factor of 6 × 10¹⁷ that the bins of a sketch span.
fn numbers() -> impl Strategy<Value = Vec<f64>> {
    let uniform = 1e-6..1e7_f64;
    let signed = (-1e3..1e3_f64).prop_filter("counts as zero", |value| value.abs() >= Sketch::MIN_MAGNITUDE);
    let pareto = (1e-6..1.0_f64).prop_map(|u| 1e-3 * u.powf(-1.5));
    let log_normal = (-5.0..6.0_f64).prop_map(|z| (3.0 * z).exp() * 1e-3);
    let number = prop_oneof![uniform, signed, pareto, log_normal, Just(0.0), Just(0.02)];
    prop::collection::vec(number, 1..400)
}

proptest! {
    #[test]
    fn quantiles_are_within_one_percent(values in numbers()) {
        let sketch = sketch_of(&values);
        for q in [0.0, 0.1, 0.5, 0.9, 0.95, 0.99, 0.999, 1.0] {
            let estimate = sketch.quantile(q).expect("not empty");
            let (truth, error) = exact_quantile(&values, q);
            prop_assert!((estimate - truth).abs() <= error * (1.0 + 1e-6), "q {q}: {estimate} {truth}");
        }
    }

    #[test]
    fn merged_sketches_equal_sketch_of_all_numbers(a in numbers(), b in numbers()) {
        let mut merged = sketch_of(&a);
        merged.merge(&sketch_of(&b));
        let mut other_way = sketch_of(&b);
        other_way.merge(&sketch_of(&a));
        prop_assert_eq!(&merged, &sketch_of(&[a, b].concat()));
        prop_assert_eq!(merged, other_way);
    }

    #[test]
    fn merged_collapsed_sketches_equal_sketch_of_all_numbers(
        a in prop::collection::vec(-9.0..300.0_f64, 0..40), b in prop::collection::vec(-9.0..300.0_f64, 0..40),
    ) {
        let raise = |exponents: &[f64]| exponents.iter().map(|e| 10_f64.powf(*e)).collect::<Vec<_>>();
        let (a, b) = (raise(&a), raise(&b));
        let mut merged = sketch_of(&a);
        merged.merge(&sketch_of(&b));
        prop_assert_eq!(&merged, &sketch_of(&[&a[..], &b[..]].concat()));
        prop_assert_eq!(merged.count(), (a.len() + b.len()) as u64);
        prop_assert!(merged.bins().count() <= Sketch::MAX_BINS);
    }

    #[test]
    fn packed_form_is_read_back(values in numbers()) {
        let sketch = sketch_of(&values);
        prop_assert_eq!(&Sketch::from_bytes(&sketch.to_bytes()).expect("reads back"), &sketch);
        let wire = rmp_serde::to_vec(&sketch).expect("serialises");
        prop_assert_eq!(&rmp_serde::from_slice::<Sketch>(&wire).expect("reads back"), &sketch);
    }

    #[test]
    fn damaged_bytes_are_refused_or_give_valid_sketch(values in numbers(), at: prop::sample::Index, bit in 0..8) {
        let mut bytes = sketch_of(&values).to_bytes();
        let at = at.index(bytes.len());
        bytes[at] ^= 1_u8 << bit;
        if let Ok(sketch) = Sketch::from_bytes(&bytes) {
            prop_assert_eq!(Sketch::from_bytes(&sketch.to_bytes()), Ok(sketch));
        }
        prop_assert!(Sketch::from_bytes(&bytes[..at]).is_err());
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes: Vec<u8>) {
        let _ = Sketch::from_bytes(&bytes);
    }

    #[test]
    fn all_numbers_lie_between_smallest_and_largest_float(values in numbers()) {
        let sketch = sketch_of(&values);
        prop_assert_eq!(sketch.fraction_below(f64::MAX), Some(1.0));
        prop_assert_eq!(sketch.fraction_below(f64::MIN), Some(0.0));
    }

    #[test]
    fn fraction_below_is_right_within_width_of_bin(values in numbers(), x in 1e-3..1e3_f64) {
        let fraction = sketch_of(&values).fraction_below(x).expect("not empty");
        let below = |x: f64| values.iter().filter(|value| **value < x).count() as f64 / values.len() as f64;
        prop_assert!(below(x * 0.979) - 1e-9 <= fraction && fraction <= below(x * 1.021) + 1e-9);
    }
}

#[test]
fn quantiles_of_few_numbers_equal_numpy() {
    let sketch = sketch_of(&[10.0, 20.0, 40.0]);
    for (q, numpy) in [(0.25, 15.0), (0.5, 20.0), (0.75, 30.0), (0.95, 38.0)] {
        let estimate = sketch.quantile(q).expect("not empty");
        assert!((estimate - numpy).abs() <= 0.01 * numpy, "q {q}: {estimate}");
    }
}

#[test]
fn empty_sketch_has_no_quantile() {
    let sketch = Sketch::default();
    assert_eq!((sketch.count(), sketch.quantile(0.5), sketch.fraction_below(1.0)), (0, None, None));
    assert_eq!(sketch.to_bytes().len(), 3);
}

#[test]
fn non_finite_numbers_are_ignored() {
    assert_eq!(sketch_of(&[f64::NAN, f64::INFINITY, f64::NEG_INFINITY]), Sketch::default());
}

#[test]
fn numbers_far_below_maximum_share_one_bin() {
    // The bins do not span the range from 1e-9 to 1e300. The lowest bins are merged; the largest quantiles keep their
    // precision.
    let sketch = sketch_of(&[1e-9, 1e-8, 1e300]);
    assert_eq!(sketch.count(), 3);
    let top = sketch.quantile(1.0).expect("not empty");
    assert!((top / 1e300 - 1.0).abs() <= 0.0101);
}

#[test]
fn typical_stage_is_stored_in_few_bytes() {
    let values: Vec<f64> = (0..10_000).map(|n| 0.002 * (1.0 + f64::from(n % 100) / 100.0)).collect();
    let bytes = sketch_of(&values).to_bytes();
    assert!(bytes.len() < 150, "{}", bytes.len());
}

#[test]
fn sketch_of_impossible_content_is_refused() {
    // The bytes are the count of zeros, the negative bins and the positive bins. A list of bins begins with its length;
    // the first key 2 stands for 1, and each further key is the distance from the key before it.
    for (bytes, error) in [
        (vec![0, 0, 0, 0], PackedError::Trailing(1)),
        (vec![0, 0x81, 0x10, 0], PackedError::TooManyBins(2049)),
        // A bin without numbers, two bins with the same key, and a key that no number has.
        (vec![0, 1, 2, 0, 0], PackedError::InvalidBin),
        (vec![0, 2, 2, 1, 0, 1, 0], PackedError::InvalidBin),
        (vec![0, 1, 0xff, 0xff, 0x7f, 1, 0], PackedError::InvalidBin),
    ] {
        assert_eq!(Sketch::from_bytes(&bytes), Err(error), "{bytes:?}");
    }
    // The LEB128 form of the largest `u64`.
    let max_count = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01];
    let overflowing = [&max_count[..], &[1, 2], &max_count, &[0]].concat();
    assert_eq!(Sketch::from_bytes(&overflowing), Err(PackedError::Overflow));
}
