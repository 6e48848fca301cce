use proptest::prelude::*;

use super::*;

#[test]
fn what_rounds_to_a_power_of_ten_has_three_digits_too() {
    let shown = [0.099_99, 0.009_996, 0.999_6, 0.099_94].map(|value| listed_ms(value / 1e3));
    assert_eq!(shown, ["0.100", "0.0100", "1.00", "0.0999"]);
}

#[test]
fn durations_have_three_significant_digits_or_two_decimals() {
    let cases = [
        (0.0, "0.00\u{202f}ms"),
        (0.000_018_3, "0.0183\u{202f}ms"),
        (0.000_099_96, "0.10\u{202f}ms"),
        (0.000_62, "0.62\u{202f}ms"),
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
}

#[test]
fn a_table_keeps_its_decimals_and_tells_small_from_zero() {
    assert_eq!(stage_ms(0.004_70), "4.70");
    assert_eq!(stage_ms(0.033_46), "33.46");
    assert_eq!(stage_ms(1.204_18), "1,204.18");
    assert_eq!(stage_ms(0.0), "0");
    assert_eq!(stage_ms(0.000_004), "<0.01");
    assert_eq!(stage_ms(0.000_006), "0.01");
    assert_eq!(total_ms(0.018_94), "18.9");
    assert_eq!(total_ms(0.000_04), "<0.1");
}

#[test]
fn differences_carry_their_sign_and_zero_has_none() {
    assert_eq!(difference_ms(0.000_03), "+0.03");
    assert_eq!(difference_ms(-0.000_02), "\u{2212}0.02");
    assert_eq!(difference_ms(0.000_002), "0.00");
    assert_eq!(difference_ms(-0.000_002), "0.00");
    assert_eq!(difference_ms(-1.204_18), "\u{2212}1,204.18");
}

#[test]
fn a_value_has_no_more_digits_than_its_deviation_supports() {
    assert_eq!(mean_std_ms(0.016_22, Some(0.001_1)), ("16.2".into(), Some("1.1".into())));
    assert_eq!(mean_std_ms(0.006_34, Some(0.000_91)), ("6.34".into(), Some("0.91".into())));
    assert_eq!(mean_std_ms(0.141_2, Some(0.023)), ("141".into(), Some("23".into())));
    assert_eq!(mean_std_ms(0.004_70, None), ("4.70".into(), None));
    assert_eq!(mean_std_ms(0.000_126, Some(0.000_012)), ("0.126".into(), Some("0.012".into())));
    assert_eq!(mean_std_ms(0.000_002_1, Some(0.000_000_4)), ("0.00210".into(), Some("0.00040".into())));
    assert_eq!(mean_std_ms(0.0, Some(0.0)), ("0.00".into(), Some("0.00".into())));
    assert_eq!(
        [0.000_126, 0.006_31, 0.016_1, 0.141_2, 1.242_7].map(listed_ms),
        ["0.126", "6.31", "16.1", "141", "1,243"]
    );
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
    assert_eq!((trip_ms(0.001_3).as_str(), trip_ms(0.000_018).as_str()), ("1.30", "0.018"));
    assert_eq!(interval_ms(0.005_66, 0.006_93), "5.66 – 6.93");
}

#[test]
fn digits_follow_the_bound_and_negative_ends_are_parted_by_a_word() {
    assert_eq!(offset_ms(0.250, 0.125), "+250");
    assert_eq!(interval_ms(0.250, 0.290), "250 – 290");
    assert_eq!(interval_ms(-1.201_538, -1.201_350), "\u{2212}1,201.538 to \u{2212}1,201.350");
    assert_eq!(interval_ms(-0.000_2, 0.25), "0 – 250");
    assert_eq!(within_ms(0.000_043_2, (0.000_039, 0.000_048)), "0.043");
    assert_eq!(within_ms(0.000_061_2, (0.000_061_2, 0.000_061_2)), "0.061");
    assert_eq!(within_ms(0.041_2, (0.021, 0.061)), "41");
    assert_eq!(shift_ms(-0.000_006, 0.000_004), "\u{2212}0.006 to +0.004");
    assert_eq!(ends_ms(0.000_039, 0.000_048), ["0.039", "0.048"]);
}

#[test]
fn shares_rates_and_sizes() {
    assert_eq!(
        ["0", "<0.01", "0.02", "1.3", "14"],
        [0.0, 1e-6, 0.000_2, 0.013, 0.14].map(percent).each_ref().map(String::as_str)
    );
    assert_eq!(rate(30.0), "30.0");
    assert_eq!(rate(5.0), "5.00");
    assert_eq!(rate(12_345.6), "12,346");
    assert_eq!(throughput(106.3 * 8e6), "106.3");
    assert_eq!(throughput(0.69 * 8e6), "0.69");
    assert_eq!(bytes(412.0).to_string(), "412\u{202f}B");
    assert_eq!(bytes(150_600.0).to_string(), "151\u{202f}kB");
    assert_eq!(bytes(1_228_800.0).to_string(), "1.23\u{202f}MB");
    assert_eq!(bytes(999_600.0).to_string(), "1.00\u{202f}MB");
    assert_eq!(bytes(5e17).to_string(), "500,000\u{202f}TB");
    assert_eq!(gigabytes(5_200_000_000), "5.2");
    assert_eq!(times(1.87), "1.9\u{202f}×");
    assert_eq!(count(17_640), "17,640");
    assert_eq!(count(u64::MAX), "18,446,744,073,709,551,615");
}

#[test]
fn lengths_in_words() {
    assert_eq!(length(0.42), "0.4\u{202f}s");
    assert_eq!(length(35.2), "35\u{202f}s");
    assert_eq!(length(252.0), "4\u{202f}min 12\u{202f}s");
    assert_eq!(length(600.0), "10\u{202f}min");
    assert_eq!(length(7_500.0), "2\u{202f}h 5\u{202f}min");
    assert_eq!(length(273_600.0), "3\u{202f}d 4\u{202f}h");
    assert_eq!(length(-1.0), NONE);
}

#[test]
fn what_is_not_a_number_is_a_dash() {
    assert_eq!(fixed(f64::NAN, 2), NONE);
    assert_eq!(stage_ms(f64::INFINITY), NONE);
}

proptest! {
    #[test]
    fn what_is_shown_is_what_was_measured(value in -1e12f64..1e12, decimals in 0usize..4) {
        let text = fixed(value, decimals);
        let back: f64 = text.replace(',', "").replace('\u{2212}', "-").parse().expect("a number again");
        prop_assert!((back - value).abs() <= 0.51 * 10f64.powi(-(decimals as i32)) + value.abs() * 1e-12);
        prop_assert!(!text.contains("-"));
    }

    #[test]
    fn any_figure_has_at_most_three_digits_below_a_thousand(value in 0f64..999.0) {
        prop_assert!(figure(value).chars().filter(char::is_ascii_digit).count() <= 3);
    }
}

#[test]
fn estimates_claim_no_more_than_they_know() {
    for (seconds, text) in
        [(3.0, "10 s"), (51.0, "1 min"), (277.0, "5 min"), (3_541.0, "1 h"), (11_520.0, "3 h 20 min")]
    {
        assert_eq!(
            roughly(seconds),
            text.replace(' ', SPACE).replace(&format!("h{SPACE}"), "h "),
            "{seconds}"
        );
    }
    assert_eq!(roughly(f64::INFINITY), NONE);
}
