//! Requests to a program, as bytes.

use bytes::Bytes;
use peernet_sample::{Sample, printable_line};

use super::shape::{self, NOTHING};

/// Media type of bytes without further meaning.
const BYTES: &str = "application/octet-stream";

/// Request to a program.
#[derive(Clone, Copy, Debug)]
pub enum Request<'a> {
    /// Asks a sensor for the next sample.
    Next,
    /// Asks a model to answer a sample.
    Sample(&'a Sample),
    /// Gives an actuator the answer to the sample that came from `source`.
    Answer {
        /// The answer.
        answer: &'a Sample,
        /// Origin of the sample.
        source: &'a str,
    },
    /// Asks a sensor or an actuator to prepare for an episode.
    Reset,
}

impl Request<'_> {
    /// Returns the request as pieces to be written one after the other; payloads are not copied.
    pub fn pieces(&self) -> Vec<Bytes> {
        match self {
            Self::Next => vec![Bytes::from_static(b"next\n")],
            Self::Sample(sample) => sample_pieces("sample", sample, &sample.source),
            Self::Reset => vec![Bytes::from_static(b"reset\n")],
            Self::Answer { answer, source } => sample_pieces("answer", answer, source),
        }
    }
}

/// Returns the parts of a sample as pieces, each after a line that announces it.
fn sample_pieces(word: &str, sample: &Sample, source: &str) -> Vec<Bytes> {
    // A line feed in the source would end the line.
    let source = printable_line(source);
    let source = if source.trim().is_empty() { NOTHING } else { &source };
    let Some((last, other_parts)) = sample.parts.split_last() else {
        return vec![format!("{word} 0 {BYTES} {NOTHING} {source}\n").into()];
    };
    let parts = other_parts.iter().map(|part| ("part", part)).chain([(word, last)]);
    let pieces = parts.flat_map(|(word, part)| {
        // A space in the media type would shift the words after the media type.
        let media = printable_line(&part.description.media.iana()).replace(' ', "?");
        let media = if media.is_empty() { BYTES } else { &media };
        let shape = shape::write(&part.description);
        let header = format!("{word} {} {media} {shape} {source}\n", part.bytes.len());
        [header.into(), part.bytes.clone()]
    });
    pieces.collect()
}

#[cfg(test)]
mod tests {
    use peernet_sample::{Description, MediaType, Part, PixelFormat};

    use super::*;

    fn written(request: Request<'_>) -> String {
        String::from_utf8(request.pieces().concat()).expect("is text")
    }

    #[test]
    fn request_is_one_line_and_its_bytes() {
        let mut sample =
            Sample::from_part(Description::unshaped(MediaType::Text), Bytes::from_static(b"hello"));
        assert_eq!(written(Request::Sample(&sample)), "sample 5 text/plain - -\nhello");
        sample.source = "a b\nnext.jpg".to_owned();
        assert_eq!(written(Request::Sample(&sample)), "sample 5 text/plain - a b next.jpg\nhello");
        assert_eq!(
            written(Request::Answer { answer: &sample, source: "x" }),
            "answer 5 text/plain - x\nhello"
        );
        assert_eq!(written(Request::Next), "next\n");
        assert_eq!(written(Request::Reset), "reset\n");
    }

    #[test]
    fn all_parts_except_last_begin_with_word_part() {
        let pixels = Description::pixels(PixelFormat::Rgb8, 2, 1);
        let mut sample = Sample::from_part(pixels, Bytes::from_static(b"rgbrgb"));
        sample.parts.push(Part { description: Description::bytes(), bytes: Bytes::from_static(b"d") });
        let expected = "part 6 image/x-rgb8 1x2x3:u8 -\nrgbrgbsample 1 application/octet-stream - -\nd";
        assert_eq!(written(Request::Sample(&sample)), expected);
    }
}
