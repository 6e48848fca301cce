use proptest::prelude::*;
use serde_json::Value;

use super::*;

/// Test cases that `tests/browser/numbers.mjs` also applies to the dashboard's script.
const CASES: &str = include_str!("../../tests/numbers.json");

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
fn shared_table_of_numbers_is_formatted_as_listed() {
    let cases: Value = serde_json::from_str(CASES).expect("JSON");
    for (function, cases) in cases.as_object().expect("functions") {
        for case in cases.as_array().expect("cases") {
            let (value, text) = (&case[0], case[1].as_str().expect("a text"));
            let written = match function.as_str() {
                "fixed" => fixed(number(&value[0]), value[1].as_u64().expect("decimals") as usize),
                "milliseconds" => milliseconds(number(value) / 1e3),
                "throughput" => throughput(number(value) * 8e6),
                "count" => count(value.as_u64().expect("a count")),
                other => panic!("unknown function {other}"),
            };
            assert_eq!(written, text, "{function} of {value}");
        }
    }
}

#[test]
fn rounding_to_power_of_ten_keeps_three_digits() {
    let shown = [0.099_99, 0.009_996, 0.999_6, 0.099_94].map(|value| milliseconds(value / 1e3));
    assert_eq!(shown, ["0.100", "0.0100", "1.00", "0.0999"]);
}

#[test]
fn durations_have_three_significant_digits() {
    let cases = [
        (0.0, "0.00\u{202f}ms"),
        (0.000_018_3, "0.0183\u{202f}ms"),
        (0.000_099_96, "0.100\u{202f}ms"),
        (0.000_62, "0.620\u{202f}ms"),
        (0.006_312, "6.31\u{202f}ms"),
        (0.009_996, "10.0\u{202f}ms"),
        (0.016_14, "16.1\u{202f}ms"),
        (0.099_96, "100\u{202f}ms"),
        (0.141_2, "141\u{202f}ms"),
        (0.999_6, "1.00\u{202f}s"),
        (1.236, "1.24\u{202f}s"),
        (12.36, "12.4\u{202f}s"),
    ];
    for (seconds, text) in cases {
        assert_eq!(duration(seconds).to_string(), text);
    }
    assert_eq!(
        [0.000_126, 0.006_31, 0.016_1, 0.141_2, 1.242_7].map(milliseconds),
        ["0.126", "6.31", "16.1", "141", "1,243"]
    );
}

#[test]
fn only_short_round_trips_have_three_decimals() {
    assert_eq!((trip_ms(0.001_3).as_str(), trip_ms(0.000_018).as_str()), ("1.30", "0.018"));
}

#[test]
fn table_keeps_decimals_and_distinguishes_small_from_zero() {
    let stage_ms = |seconds| DurationFormat::default().duration(seconds);
    assert_eq!(stage_ms(0.004_70), "4.70");
    assert_eq!(stage_ms(0.033_46), "33.46");
    assert_eq!(stage_ms(1.204_18), "1,204.18");
    assert_eq!(stage_ms(0.0), "0");
    assert_eq!(stage_ms(0.000_004), "<0.01");
    assert_eq!(stage_ms(0.000_006), "0.01");
    let column = DurationFormat::for_total(Some(0.018_94), Some(0.001_1));
    assert_eq!([0.018_94, 4e-6].map(|it| column.duration(it)), ["18.94", "<0.01"]);
    let short = DurationFormat::for_total(Some(18.31e-6), None);
    assert_eq!(
        [18.31e-6, 4.2e-6, 0.0, 1e-8].map(|it| short.duration(it)),
        ["0.0183", "0.0042", "0", "<0.0001"]
    );
    assert_eq!(
        (short.difference(-2.06e-6).as_str(), short.number(0.0).as_str()),
        ("\u{2212}0.0021", "0.0000")
    );
    // A run's page has `0.126 ± 0.012` in its header. The row of the total has the same digits.
    let column = DurationFormat::for_total(Some(126e-6), Some(12e-6));
    assert_eq!([column.duration(126e-6), column.number(12e-6)], ["0.126", "0.012"]);
    assert_eq!([0.018_94, 126e-6, 40e-6, 0.0].map(total_ms), ["18.9", "0.126", "0.0400", "0"]);
}

#[test]
fn differences_carry_their_sign_and_zero_has_none() {
    let difference = |seconds| DurationFormat::default().difference(seconds);
    assert_eq!(difference(0.000_03), "+0.03");
    assert_eq!(difference(-0.000_02), "\u{2212}0.02");
    assert_eq!(difference(0.000_002), "0.00");
    assert_eq!(difference(-0.000_002), "0.00");
    assert_eq!(difference(-1.204_18), "\u{2212}1,204.18");
}

#[test]
fn deviation_limits_digits_of_value() {
    assert_eq!(mean_std_ms(0.016_22, Some(0.001_1)), ("16.2".into(), Some("1.1".into())));
    assert_eq!(mean_std_ms(0.006_34, Some(0.000_91)), ("6.34".into(), Some("0.91".into())));
    assert_eq!(mean_std_ms(0.141_2, Some(0.023)), ("141".into(), Some("23".into())));
    assert_eq!(mean_std_ms(0.004_70, None), ("4.70".into(), None));
    assert_eq!(mean_std_ms(0.000_126, Some(0.000_012)), ("0.126".into(), Some("0.012".into())));
    assert_eq!(mean_std_ms(0.000_002_1, Some(0.000_000_4)), ("0.00210".into(), Some("0.00040".into())));
    assert_eq!(mean_std_ms(0.0, Some(0.0)), ("0.00".into(), Some("0.00".into())));
    assert_eq!(mean_std_ms(0.000_048_01, Some(0.000_000_9)), ("0.0480".into(), Some("0.0009".into())));
    assert_eq!(mean_std_ms(0.141_23, Some(0.000_05)), ("141.230".into(), Some("0.050".into())));
}

#[test]
fn bounded_values_have_digits_of_their_bound() {
    assert_eq!(bound_ms(0.000_65), "±0.65");
    assert_eq!(bound_ms(0.001_3), "±1.3");
    assert_eq!(bound_ms(0.013), "±13");
    assert_eq!((bound_ms(0.0).as_str(), bound(0.0).as_str()), ("exact", "exact"));
    assert_eq!(bound(0.000_65), "±0.65\u{202f}ms");
    assert_eq!(bound_ms(0.000_005_6), "±0.006");
    assert_eq!(bound_ms(0.000_000_1), "±<0.001");
    assert_eq!(interval_ms(0.000_394, 0.000_405), "0.394 – 0.405");
    assert_eq!(offset_ms(1.204_184, 0.000_65), "+1,204.18");
    assert_eq!(offset_ms(-1.002_697_6, 0.000_005), "\u{2212}1,002.698");
    assert_eq!(offset_ms(0.0, 0.0), "0.00");
    assert_eq!(interval_ms(0.005_66, 0.006_93), "5.66 – 6.93");
}

#[test]
fn interval_with_negative_end_is_joined_by_to() {
    assert_eq!(interval_ms(-1.201_538, -1.201_350), "\u{2212}1,201.538 to \u{2212}1,201.350");
    assert_eq!(shift_ms(-0.000_006, 0.000_004), "\u{2212}0.006 to +0.004");
    // The lower end is rounded to zero.
    assert_eq!(interval_ms(-0.000_2, 0.25), "0 – 250");
}

#[test]
fn digits_are_limited_by_interval_width() {
    assert_eq!(offset_ms(0.250, 0.125), "+250");
    assert_eq!(interval_ms(0.250, 0.290), "250 – 290");
    assert_eq!(within_ms(0.000_043_2, (0.000_039, 0.000_048)), "0.043");
    assert_eq!(within_ms(0.000_061_2, (0.000_061_2, 0.000_061_2)), "0.0612");
    assert_eq!(within_ms(0.041_2, (0.021, 0.061)), "41");
    assert_eq!(ends_ms(0.000_039, 0.000_048), ["0.039", "0.048"]);
}

#[test]
fn shares_rates_and_sizes_are_formatted_with_three_digits() {
    assert_eq!(
        ["0", "<0.01", "0.02", "1.3", "14"],
        [0.0, 1e-6, 0.000_2, 0.013, 0.14].map(percent).each_ref().map(String::as_str)
    );
    assert_eq!(rate(30.0), "30.0");
    assert_eq!(rate(5.0), "5.00");
    assert_eq!(rate(0.0137), "0.0137");
    assert_eq!(rate(12_345.6), "12,346");
    assert_eq!(
        [0.0, 0.00625, 0.69, 106.3].map(|megabytes| throughput(megabytes * 8e6)),
        ["0", "0.00625", "0.690", "106"]
    );
    assert_eq!(bytes(412.0).to_string(), "412\u{202f}B");
    assert_eq!(bytes(150_600.0).to_string(), "151\u{202f}kB");
    assert_eq!(bytes(1_228_800.0).to_string(), "1.23\u{202f}MB");
    assert_eq!(bytes(999_600.0).to_string(), "1\u{202f}MB");
    assert_eq!(bytes(5e17).to_string(), "500,000\u{202f}TB");
    assert_eq!(gigabytes(5_200_000_000), "5.2");
    assert_eq!(times(1.87), "1.9\u{202f}×");
    assert_eq!(count(17_640), "17,640");
    assert_eq!(count(u64::MAX), "18,446,744,073,709,551,615");
}

#[test]
fn durations_are_formatted_in_two_units() {
    assert_eq!(long_duration(0.42), "0.4\u{202f}s");
    assert_eq!(long_duration(35.2), "35\u{202f}s");
    assert_eq!(long_duration(252.0), "4\u{202f}min 12\u{202f}s");
    assert_eq!(long_duration(600.0), "10\u{202f}min");
    assert_eq!(long_duration(7_500.0), "2\u{202f}h 5\u{202f}min");
    assert_eq!(long_duration(273_600.0), "3\u{202f}d 4\u{202f}h");
    assert_eq!(long_duration(-1.0), NONE);
}

#[test]
fn numbers_that_are_not_finite_are_shown_as_dash() {
    assert_eq!(fixed(f64::NAN, 2), NONE);
    assert_eq!(DurationFormat::default().duration(f64::INFINITY), NONE);
}

proptest! {
    #[test]
    fn shown_figure_equals_rounded_measurement(value in -1e12f64..1e12, decimals in 0usize..4) {
        let text = fixed(value, decimals);
        let back: f64 = text.replace(',', "").replace('\u{2212}', "-").parse().expect("a number again");
        prop_assert!((back - value).abs() <= 0.51 * 10f64.powi(-(decimals as i32)) + value.abs() * 1e-12);
        prop_assert!(!text.contains("-"));
    }

    #[test]
    fn figures_below_thousand_have_three_digits_at_most(value in 0f64..999.0) {
        prop_assert!(figure(value).chars().filter(char::is_ascii_digit).count() <= 3);
    }
}

#[test]
fn estimated_durations_are_rounded_to_coarse_units() {
    for (seconds, text) in
        [(3.0, "10 s"), (51.0, "1 min"), (277.0, "5 min"), (3_541.0, "1 h"), (11_520.0, "3 h 20 min")]
    {
        // A narrow space joins a number and its unit. An ordinary space separates hours from minutes.
        assert_eq!(
            estimated_duration(seconds),
            text.replace(' ', SPACE).replace(&format!("h{SPACE}"), "h "),
            "{seconds}"
        );
    }
    assert_eq!(estimated_duration(f64::INFINITY), NONE);
}

#[test]
fn value_ends_at_second_digit_of_margin() {
    assert_eq!(mean_std(61.23e-6, Some(4.21e-6)), "0.0612 ± 0.0042");
    assert_eq!(mean_std(-2.0142e-3, Some(0.11e-3)), "\u{2212}2.01 ± 0.11");
    assert_eq!(mean_std(6.31e-3, Some(0.0)), "6.31 ± 0.00");
    assert_eq!(
        (mean_std(6.31e-3, Some(f64::INFINITY)), mean_std(6.31e-3, None)),
        ("6.31".into(), "6.31".into())
    );
    assert_eq!(throughput_with_margin(8e6 * 943.4, 8e6 * 13.6), "943 ± 14");
    assert_eq!(throughput_with_margin(8e6 * 1.234, 8e6 * 0.056), "1.234 ± 0.056");
    assert_eq!(error_ms(61.2e-6), "0.061");
}

#[test]
fn interval_without_width_keeps_digits_of_value() {
    assert_eq!([30.2e-6, 61.2e-6].map(|ms| interval_ms(ms, ms)), ["0.0302", "0.0612"]);
    // An interval that follows from clocks has no digit below a microsecond. An interval of measured values may have a
    // fourth decimal.
    assert_eq!(
        (interval_ms(30.21e-6, 30.24e-6), range_ms((30.21e-6, 30.24e-6))),
        ("0.030".into(), "0.0302".into())
    );
    assert_eq!(
        (range_ms((30.2e-6, 30.2e-6)), range_ms((0.0, 123.4e-6))),
        ("0.0302".into(), "0.000 – 0.123".into())
    );
    assert_eq!(range_ms((-1.201_538, -1.201_350)), "\u{2212}1,201.538 to \u{2212}1,201.350");
    assert_eq!(throughput_between((8e6 * 3752.4, Some(8e6 * 3752.4))), "3,752");
    assert_eq!(throughput_between((8e6 * 930.3, Some(8e6 * 957.1))), "930 – 957");
    assert_eq!(throughput_between((8e6 * 0.0061, Some(8e6 * 0.0064))), "0.00610 – 0.00640");
    assert_eq!([None, Some(f64::INFINITY)].map(|hi| throughput_between((8e6, hi))), ["≥ 1.00", "≥ 1.00"]);
}

#[test]
fn sizes_end_without_zeros() {
    let sizes = [100.0, 1_000.0, 1.2e6, 4e6, 26_207.0].map(|size| bytes(size).plain());
    assert_eq!(sizes, ["100 B", "1 kB", "1.2 MB", "4 MB", "26.2 kB"]);
}

#[test]
fn tiny_numbers_have_their_power_of_ten() {
    // A number has at most 17 decimals.
    let texts = [-1.23456e-300, 0.0, 1.0].map(|value| fixed(value, 302));
    assert_eq!(texts, ["\u{2212}1.235e-300", "0.00000000000000000", "1.00000000000000000"]);
    assert_eq!(milliseconds(-1e300), "\u{2212}1.000e303");
}

#[test]
fn column_figures_have_two_or_three_decimals() {
    let decimals =
        [None, Some(0.0), Some(60e-6), Some(0.65e-3), Some(15e-3)].map(|error| column_decimals([error]));
    assert_eq!(decimals, [2, 3, 3, 2, 2]);
    assert_eq!(column_decimals([Some(15e-3), Some(60e-6)]), 3);
    let bounds = [0.0, 0.1e-6, 6e-6, 60e-6, 0.65e-3, 15e-3].map(bound_ms);
    assert_eq!(bounds, ["exact", "±<0.001", "±0.006", "±0.060", "±0.65", "±15"]);
}

#[test]
fn interval_with_signs_is_joined_by_word() {
    let text = |lo: &str, hi: &str| join_ends([lo, hi].map(str::to_owned));
    assert_eq!(text("3.13", "3.13"), "3.13");
    assert_eq!(text("3.13", "3.14"), "3.13 – 3.14");
    assert_eq!(text("+3.13", "+3.14"), "+3.13 to +3.14");
}
