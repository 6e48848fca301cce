//! An invalid input from a peer fails one call. The process continues.

use peernet_external::python::PICKLE;
use peernet_sample::{Description, ElementType, MediaType, Part, PixelFormat};

use super::{Module, bytes, failure, value};

fn part(media: MediaType, content: &'static [u8]) -> Part {
    Part { description: Description::unshaped(media), bytes: content.into() }
}

#[test]
fn invalid_parts_fail_one_call() {
    let module = Module::new("class Own:\n    def infer(self, x): return x\n", "own::Own");
    let mut model = module.model();
    let tree = |content| part(MediaType::Other("application/x-python-tree".to_owned()), content);
    let mut pixels = Description::pixels(PixelFormat::Rgb8, 1000, 1000);
    let shaped = |shape: &[u32], element| Part {
        description: Description { media: MediaType::Tensor, shape: shape.to_vec(), element },
        bytes: b"12345678"[..].into(),
    };
    let mut invalid_parts = vec![
        part(MediaType::Json, b"{"),
        part(MediaType::Text, b"\xff\xfe"),
        part(MediaType::Png, b"no picture"),
        part(MediaType::Other(PICKLE.to_owned()), b"cos\nsystem\n(S'touch hacked'\ntR."),
        tree(br#"{"part":7}"#),
        tree(br#"{"part":"x"}"#),
        tree(br#"{"dict":[[1]]}"#),
        tree(br#"{"what":0}"#),
        tree(b"["),
        shaped(&[3, 3], Some(ElementType::F32)),
        shaped(&[u32::MAX, u32::MAX], Some(ElementType::U8)),
        shaped(&[5], Some(ElementType::C128)),
        Part { description: pixels.clone(), bytes: b"12"[..].into() },
        // PIL must not allocate the pixels of a picture that has no bytes.
        Part { description: pixels.clone(), bytes: b""[..].into() },
    ];
    pixels.shape = vec![1];
    invalid_parts.push(Part { description: pixels, bytes: b"12"[..].into() });
    for invalid_part in invalid_parts {
        let message = failure(&mut model, &[invalid_part.clone(), bytes(b"and more")]);
        assert!(!message.contains("process"), "the process did not end: {invalid_part:?}: {message}");
        assert_eq!(value(&mut model, &[bytes(b"on")])[0].bytes, "on", "after {invalid_part:?}: {message}");
    }
    assert!(!module.folder.path().join("hacked").exists());
    // An array without a type is returned as its bytes.
    assert_eq!(value(&mut model, &[shaped(&[], None)])[0].bytes, "12345678");
}
