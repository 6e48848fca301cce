//! Wire form of stamps: the two 64-bit formats, and the Error Estimate that says which format is used.

use peernet_clock::{Span, WallTime};

/// Seconds from 1900, where NTP's first era begins, to 1970 (RFC 5905, figure 4).
const NTP_TO_UNIX: i64 = 2_208_988_800;

const NANOS: i64 = 1_000_000_000;

/// Format of a stamp in a packet.
///
/// Probes are sent in NTP's format, which all implementations know. Its steps of 2⁻³² s = 0.23 ns are finer than the
/// nanoseconds of our clocks, so decoding returns exactly the stamp that was encoded. A reflector answers in the format
/// of the request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Seconds and 2⁻³² s since 1900, modulo 2³² s (RFC 5905, section 6).
    #[default]
    Ntp,
    /// Seconds and nanoseconds since 1970, modulo 2³² s (RFC 8186, section 2.3: PTPv2, truncated).
    Ptp,
}

impl Format {
    /// Encodes a time, rounded to the nearest step.
    pub fn encode(self, time: WallTime) -> u64 {
        let seconds = time.unix_seconds();
        let nanos = time.unix_nanos().rem_euclid(NANOS).unsigned_abs();
        let (seconds, fraction) = match self {
            Self::Ntp => {
                (seconds + NTP_TO_UNIX, ((nanos << 32) + NANOS.unsigned_abs() / 2) / NANOS.unsigned_abs())
            }
            Self::Ptp => (seconds, nanos),
        };
        ((seconds & 0xFFFF_FFFF).unsigned_abs() << 32) | fraction
    }

    /// Decodes a stamp. The era is chosen so that the result is nearest to `near`, within 68 years: NTP's first era
    /// ends in 2036, PTP's in 2106. `None` if the bits are not a valid time.
    pub fn decode(self, bits: u64, near: WallTime) -> Option<WallTime> {
        let fraction = (bits & 0xFFFF_FFFF) as i64;
        let (origin, nanos) = match self {
            Self::Ntp => (NTP_TO_UNIX, (fraction * NANOS + (1 << 31)) >> 32),
            Self::Ptp if fraction < NANOS => (0, fraction),
            Self::Ptp => return None,
        };
        let near = near.unix_seconds();
        // The difference modulo 2³², read as a signed number, leads to the nearest time with these bits, before or
        // after `near`.
        let distance = ((bits >> 32) as u32).wrapping_sub((near + origin) as u32).cast_signed();
        let seconds = near + i64::from(distance);
        Some(WallTime::from_unix_nanos(seconds.saturating_mul(NANOS).saturating_add(nanos)))
    }
}

/// Error and format of stamps (RFC 4656, section 4.1.2; RFC 8186, section 2.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorEstimate(u16);

impl ErrorEstimate {
    const SYNCHRONISED: u16 = 1 << 15;
    const PTP: u16 = 1 << 14;

    /// Returns the smallest estimate of two bytes that is at least `error`. The S bit is 0: the estimate does not claim
    /// that the clock follows UTC. It states the error of stamps relative to their own clock.
    pub fn new(format: Format, error: Span) -> Self {
        // The unit is 2⁻³² s; the multiplier has 8 bits and must not be zero.
        let units = (u128::from(error.nanos().max(0).unsigned_abs()) << 32).div_ceil(1_000_000_000);
        let scale = (0..63).find(|scale| units.div_ceil(1 << scale) <= 255).unwrap_or(63);
        let multiplier = units.div_ceil(1 << scale).clamp(1, 255) as u16;
        let format = if format == Format::Ptp { Self::PTP } else { 0 };
        Self(format | scale << 8 | multiplier)
    }

    /// Returns the wire form.
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Creates the estimate from its wire form.
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Returns the format of the packet's stamps.
    pub const fn format(self) -> Format {
        if self.0 & Self::PTP == 0 { Format::Ntp } else { Format::Ptp }
    }

    /// Returns whether the sender claims that its clock follows UTC.
    pub const fn is_synchronised(self) -> bool {
        self.0 & Self::SYNCHRONISED != 0
    }

    /// Returns the claimed error: multiplier × 2⁻³² × 2^scale seconds.
    pub fn error(self) -> Span {
        let (scale, multiplier) = ((self.0 >> 8) & 0x3F, self.0 & 0xFF);
        Span::from_seconds_f64(f64::from(multiplier) * f64::from(i32::from(scale) - 32).exp2())
    }
}
