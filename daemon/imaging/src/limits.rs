//! Limits of the size of a picture.

/// Maximum number of pixels of a picture: 8192 × 8192, which is 192 MiB in colour.
// A file of a few bytes can announce any size.
pub const MAX_PIXELS: u64 = 1 << 26;

/// Longest side of a picture, pixels.
pub const MAX_SIDE: u64 = 1 << 15;
