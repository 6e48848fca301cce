//! The name of the socket through which a cloud proves to an edge that the two hosts read one clock.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Name of an abstract Unix socket: `peernet-clock-` and 32 hexadecimal digits.
///
/// Other names are not accepted, so that a peer cannot make the cloud connect to a socket of another program.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ClockSocketName([u8; Self::BYTES]);

/// Error: the text is not the name of a clock socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not the name of a clock socket, which is {PREFIX} followed by 32 hexadecimal digits in lower case")]
pub struct InvalidClockSocketName;

const PREFIX: &str = "peernet-clock-";

impl ClockSocketName {
    /// Number of random bytes in the name.
    pub const BYTES: usize = 16;

    /// Returns the name with these random bytes as its digits.
    #[must_use]
    pub const fn new(bytes: [u8; Self::BYTES]) -> Self {
        Self(bytes)
    }
}

impl fmt::Display for ClockSocketName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{PREFIX}{:032x}", u128::from_be_bytes(self.0))
    }
}

/// Hides the digits: whoever has them can connect to the socket.
impl fmt::Debug for ClockSocketName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ClockSocketName(hidden)")
    }
}

impl FromStr for ClockSocketName {
    type Err = InvalidClockSocketName;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let digits = text.strip_prefix(PREFIX).ok_or(InvalidClockSocketName)?;
        // `from_str_radix` alone would also accept a sign and capital letters.
        let is_valid = digits.len() == 2 * Self::BYTES
            && digits.bytes().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f'));
        let number = u128::from_str_radix(digits, 16).map_err(|_| InvalidClockSocketName)?;
        if is_valid { Ok(Self(number.to_be_bytes())) } else { Err(InvalidClockSocketName) }
    }
}

impl Serialize for ClockSocketName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Deserializes a peer's optional name. A text of another form becomes `None`, so that the cloud connects to no other
/// socket.
pub(super) fn deserialize_optional_socket_name<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<ClockSocketName>, D::Error> {
    let text: Option<String> = Option::deserialize(deserializer)?;
    Ok(text.and_then(|text| text.parse().ok()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn name_is_prefix_and_32_digits() {
        let valid_name = "peernet-clock-000102030405060708090a0b0c0d0e0f";
        assert_eq!(
            valid_name.parse::<ClockSocketName>().map(|name| name.to_string()).as_deref(),
            Ok(valid_name)
        );
        let invalid_names = [
            "",
            "peernet-clock-",
            "peernet-clock-000102030405060708090a0b0c0d0e0",
            "peernet-clock-000102030405060708090a0b0c0d0e0f0",
            "peernet-clock-000102030405060708090A0B0C0D0E0F",
            "peernet-clock-+00102030405060708090a0b0c0d0e0f",
            "peernet-clock-000102030405060708090a0b0c0d0e0\0",
            "peernet-clock-/run/docker.sock",
            "peernet-probe-000102030405060708090a0b0c0d0e0f",
            "\0peernet-clock-000102030405060708090a0b0c0d0e0f",
            "/run/systemd/notify",
        ];
        for text in invalid_names {
            assert_eq!(text.parse::<ClockSocketName>(), Err(InvalidClockSocketName), "{text:?}");
        }
        assert!("x".repeat(60_000).parse::<ClockSocketName>().is_err());
    }

    proptest! {
        #[test]
        fn name_parses_from_its_text(bytes: [u8; ClockSocketName::BYTES]) {
            let name = ClockSocketName::new(bytes);
            prop_assert_eq!(name.to_string().parse(), Ok(name));
        }

        #[test]
        fn parsed_names_have_canonical_form(text in "(peernet-clock-)?[0-9a-fA-F/+]{28,34}") {
            if let Ok(name) = text.parse::<ClockSocketName>() {
                prop_assert_eq!(name.to_string(), text);
            }
        }
    }
}
