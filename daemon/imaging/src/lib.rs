//! Pictures: reading their size, decoding, resizing, cropping, padding, encoding.
//!
//! Pictures are JPEG and PNG files, and decoded pixels of one byte per channel, as [`peernet_sample`] describes them.
//! Functions write into a [`Picture`] that the caller keeps, so that a stream of pictures of one size allocates memory
//! once. Input is untrusted: any bytes lead to a picture or an [`ImageError`], and a picture beyond [`MAX_PIXELS`] is
//! refused before memory is allocated for it.
//!
//! The crate is separate, because the transforms of sensors and the preprocessing of models both need it and must not
//! depend on each other.

mod class_mask;
mod crop;
mod decode;
mod encode;
mod error;
mod limits;
mod orientation;
mod pad;
mod picture;
mod probe;
mod resize;
mod size;

pub use class_mask::decode_class_mask;
pub use crop::{Crop, crop};
pub use decode::{decode, read_part};
pub use encode::{Encoding, encode};
pub use error::ImageError;
pub use limits::{MAX_PIXELS, MAX_SIDE};
pub use orientation::{Orientation, turn_upright};
pub use pad::{Padding, pad};
pub use picture::Picture;
pub use probe::{Header, probe, probe_part};
pub use resize::{Filter, Resizer, Scaling};
