//! Defaults of configuration keys that several model kinds share.

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
