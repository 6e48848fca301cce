//! Table of values, with the form in which each value arrives at a model, or the reason why it is refused.

use peernet_external::python::{PythonError, PythonObject};

use super::Module;

/// Source of the sensor that evaluates the expressions of the table, and of the model that describes what it
/// receives.
const SOURCE: &str = "
import array, collections, datetime, enum, numpy, threading
import PIL.Image

class Text(str): pass
class Level(enum.IntEnum): HIGH = 3
class Sub(numpy.ndarray): pass
class Stubborn:
    def __reduce__(self): raise RuntimeError('no copies of me \\udcff')
class Local:
    def __init__(self): self.inside = [1, numpy.arange(3), b'raw']
class Gone:
    def __reduce__(self): return (collections.namedtuple, ())
Point = collections.namedtuple('Point', 'x y')
loop = []
loop += [loop, loop]
deep = []
for _ in range(200): deep = [deep]

class Sensor:
    def __init__(self): self.expressions = iter(open('values.txt').read().splitlines())
    def sample(self): return eval(next(self.expressions))

class Model:
    def infer(self, x):
        if isinstance(x, numpy.ndarray):
            # Fails if the array cannot be written.
            x += x.dtype.type(0)
            return '%s %s %s' % (x.dtype.str, x.shape, x.tolist())
        if isinstance(x, PIL.Image.Image):
            return '%s %s %s' % (x.mode, x.size, x.tobytes().hex())
        if isinstance(x, Local):
            return '%s %s' % (type(x).__name__, x.inside)
        return '%s %r' % (type(x).__name__, x)
";

/// Passes each value without pickling, as [`assert_transfers_of_module`] does.
fn assert_transfers(table: &[(&str, &str)]) {
    assert_transfers_of_module(Module::new(SOURCE, "own::Sensor"), table);
}

/// Passes each value with pickling allowed, as [`assert_transfers_of_module`] does.
fn assert_transfers_with_pickling(table: &[(&str, &str)]) {
    let mut module = Module::new(SOURCE, "own::Sensor");
    module.config.pickle = true;
    assert_transfers_of_module(module, table);
}

/// Passes each value from the sensor to the model. An expected text that begins with `!` is a part of the error.
fn assert_transfers_of_module(mut module: Module, table: &[(&str, &str)]) {
    let expressions: Vec<_> = table.iter().map(|(expression, _)| *expression).collect();
    std::fs::write(module.folder.path().join("values.txt"), expressions.join("\n")).expect("can be written");
    let mut sensor = module.sensor();
    module.config.object = "own::Model".to_owned();
    let mut model = module.model();
    let mut mismatches = Vec::new();
    for (expression, expected) in table {
        let result = transfer(&mut sensor, &mut model);
        let is_expected = match (&result, expected.strip_prefix('!')) {
            (Ok(result), None) => result == expected,
            (Err(error), Some(part)) => {
                let text = error.to_string();
                // An error with this word says that the process ended.
                text.contains(part) && !text.contains("process")
            }
            _ => false,
        };
        if !is_expected {
            mismatches.push(format!("{expression}\n    result    {result:?}\n    expected  {expected}"));
        }
    }
    assert!(sensor.call(&[]).result.expect("the sensor has ended without an error").is_none());
    assert!(mismatches.is_empty(), "{}", mismatches.join("\n"));
}

fn transfer(sensor: &mut PythonObject, model: &mut PythonObject) -> Result<String, PythonError> {
    let parts = sensor.call(&[]).result?.expect("there is one more value");
    let answer = model.call(&parts).result?.expect("a model always has an answer");
    Ok(String::from_utf8(answer[0].bytes.to_vec()).expect("a description is text"))
}

#[test]
fn bytes_text_numbers_and_containers_are_transferred() {
    assert_transfers(&[
        ("b''", "bytes b''"),
        ("bytearray(b'x')", "bytes b'x'"),
        ("memoryview(b'abcd')[::-2]", "bytes b'db'"),
        ("memoryview(numpy.arange(3, dtype='>i2'))", r"bytes b'\x00\x00\x00\x01\x00\x02'"),
        ("memoryview(numpy.ones((2, 2), 'u1'))", r"bytes b'\x01\x01\x01\x01'"),
        ("memoryview(numpy.array(5, 'u1'))", r"bytes b'\x05'"),
        ("memoryview(numpy.zeros((0, 4)))", "bytes b''"),
        ("memoryview(numpy.ones(5000, '>u2')).cast('B')[:2]", r"bytes b'\x00\x01'"),
        ("''", "str ''"),
        ("Text('own')", "str 'own'"),
        (r"'\ud800'", "!a text that is not Unicode cannot be transferred"),
        (r"['\ud800']", r"list ['\ud800']"),
        ("-2**70", "int -1180591620717411303424"),
        ("True", "bool True"),
        ("Level.HIGH", "int 3"),
        ("-0.0", "float -0.0"),
        ("float('nan')", "float nan"),
        ("[float('-inf'), 1]", "list [-inf, 1]"),
        ("1j", "!builtins.complex cannot be transferred"),
        ("[None, True, (1, 2.5)]", "list [None, True, [1, 2.5]]"),
        ("[]", "list []"),
        ("[()]", "list [[]]"),
        ("[b'a']", "list [b'a']"),
        ("[b'a', 'b']", "tuple (b'a', 'b')"),
        ("Point(1, 2)", "list [1, 2]"),
        ("collections.OrderedDict(a=1)", "dict {'a': 1}"),
        ("{'a': (1, {'b': b'x'}), 2: None}", "dict {'a': (1, {'b': b'x'}), 2: None}"),
        ("{None: 1, 1.5: [b'x']}", "dict {None: 1, 1.5: [b'x']}"),
        ("{(1, 2): 3}", "!keys are not strings or numbers"),
        ("{b'k': 3}", "!keys are not strings or numbers"),
        ("{1, 2}", "!builtins.set cannot be transferred"),
        ("datetime.date(2020, 1, 1)", "!datetime.date cannot be transferred"),
        ("array.array('i', [1])", "!array.array cannot be transferred"),
        ("(i for i in ())", "!builtins.generator cannot be transferred"),
        ("threading.Lock()", "!_thread.lock cannot be transferred"),
        ("Local()", "!own.Local cannot be transferred"),
        ("loop", "!more than 100 levels"),
        ("deep", "!more than 100 levels"),
        ("[b'x'] * 64", "!64 arrays, pictures or byte strings; at most 63"),
        ("bytes((1 << 30) + 1)", "!1073741825 bytes; at most 1073741824"),
    ]);
}

#[test]
fn arrays_and_numpy_scalars_are_transferred() {
    let mut table: Vec<(String, String)> = Vec::new();
    for type_code in ["?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", "c8", "c16"] {
        for order in ["<", ">"] {
            let name = match type_code {
                "?" => "|b1".to_owned(),
                "i1" | "u1" => format!("|{type_code}"),
                wide => format!("<{wide}"),
            };
            let values = match type_code {
                "?" => "[[False, True]]",
                "f2" | "f4" | "f8" => "[[0.0, 1.0]]",
                "c8" | "c16" => "[[0j, (1+0j)]]",
                _ => "[[0, 1]]",
            };
            table.push((
                format!("numpy.arange(2).astype('{order}{type_code}').reshape(1, 2)"),
                format!("{name} (1, 2) {values}"),
            ));
        }
    }
    let table: Vec<(&str, &str)> = table.iter().map(|(from, to)| (from.as_str(), to.as_str())).collect();
    assert_transfers(&table);
    assert_transfers(&[
        ("numpy.array(5, '>f8')", "<f8 () 5.0"),
        ("numpy.zeros((3, 0, 2), 'c8')", "<c8 (3, 0, 2) [[], [], []]"),
        ("numpy.zeros((0, 2**33), 'u1')", "!shape (0, 8589934592) cannot be transferred"),
        ("numpy.arange(6).reshape(2, 3)[:, ::-2]", "<i8 (2, 2) [[2, 0], [5, 3]]"),
        ("numpy.asfortranarray(numpy.arange(4).reshape(2, 2))", "<i8 (2, 2) [[0, 1], [2, 3]]"),
        ("numpy.broadcast_to(numpy.uint8(7), (2, 2))", "|u1 (2, 2) [[7, 7], [7, 7]]"),
        ("numpy.matrix([[1, 2]])", "<i8 (1, 2) [[1, 2]]"),
        ("numpy.zeros(1).view(Sub)", "<f8 (1,) [0.0]"),
        ("numpy.frombuffer(b'ab', 'u1')", "|u1 (2,) [97, 98]"),
        ("[numpy.array(1)]", "list [array(1)]"),
        ("numpy.ma.masked_array([1], [True])", "!masked array cannot be transferred"),
        ("numpy.zeros(2, 'i4,f4')", "!an array of type"),
        ("numpy.array(['a'])", "!an array of type <U1"),
        ("numpy.array([None])", "!an array of type object"),
        ("numpy.array([1], 'M8[s]')", "!an array of type datetime64[s]"),
        ("numpy.zeros(1, 'longdouble')", "!an array of type float128"),
        ("numpy.float32(0.5)", "float 0.5"),
        ("{'a': numpy.int64(-5)}", "dict {'a': -5}"),
        ("numpy.bool_(True)", "bool True"),
        ("numpy.str_('x')", "str 'x'"),
        ("numpy.bytes_(b'x')", "bytes b'x'"),
        ("numpy.longdouble(1)", "!numpy.float128 cannot be transferred"),
        ("numpy.complex64(1)", "!numpy.complex64 cannot be transferred"),
        ("numpy.timedelta64(5, 'ns')", "!numpy.timedelta64 cannot be transferred"),
        ("numpy.datetime64('2020-01-01', 'ns')", "!numpy.datetime64 cannot be transferred"),
        ("numpy.zeros(1, 'i4,f4')[0]", "!numpy.void cannot be transferred"),
    ]);
}

#[test]
fn pictures_of_every_mode_are_transferred() {
    assert_transfers(&[
        ("PIL.Image.new('1', (2, 1), 1)", "L (2, 1) ffff"),
        ("PIL.Image.new('L', (2, 1), 7)", "L (2, 1) 0707"),
        ("PIL.Image.new('P', (1, 1), 7)", "RGB (1, 1) 070707"),
        ("PIL.Image.new('RGB', (1, 2), (1, 2, 3))", "RGB (1, 2) 010203010203"),
        ("PIL.Image.new('RGBA', (1, 1), (1, 2, 3, 255))", "RGB (1, 1) 010203"),
        ("PIL.Image.new('RGBX', (1, 1), (1, 2, 3, 0))", "RGB (1, 1) 010203"),
        ("PIL.Image.new('CMYK', (1, 1), (255, 0, 0, 0))", "RGB (1, 1) 00ffff"),
        ("PIL.Image.new('YCbCr', (1, 1), (9, 128, 128))", "RGB (1, 1) 090909"),
        ("PIL.Image.new('HSV', (1, 1), (0, 0, 9))", "RGB (1, 1) 090909"),
        ("PIL.Image.new('LA', (1, 1), (7, 255))", "L (1, 1) 07"),
        ("PIL.Image.new('La', (1, 1))", "!a picture of mode La cannot be transferred"),
        ("PIL.Image.new('I', (2, 1), 70000)", "<i4 (1, 2) [[70000, 70000]]"),
        ("PIL.Image.new('F', (1, 1), 0.5)", "<f4 (1, 1) [[0.5]]"),
        ("PIL.Image.new('I;16', (1, 2), 258)", "<u2 (2, 1) [[258], [258]]"),
        ("PIL.Image.new('I;16B', (1, 2), 258)", "<u2 (2, 1) [[258], [258]]"),
        ("PIL.Image.new('RGB', (0, 3))", "RGB (0, 3) "),
        ("PIL.Image.new('RGB', (4, 4), (1, 2, 3)).crop((1, 1, 2, 2))", "RGB (1, 1) 010203"),
    ]);
}

#[test]
fn pickle_returns_equal_objects() {
    assert_transfers_with_pickling(&[
        ("Local()", "Local [1, array([0, 1, 2]), b'raw']"),
        ("{1, 2}", "set {1, 2}"),
        ("1j", "complex 1j"),
        ("Point(1, 2)", "Point Point(x=1, y=2)"),
        ("{(1, 2): 3}", "dict {(1, 2): 3}"),
        ("numpy.float32(0.5)", "float32 0.5"),
        ("Text('own')", "str 'own'"),
        ("numpy.zeros(0, 'u1')", "|u1 (0,) []"),
        ("[numpy.array(1, '>i4')]", "list [array(1, dtype=int32)]"),
        ("PIL.Image.new('RGBA', (1, 1), (1, 2, 3, 4))", "RGBA (1, 1) 01020304"),
        ("[Local().inside, {3}]", "list [[1, array([0, 1, 2]), b'raw'], {3}]"),
        ("threading.Lock()", "!a lock cannot be pickled"),
        (r"Stubborn()", r"!a Stubborn cannot be pickled: no copies of me \udcff"),
        ("lambda: 0", "!a function cannot be pickled"),
        ("Gone()", "!a pickled object arrived that cannot be unpickled: TypeError"),
    ]);
}
