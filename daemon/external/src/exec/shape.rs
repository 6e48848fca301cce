//! Text form of shapes: `480x640x3:u8`, or `-` for no shape.

use peernet_sample::{Description, ElementType, MediaType};

/// Types of elements that a shape can name.
const ELEMENTS: [ElementType; 14] = [
    ElementType::U8,
    ElementType::F32,
    ElementType::F64,
    ElementType::I64,
    ElementType::Bool,
    ElementType::I8,
    ElementType::U16,
    ElementType::I16,
    ElementType::U32,
    ElementType::I32,
    ElementType::U64,
    ElementType::F16,
    ElementType::C64,
    ElementType::C128,
];

const fn name(element: ElementType) -> &'static str {
    match element {
        ElementType::U8 => "u8",
        ElementType::F32 => "f32",
        ElementType::F64 => "f64",
        ElementType::I64 => "i64",
        ElementType::Bool => "bool",
        ElementType::I8 => "i8",
        ElementType::U16 => "u16",
        ElementType::I16 => "i16",
        ElementType::U32 => "u32",
        ElementType::I32 => "i32",
        ElementType::U64 => "u64",
        ElementType::F16 => "f16",
        ElementType::C64 => "c64",
        ElementType::C128 => "c128",
    }
}

/// Text for a missing shape or an empty source.
pub(super) const NOTHING: &str = "-";

/// Maximum number of dimensions.
const MAX_DIMENSIONS: usize = 16;

/// Returns the shape of a part as text.
pub(super) fn write(description: &Description) -> String {
    let Some(element) = description.element else { return NOTHING.to_owned() };
    let lengths: Vec<_> = description.shape.iter().map(u32::to_string).collect();
    format!("{}:{}", lengths.join("x"), name(element))
}

/// Parses the shape of a part. Returns the description of the part, and its length in bytes if the shape determines the
/// length; `None` for an invalid shape.
pub(super) fn read(media: MediaType, shape: &str) -> Option<(Description, Option<u64>)> {
    if shape == NOTHING {
        return Some((Description::unshaped(media), None));
    }
    let (lengths, element) = shape.split_once(':')?;
    let element = ELEMENTS.into_iter().find(|candidate| name(*candidate) == element)?;
    // A shape without dimensions is a single number.
    let shape = match lengths {
        "" => Vec::new(),
        lengths => lengths.split('x').map(|length| length.parse().ok()).collect::<Option<Vec<u32>>>()?,
    };
    if shape.len() > MAX_DIMENSIONS {
        return None;
    }
    let description = Description { media, shape, element: Some(element) };
    let bytes = description.shaped_bytes()?;
    Some((description, Some(bytes)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_determines_number_of_bytes() {
        let (description, bytes) = read(MediaType::Tensor, "1x3x2:f32").expect("a shape");
        assert_eq!((description.shape.as_slice(), bytes), ([1, 3, 2].as_slice(), Some(24)));
        assert_eq!(write(&description), "1x3x2:f32");
        for element in ELEMENTS {
            let shape = format!("2x3:{}", name(element));
            let (description, bytes) = read(MediaType::Tensor, &shape).expect("a shape");
            assert_eq!((write(&description), bytes), (shape, Some(6 * element.bytes())));
        }
        assert_eq!(read(MediaType::Bytes, "-"), Some((Description::bytes(), None)));
        assert_eq!(read(MediaType::Tensor, ":f64").map(|(_, bytes)| bytes), Some(Some(8)));
        for wrong in ["", "3", "3:u9", "x:u8", "-1:u8", "3x:u8", "4294967295x4294967295x9:u8"] {
            assert_eq!(read(MediaType::Tensor, wrong), None, "{wrong}");
        }
    }
}
