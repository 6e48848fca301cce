//! Tests of the record's statements about two clocks.

use peernet_clock::{OneWayDelay, Span, Verdict};

use super::*;
use crate::rows::Row;
use crate::testing::{rows, to_rows};

fn assert_near(found: Option<BoundedEstimate>, expected: [f64; 3]) {
    let found = found.expect("is known");
    for (found, expected) in [found.value, found.lo, found.hi].into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
    }
}

#[test]
fn offset_and_skew_are_recovered_from_stamps() {
    let mut rows = rows(10);
    for row in &mut rows {
        row.at = 1000.0 + row.iteration as f64;
    }
    // Offsets are not taken from warm-up (rows 0 and 1), nor from a message whose delay is unknown (the upload of row 2).
    let change_upload = |row: &mut Row, change: fn(&mut OneWayDelay)| row.upload.as_mut().map(change);
    change_upload(&mut rows[0], |delay| delay.raw = Span::from_seconds(9)).expect("was sent");
    change_upload(&mut rows[2], |delay| delay.verdict = Verdict::Inconsistent).expect("was sent");
    change_upload(&mut rows[9], |delay| delay.raw += Span::from_micros(18)).expect("was sent");
    let clocks = Clocks::from_rows(&to_rows(&rows));
    assert_near(clocks.upload.first_offset, [0.005, 0.00499, 0.00501]);
    assert_near(clocks.upload.last_offset, [0.005_018, 0.005_008, 0.005_028]);
    // The offsets have an error of at most 10 µs each. The offset of uploads grows by 18 ± 20 µs in the 6 s from row 3
    // (the first row with an offset) to row 9. The offset of downloads grows by 0 ± 20 µs in the 7 s from row 2 to row 9.
    assert_near(clocks.upload.skew, [3e-6, -2e-6 / 6.0, 38e-6 / 6.0]);
    assert_near(clocks.download.skew, [0.0, -20e-6 / 7.0, 20e-6 / 7.0]);
    rows.iter_mut().for_each(|row| row.at = 0.0);
    assert_eq!(Clocks::from_rows(&to_rows(&rows)).upload.skew, None, "the times were not recorded");
}
