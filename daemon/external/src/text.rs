//! Texts of users' code, which end up on terminals and in logs.

use peernet_sample::printable_lines;
use serde::{Deserialize, Deserializer};

/// Reads a text as [`printable_lines`].
pub(crate) fn words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    String::deserialize(deserializer).map(|text| printable_lines(&text).into_owned())
}
