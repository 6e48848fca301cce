//! Texts from custom code, which are shown on terminals and in logs.

use peernet_sample::printable_lines;
use serde::{Deserialize, Deserializer};

/// Reads a text and makes it printable ([`printable_lines`]).
pub(crate) fn deserialize_printable<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    String::deserialize(deserializer).map(|text| printable_lines(&text).into_owned())
}
