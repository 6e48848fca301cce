//! Periods of warm-up and beginnings of episodes in charts of a run.

/// Maximum number of beginnings of episodes that a chart shows. If there are more, none is drawn, because they would
/// cover everything else.
pub const MAX_EPISODE_BORDERS: u32 = 30;

/// Returns the beginning and end of each period of consecutive warm-up iterations. `iterations` has, in order, the
/// position of each iteration, such as its start, and whether the iteration is warm-up. A period ends at the next
/// iteration that is not warm-up, or at the last iteration. The caller may leave out iterations within a period and
/// iterations between periods.
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
    fn warm_up_period_ends_at_next_measured_or_last_iteration() {
        let periods = |warm_up: &str| warm_up_periods(warm_up.chars().map(|it| it == 'w').enumerate());
        assert_eq!(periods("wwm.mwm.www"), [(0, 2), (5, 6), (8, 10)]);
        assert_eq!(periods("mm"), []);
        assert_eq!(periods("ww"), [(0, 1)]);
        assert_eq!(periods(""), []);
    }
}
