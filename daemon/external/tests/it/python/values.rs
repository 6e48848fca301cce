//! Values that are transferred, and the parts or Python types in which they arrive.

use peernet_external::python::{Images, PICKLE};
use peernet_sample::{Description, ElementType, MediaType, Part, PixelFormat};

use super::{Module, bytes, failure, value};

/// Source of a sensor that yields one value after the other.
const SENSOR: &str = "
import numpy, PIL.Image
class Own:
    def __init__(self): self.values = iter(VALUES)
    def sample(self): return next(self.values)
";

fn sensor_value(values: &str) -> Vec<Part> {
    let module = Module::new(&format!("{SENSOR}\nVALUES = [{values}]"), "own::Own");
    let mut sensor = module.sensor();
    let parts = value(&mut sensor, &[]);
    assert!(sensor.call(&[]).result.expect("it ends well").is_none(), "there is one value");
    parts
}

fn single_part(values: &str) -> (Description, Vec<u8>) {
    let mut parts = sensor_value(values);
    assert_eq!(parts.len(), 1, "{values} is one part");
    let part = parts.remove(0);
    (part.description, part.bytes.to_vec())
}

#[test]
fn plain_values_keep_their_kind() {
    for (python, media, content) in [
        ("b'a\\x00b'", MediaType::Bytes, &b"a\0b"[..]),
        ("bytearray(b'xy')", MediaType::Bytes, b"xy"),
        ("memoryview(b'a.b.')[::2]", MediaType::Bytes, b"ab"),
        ("'grün'", MediaType::Text, "grün".as_bytes()),
        ("17", MediaType::Json, b"17"),
        ("0.5", MediaType::Json, b"0.5"),
        ("None", MediaType::Json, b"null"),
        ("('cat', 0.9)", MediaType::Json, br#"["cat",0.9]"#),
        (
            "{'a': [1, None, True], 'b': numpy.float32(0.5)}",
            MediaType::Json,
            br#"{"a":[1,null,true],"b":0.5}"#,
        ),
        ("['one', 'two']", MediaType::Json, br#"["one","two"]"#),
    ] {
        let (description, bytes) = single_part(python);
        assert_eq!((description, &bytes[..]), (Description::unshaped(media), content), "{python}");
    }
}

#[test]
fn arrays_come_with_their_type_and_shape() {
    for (python, shape, element, content) in [
        (
            "numpy.array([[1, 2, 3]], 'f4')",
            vec![1, 3],
            ElementType::F32,
            &[0, 0, 128, 63, 0, 0, 0, 64, 0, 0, 64, 64][..],
        ),
        ("numpy.array([[1, 2], [3, 4]], 'u1').T", vec![2, 2], ElementType::U8, &[1, 3, 2, 4]),
        ("numpy.array([258], '>u2')", vec![1], ElementType::U16, &[2, 1]),
        ("numpy.array([True, False])", vec![2], ElementType::Bool, &[1, 0]),
        ("numpy.array(5, 'i8')", vec![], ElementType::I64, &[5, 0, 0, 0, 0, 0, 0, 0]),
        ("numpy.zeros((0, 4), 'f2')", vec![0, 4], ElementType::F16, &[]),
        ("PIL.Image.new('I;16', (2, 1), 7)", vec![1, 2], ElementType::U16, &[7, 0, 7, 0]),
    ] {
        let (description, bytes) = single_part(python);
        assert_eq!(
            description,
            Description { media: MediaType::Tensor, shape, element: Some(element) },
            "{python}"
        );
        assert_eq!(bytes, content, "{python}");
        assert_eq!(description.shaped_bytes(), Some(bytes.len() as u64));
    }
}

#[test]
fn pictures_come_as_pixels() {
    let (description, bytes) = single_part("PIL.Image.new('RGB', (2, 1), (1, 2, 3))");
    assert_eq!((description, bytes), (Description::pixels(PixelFormat::Rgb8, 2, 1), vec![1, 2, 3, 1, 2, 3]));
    let (description, bytes) = single_part("PIL.Image.new('L', (1, 2), 9)");
    assert_eq!((description, bytes), (Description::pixels(PixelFormat::Grey8, 1, 2), vec![9, 9]));
    let (description, bytes) = single_part("PIL.Image.new('RGBA', (1, 1), (1, 2, 3, 255))");
    assert_eq!((description, bytes), (Description::pixels(PixelFormat::Rgb8, 1, 1), vec![1, 2, 3]));
}

#[test]
fn each_value_of_tuple_is_one_part() {
    let parts = sensor_value("(numpy.zeros(3, 'u1'), b'xy', 'depth')");
    let media: Vec<_> = parts.iter().map(|part| part.description.media.clone()).collect();
    assert_eq!(media, [MediaType::Tensor, MediaType::Bytes, MediaType::Text]);
}

#[test]
fn value_is_unchanged_from_sensor_to_model() {
    let source = "
import numpy
VALUE = {'image': numpy.arange(6, dtype='f4').reshape(2, 3), 'pose': (1.0, float('inf')), 3: [b'raw', None, 'text']}
class Sensor:
    def sample(self): return VALUE
class Model:
    def infer(self, x):
        assert list(x) == list(VALUE) and type(x['pose']) is tuple and x['pose'] == VALUE['pose'], x
        assert x[3] == VALUE[3], x
        x['image'] += 1
        return x['image']
";
    let parts = value(&mut Module::new(source, "own::Sensor").sensor(), &[]);
    let answer = value(&mut Module::new(source, "own::Model").model(), &parts);
    let first_element = f32::from_le_bytes(answer[0].bytes[..4].try_into().expect("four bytes"));
    assert_eq!(
        (&answer[0].description.shape[..], first_element),
        (&[2, 3][..], 1.0),
        "custom code can change arrays in place"
    );
}

#[test]
fn configured_form_of_pictures_reaches_model() {
    // The answer is the type of the value, followed by its `size` if it has one.
    let type_source = "
class Own:
    def infer(self, x): return '%s.%s' % (type(x).__module__, type(x).__qualname__) + str(getattr(x, 'size', ''))
";
    let picture = || {
        let description = Description::pixels(PixelFormat::Rgb8, 2, 1);
        Part { description, bytes: vec![0; 6].into() }
    };
    let file = {
        let source = format!(
            "{SENSOR}\nimport io\nf = io.BytesIO()\nPIL.Image.new('L', (4, 5)).save(f, 'PNG')\nVALUES = [f.getvalue()]"
        );
        let mut part = value(&mut Module::new(&source, "own::Own").sensor(), &[]).remove(0);
        part.description.media = MediaType::Png;
        part
    };
    for (images, pixels, png) in [
        (Images::Pil, "PIL.Image.Image(2, 1)", "PIL.PngImagePlugin.PngImageFile(4, 5)"),
        (Images::Numpy, "numpy.ndarray6", "builtins.bytes"),
        (Images::Bytes, "builtins.bytes", "builtins.bytes"),
    ] {
        let mut module = Module::new(type_source, "own::Own");
        module.config.images = images;
        let mut model = module.model();
        for (part, expected) in [(picture(), pixels), (file.clone(), png)] {
            assert_eq!(value(&mut model, &[part])[0].bytes, expected, "{images:?}");
        }
        assert_eq!(value(&mut model, &[])[0].bytes, "builtins.NoneType");
        assert_eq!(value(&mut model, &[bytes(b"a"), bytes(b"b")])[0].bytes, "builtins.tuple");
    }
}

#[test]
fn pickled_objects_need_consent_of_both_ends() {
    let source = "
import numpy
class State:
    def __init__(self): self.map = numpy.arange(100000)
class Sensor:
    def sample(self): return State()
class Model:
    def infer(self, x): return int(x.map[7])
";
    let module = |object, pickle| {
        let mut module = Module::new(source, object);
        module.config.pickle = pickle;
        module
    };
    let message = failure(&mut module("own::Sensor", false).sensor(), &[]);
    assert!(message.contains("own.State") && message.contains("pickle = true"), "{message}");

    let parts = value(&mut module("own::Sensor", true).sensor(), &[]);
    assert_eq!(parts[0].description.media, MediaType::Other(PICKLE.to_owned()));
    assert_eq!(parts.len(), 2, "the array is a part of its own, not in the pickle");
    assert_eq!(value(&mut module("own::Model", true).model(), &parts)[0].bytes, "7");

    let mut model = module("own::Model", false).model();
    let message = failure(&mut model, &parts);
    assert!(message.contains("not unpickled") && message.contains("pickle = true"), "{message}");
    assert_eq!(model.call(&parts).times.steps.len(), 0, "the model was not called");
}
