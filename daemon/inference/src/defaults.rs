//! Values of keys that models of several kinds have.

use std::num::NonZeroUsize;

pub(crate) fn cpu() -> String {
    "cpu".to_owned()
}

pub(crate) const fn one() -> NonZeroUsize {
    NonZeroUsize::MIN
}

pub(crate) const fn sixteen() -> NonZeroUsize {
    NonZeroUsize::MIN.saturating_add(15)
}
