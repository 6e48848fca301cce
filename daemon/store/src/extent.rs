//! Ranges of whole numbers.

/// A range of whole numbers, including both ends; `first` is not above `last`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Extent {
    pub(crate) first: i64,
    pub(crate) last: i64,
}

impl Extent {
    /// Makes the range that contains one number.
    pub(crate) const fn single(number: i64) -> Self {
        Self { first: number, last: number }
    }

    /// Returns the smallest range that contains both ranges.
    pub(crate) fn hull(self, other: Self) -> Self {
        Self { first: self.first.min(other.first), last: self.last.max(other.last) }
    }

    /// Returns the numbers of this range that no range in `others` contains, as ranges in ascending order.
    pub(crate) fn without(self, mut others: Vec<Self>) -> Vec<Self> {
        others.sort_unstable_by_key(|other| other.first);
        let mut remaining = Vec::new();
        // First number that is not examined yet.
        let mut next = self.first;
        for Self { first, last } in others {
            if first > self.last {
                break;
            }
            if first > next {
                remaining.push(Self { first: next, last: first - 1 });
            }
            if last >= self.last {
                return remaining;
            }
            next = next.max(last + 1);
        }
        remaining.push(Self { first: next, last: self.last });
        remaining
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn without_keeps_numbers_that_no_other_contains(
            (first, length) in (-10i64..30, 0i64..30),
            others in prop::collection::vec((-20i64..50, 0i64..20), 0..6),
        ) {
            let range = |(first, length)| Extent { first, last: first + length };
            let (whole, others) = (range((first, length)), others.into_iter().map(range).collect::<Vec<_>>());
            let contains = |extent: &Extent, number: i64| (extent.first..=extent.last).contains(&number);
            let remaining = whole.without(others.clone());
            for number in -40..80 {
                let expected = contains(&whole, number) && !others.iter().any(|other| contains(other, number));
                prop_assert_eq!(remaining.iter().any(|part| contains(part, number)), expected);
            }
            prop_assert!(remaining.iter().all(|part| part.first <= part.last));
            prop_assert!(remaining.windows(2).all(|pair| pair[0].last < pair[1].first));
        }
    }

    #[test]
    fn ends_of_the_whole_range_do_not_overflow() {
        let all = Extent { first: i64::MIN, last: i64::MAX };
        assert_eq!(all.without(vec![all]), []);
        let parts = all.without(vec![Extent::single(i64::MIN), Extent::single(3), Extent::single(i64::MAX)]);
        let expected = [(i64::MIN + 1, 2), (4, i64::MAX - 1)].map(|(first, last)| Extent { first, last });
        assert_eq!(parts, expected);
    }
}
