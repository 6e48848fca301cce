//! Tests with files that the encoders write and the decoders read, complete and damaged.

mod hostile;
mod round_trip;

use peernet_imaging::Picture;
use peernet_sample::PixelFormat;

/// Returns a picture with structure: slopes, an edge, a little noise.
fn scene(format: PixelFormat, width: u32, height: u32) -> Picture {
    let channels = format.channels();
    let value = |x: u32, y: u32, channel: u32| {
        let slope = 40 + 120 * x / width + 60 * y / height;
        let edge = if 2 * x > width { 30 } else { 0 };
        let noise = (x * 7 + y * 13 + channel * 5) % 6;
        (slope + edge * channel + noise).min(255) as u8
    };
    let pixels = (0..height)
        .flat_map(|y| (0..width).flat_map(move |x| (0..channels).map(move |channel| value(x, y, channel))));
    Picture::new(format, width, height, pixels.collect()).expect("fits")
}
