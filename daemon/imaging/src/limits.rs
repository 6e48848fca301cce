//! Limits on the size of a picture.

/// Maximum number of pixels of a picture: 8192 × 8192, which is 192 MiB in colour.
// Without a limit, a file of a few bytes could make the decoder allocate any amount of memory.
pub const MAX_PIXELS: u64 = 1 << 26;

/// Longest side of a picture, pixels.
pub const MAX_SIDE: u64 = 1 << 15;
