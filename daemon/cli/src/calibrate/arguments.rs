//! Arguments of `peernet calibrate`.

use std::num::{NonZeroU64, ParseFloatError, ParseIntError};
use std::path::PathBuf;

use anyhow::Context;
use peernet_networks::{Address, NetworkKind};

use crate::address::{AddressError, DEFAULT_PORT, address};
use crate::network::parse_network_kind;
use crate::seconds::{SecondsError, seconds};

/// Minimum value of `--seconds`.
const MIN_SECONDS: f64 = 1.0;

/// Arguments of `peernet calibrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Address of the agent at the other end of the link: tcp://host:5551, or only the host. The configuration of this
    /// agent needs a table [serve].
    #[arg(value_parser = peer)]
    pub(super) peer: String,
    /// At least three payload sizes, such as 100,1kB,1.2MB.
    #[arg(
        long,
        value_delimiter = ',',
        value_parser = size,
        default_value = "100,260,690,1.8kB,4.7kB,12kB,32kB,85kB,220kB,580kB,1.5MB,4MB"
    )]
    pub(super) sizes: Vec<u64>,
    /// Number of messages of each size.
    #[arg(long, default_value = "400", value_parser = repeats)]
    pub(super) repeats: NonZeroU64,
    /// Maximum duration in seconds. The study stops then, even if messages remain.
    #[arg(long, default_value = "120", value_parser = duration)]
    pub(super) seconds: f64,
    /// Number of warm-up messages of each size. They are written to the results, but excluded from the study.
    #[arg(long, default_value = "2")]
    pub(super) warm_up: u64,
    /// Folder for the results [default: calibration-PEER-DATE].
    #[arg(long, value_name = "DIR")]
    pub(super) result_loc: Option<PathBuf>,
    /// Write into a folder that is not empty.
    #[arg(long)]
    pub(super) overwrite: bool,
    /// An agent's configuration whose tables [clock], [probes] and [clock_fault] also apply here.
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Kind of network: zmq-tcp, zmq-udp or ros [default: the kind in the address; zmq-tcp if the address is only a
    /// host].
    #[arg(long, value_parser = parse_network_kind)]
    pub(super) network: Option<NetworkKind>,
    /// Do not show the progress.
    #[arg(long, short)]
    pub(super) quiet: bool,
}

/// Checks that the text is an address or a host. The default network is enough for this check, although `--network` may
/// name another network for a host.
fn peer(text: &str) -> Result<String, AddressError> {
    address(text, DEFAULT_PORT, NetworkKind::default()).map(|_| text.to_owned())
}

impl Arguments {
    /// Returns the peer's address on the named network.
    ///
    /// # Errors
    /// When the address belongs to another network.
    pub(super) fn peer_address(&self) -> anyhow::Result<Address> {
        let peer = address(&self.peer, DEFAULT_PORT, self.network.unwrap_or_default())?;
        peer.check_network(self.network).context("--network")?;
        Ok(peer)
    }
}

/// Reason why a text is not a number of repeats.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum RepeatsError {
    #[error("not a whole number")]
    NotANumber(#[from] ParseIntError),
    #[error("must be at least 1")]
    Zero,
}

fn repeats(text: &str) -> Result<NonZeroU64, RepeatsError> {
    NonZeroU64::new(text.parse::<u64>()?).ok_or(RepeatsError::Zero)
}

/// Reason why a text is not the size of a payload.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum SizeError {
    #[error("{0:?} is not a unit; write B, kB, MB, GB, KiB, MiB or GiB")]
    Unit(String),
    #[error("{digits:?} is not a number")]
    NotANumber { digits: String, source: ParseFloatError },
    #[error("must be from 1 B to 1 GB")]
    OutOfRange,
}

/// Reads a size in bytes: a number and optionally one of the usual units, in upper or lower case.
fn size(text: &str) -> Result<u64, SizeError> {
    let text = text.trim();
    let digits = text.trim_end_matches(|char: char| char.is_ascii_alphabetic() || char == ' ');
    let unit = text[digits.len()..].trim();
    let unit_bytes = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "ki" | "kib" => 1024.0,
        "mi" | "mib" => 1024.0 * 1024.0,
        "gi" | "gib" => 1024.0 * 1024.0 * 1024.0,
        _ => return Err(SizeError::Unit(unit.to_owned())),
    };
    let number = digits.parse::<f64>();
    let number = number.map_err(|source| SizeError::NotANumber { digits: digits.to_owned(), source })?;
    let bytes = (number * unit_bytes).round();
    if (1.0..=1e9).contains(&bytes) { Ok(bytes as u64) } else { Err(SizeError::OutOfRange) }
}

fn duration(text: &str) -> Result<f64, SecondsError> {
    seconds(text, MIN_SECONDS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_repeats_are_refused() {
        assert_eq!(repeats("0"), Err(RepeatsError::Zero));
        assert_eq!(repeats("-1").expect_err("it is negative").to_string(), "not a whole number");
        assert_eq!(repeats("12").map(NonZeroU64::get), Ok(12));
    }

    #[test]
    fn sizes_have_optional_unit_and_invalid_sizes_are_refused() {
        assert_eq!(
            ["100", "100B", "1kB", "1.2MB", " 4 MB"].map(size),
            [100, 100, 1_000, 1_200_000, 4_000_000].map(Ok)
        );
        assert_eq!(
            ["64 KiB", "1kiB", "1.5MiB", "1GB", "2mb", "3 K", "0.5GiB"].map(size),
            [65_536, 1_024, 1_572_864, 1_000_000_000, 2_000_000, 3_000, 536_870_912].map(Ok)
        );
        assert_eq!(size("1 GiB"), Err(SizeError::OutOfRange));
        for wrong in ["", "kB", "1 TB", "1 kBit", "0", "-3", "2e12", "1.2.3"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }
}
