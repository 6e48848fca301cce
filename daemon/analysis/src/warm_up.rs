//! Periods of warm-up and beginnings of episodes in charts of a run.

/// Maximum number of beginnings of episodes that a chart shows. More would cover everything else, so none is drawn.
pub const MAX_EPISODE_BORDERS: u32 = 30;

/// Returns the periods of consecutive iterations of warm-up, each with its beginning and end. An iteration is given by its position, such as its
/// start, and whether it is warm-up; the iterations are in their order. A period ends at the next iteration that is not warm-up, or at the
/// last iteration. Iterations within a period, and between periods, may be left out.
pub fn warm_up_periods<T: Copy>(iterations: impl IntoIterator<Item = (T, bool)>) -> Vec<(T, T)> {
    let mut periods = Vec::new();
    let (mut start, mut last) = (None, None);
    for (at, is_warm_up) in iterations {
        match (is_warm_up, start) {
            (true, None) => start = Some(at),
            (false, Some(from)) => {
                periods.push((from, at));
                start = None;
            }
            _ => {}
        }
        last = Some(at);
    }
    periods.extend(start.zip(last));
    periods
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn period_ends_at_next_measured_or_last_iteration() {
        let periods = |warm_up: &str| warm_up_periods(warm_up.chars().map(|it| it == 'w').enumerate());
        assert_eq!(periods("wwm.mwm.www"), [(0, 2), (5, 6), (8, 10)]);
        assert_eq!(periods("mm"), []);
        assert_eq!(periods("ww"), [(0, 1)]);
        assert_eq!(periods(""), []);
    }
}
