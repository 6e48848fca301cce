//! Limits of the size of a picture.

/// The most pixels a picture may have: 8192 × 8192, 192 MiB in colour. A file of a few bytes can claim more.
pub const MAX_PIXELS: u64 = 1 << 26;

/// The longest side a picture may have.
pub const MAX_SIDE: u64 = 1 << 15;
