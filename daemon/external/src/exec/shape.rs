//! Shapes in words: `480x640x3:u8`, or `-` for none.

use peernet_sample::{Description, ElementType, MediaType};

const ELEMENTS: [(&str, ElementType, u64); 4] = [
    ("u8", ElementType::U8, 1),
    ("f32", ElementType::F32, 4),
    ("f64", ElementType::F64, 8),
    ("i64", ElementType::I64, 8),
];

/// Stands for no shape, and for an empty source.
pub(super) const NOTHING: &str = "-";

/// Most dimensions.
const MAX_DIMENSIONS: usize = 16;

/// The shape of a part in words.
pub(super) fn write(description: &Description) -> String {
    let Some(element) = description.element else { return NOTHING.to_owned() };
    let lengths: Vec<_> = description.shape.iter().map(u32::to_string).collect();
    let name = ELEMENTS.iter().find(|(_, known, _)| *known == element).map_or("u8", |(name, ..)| name);
    format!("{}:{name}", lengths.join("x"))
}

/// The description of a part, and the bytes that it must have; `None` for what is not a shape.
pub(super) fn read(media: MediaType, shape: &str) -> Option<(Description, Option<u64>)> {
    if shape == NOTHING {
        return Some((Description::unshaped(media), None));
    }
    let (lengths, element) = shape.split_once(':')?;
    let &(_, element, size) = ELEMENTS.iter().find(|(name, ..)| *name == element)?;
    // No dimension at all is a single number.
    let shape = match lengths {
        "" => Vec::new(),
        lengths => lengths.split('x').map(|length| length.parse().ok()).collect::<Option<Vec<u32>>>()?,
    };
    if shape.len() > MAX_DIMENSIONS {
        return None;
    }
    let bytes = shape.iter().try_fold(size, |bytes, length| bytes.checked_mul(u64::from(*length)))?;
    Some((Description { media, shape, element: Some(element) }, Some(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_says_how_many_bytes_there_are() {
        let (description, bytes) = read(MediaType::Tensor, "1x3x2:f32").expect("a shape");
        assert_eq!((description.shape.as_slice(), bytes), ([1, 3, 2].as_slice(), Some(24)));
        assert_eq!(write(&description), "1x3x2:f32");
        assert_eq!(read(MediaType::Bytes, "-"), Some((Description::bytes(), None)));
        assert_eq!(read(MediaType::Tensor, ":f64").map(|(_, bytes)| bytes), Some(Some(8)));
        for wrong in ["", "3", "3:u9", "x:u8", "-1:u8", "3x:u8", "4294967295x4294967295x9:u8"] {
            assert_eq!(read(MediaType::Tensor, wrong), None, "{wrong}");
        }
    }
}
