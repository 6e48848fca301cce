//! Packed form of a sketch: LEB128 numbers for the count of zeros, the negative bins and the positive bins.
//!
//! A list of bins begins with the number of bins. Each bin is a key and a count. The first key may be negative and has
//! the zigzag form. Each further key is encoded as its distance from the key before it.

use super::Sketch;
use super::bins::{Bins, MAX_BINS_PER_SIGN, VALID_KEYS};

/// Reason why bytes are not a valid sketch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PackedError {
    /// The bytes end too early, or a number is longer than 64 bits.
    #[error("the sketch is truncated or damaged at byte {0}")]
    Damaged(usize),
    /// The sketch has more bins than permitted.
    #[error("the sketch has {0} bins, the limit is {max}", max = MAX_BINS_PER_SIGN)]
    TooManyBins(u64),
    /// A bin is outside of the range of finite numbers, occurs twice, is empty, or is so far above the first bin that
    /// the sketch would have too many bins.
    #[error("the sketch has an invalid bin")]
    InvalidBin,
    /// The counts add up to more than 2⁵³. Sums of such counts could overflow.
    #[error("the counts of the sketch add up to more than the limit")]
    Overflow,
    /// Bytes follow the sketch.
    #[error("{0} bytes follow the sketch")]
    Trailing(usize),
}

pub(super) fn pack(sketch: &Sketch) -> Vec<u8> {
    let mut out = Vec::with_capacity(64);
    put(&mut out, sketch.zero);
    put_bins(&mut out, &sketch.negative);
    put_bins(&mut out, &sketch.positive);
    out
}

pub(super) fn unpack(bytes: &[u8]) -> Result<Sketch, PackedError> {
    let mut reader = Reader { bytes, position: 0 };
    let zero = reader.take()?;
    let negative = reader.take_bins()?;
    let positive = reader.take_bins()?;
    if reader.position < bytes.len() {
        return Err(PackedError::Trailing(bytes.len() - reader.position));
    }
    if zero.saturating_add(negative.count()).saturating_add(positive.count()) > crate::MAX_COUNT {
        return Err(PackedError::Overflow);
    }
    Ok(Sketch { positive, negative, zero })
}

/// Appends a number in LEB128.
fn put(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

fn put_bins(out: &mut Vec<u8>, bins: &Bins) {
    put(out, bins.iter().count() as u64);
    let mut previous_key = None;
    for (key, count) in bins.iter() {
        match previous_key {
            None => put(out, u64::from(((key << 1) ^ (key >> 31)).cast_unsigned())),
            Some(previous_key) => put(out, u64::from(key.abs_diff(previous_key))),
        }
        put(out, count);
        previous_key = Some(key);
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    /// Index of the next byte.
    position: usize,
}

impl Reader<'_> {
    /// Reads a number in LEB128.
    fn take(&mut self) -> Result<u64, PackedError> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.position).ok_or(PackedError::Damaged(self.position))?;
            self.position += 1;
            let bits = u64::from(byte & 0x7f);
            // Nine bytes have 63 of the 64 bits, so the tenth byte has only one.
            if shift == 63 && bits > 1 {
                break;
            }
            number |= bits << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(PackedError::Damaged(self.position))
    }

    fn take_bins(&mut self) -> Result<Bins, PackedError> {
        let length = self.take()?;
        if length > MAX_BINS_PER_SIGN as u64 {
            return Err(PackedError::TooManyBins(length));
        }
        let mut bins = Bins::default();
        let mut first = None;
        let mut key = 0_i64;
        for _ in 0..length {
            let number = i64::try_from(self.take()?).map_err(|_| PackedError::InvalidBin)?;
            key = match first {
                None => (number >> 1) ^ -(number & 1),
                Some(_) if number == 0 => return Err(PackedError::InvalidBin),
                Some(_) => key.checked_add(number).ok_or(PackedError::InvalidBin)?,
            };
            let first = *first.get_or_insert(key);
            let valid_key = i32::try_from(key).ok().filter(|key| VALID_KEYS.contains(key));
            // With more bins, the lowest bins would be merged, and the sketch would not equal its packed form.
            let valid_key = valid_key
                .filter(|_| key - first < MAX_BINS_PER_SIGN as i64)
                .ok_or(PackedError::InvalidBin)?;
            let count = self.take()?;
            if count == 0 {
                return Err(PackedError::InvalidBin);
            }
            bins.count().checked_add(count).ok_or(PackedError::Overflow)?;
            bins.add(valid_key, count);
        }
        Ok(bins)
    }
}
