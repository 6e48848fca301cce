//! Tests of the parser of cards.

use peernet_imaging::Filter;

use super::*;
use crate::model::onnx::data_type::DataType;

/// Card for grey pictures of 2 × 1 pixels.
pub(in crate::model::onnx) const SMALL: &str = r#"
name = "small"
task = "classification"
[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 1, 1, 2]
colour = "grey"
[preprocessing]
resize = { mode = "exact", width = 2, height = 1 }
scale = 0.5
mean = [1.0]
std = [2.0]
[output]
name = "logits"
activation = "softmax"
labels = ["a", "b"]
"#;

/// Card of a policy with two pictures and a state.
pub(in crate::model::onnx) const POLICY: &str = r#"
name = "policy"
task = "tensors"
[[input]]
name = "front"
dtype = "uint8"
layout = "nhwc"
shape = [1, 1, 2, 3]
colour = "rgb"
[[input]]
name = "state"
dtype = "float64"
shape = [2]
[[input]]
name = "wrist"
dtype = "float32"
layout = "nchw"
shape = [1, 1, 1, 1, 2]
colour = "grey"
preprocessing = { scale = 2.0, mean = [0.0], std = [1.0] }
[[input]]
name = "steps"
dtype = "int64"
shape = [1, 2]
value = [[3, 4]]
[preprocessing]
[[output]]
name = "action"
dtype = "float32"
shape = [1, 2]
[[output]]
name = "done"
dtype = "bool"
shape = []
"#;

/// Card of a detector for grey pictures of 2 × 2 pixels, with the lines that name its outputs.
pub(in crate::model::onnx) fn detector(output: &str) -> String {
    format!(
        r#"
name = "detector"
task = "detection"
[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 1, 2, 2]
colour = "grey"
[preprocessing]
resize = {{ mode = "letterbox", width = 2, height = 2 }}
scale = 1.0
mean = [0.0]
std = [1.0]
[output]
labels = ["a", "b"]
{output}
"#
    )
}

/// Reads the card [`SMALL`] with `to` in place of `from`.
pub(in crate::model::onnx) fn small_card_with(from: &str, to: &str) -> Result<Card, ModelCardError> {
    assert!(SMALL.contains(from), "{from}");
    Card::parse(&SMALL.replace(from, to))
}

#[test]
fn card_is_read_with_its_defaults() {
    let card = Card::parse(SMALL).expect("the card is valid");
    let Task::Classification(output) = &card.task else { panic!("{:?}", card.task) };
    assert_eq!(output.listed_class_count(), 2, "all classes are listed, because there are fewer than five");
    let picture = card.picture().expect("the input is a picture");
    assert_eq!(
        picture.preprocessing.resize,
        Some(Resize::Exact { width: 2, height: 1, filter: Filter::Bilinear, antialias: true })
    );
    assert!(Card::parse(&format!("{SMALL}\n[provenance]\nanything = [1, 2]\n")).is_ok());
}

#[test]
fn inputs_have_any_rank_and_type() {
    let card = Card::parse(POLICY).expect("the card is valid");
    let [front, state, wrist, steps] = &card.inputs[..] else { panic!("{:?}", card.inputs) };
    // Bytes of an input of integers stay as they are.
    let unchanged = Normalisation { scale: 1.0, mean: vec![0.0; 3], std: vec![1.0; 3] };
    assert_eq!(front.picture().expect("the input is a picture").normalisation, unchanged);
    assert_eq!(
        (state.data_type, &state.shape[..], &state.source),
        (DataType::Float64, &[2][..], &Source::Array)
    );
    assert_eq!(wrist.picture().expect("the input is a picture").normalisation.scale, 2.0);
    assert_eq!((wrist.shape.len(), &steps.source), (5, &Source::Constant(vec![3.0, 4.0])));
    let Task::Tensors(outputs) = &card.task else { panic!("{:?}", card.task) };
    assert_eq!(outputs.len(), 2);
    assert_eq!((outputs[1].data_type, outputs[1].shape.len()), (DataType::Bool, 0));
}

#[test]
fn layout_of_detector_has_defaults() {
    let task_of = |output: &str| match Card::parse(&detector(output)).expect(output).task {
        Task::Detection(detection) => detection,
        task => panic!("{task:?}"),
    };
    let yolo = task_of("layout = 'yolov8'\nname = 'output0'");
    assert_eq!((yolo.score_threshold, yolo.iou_threshold, yolo.max_detections), (0.25, Some(0.45), 100));
    assert_eq!((yolo.box_format, yolo.box_unit), (BoxFormat::Cxcywh, BoxUnit::Pixels));
    let detr = task_of("layout = 'detr'\nscores = 'logits'\nboxes = 'pred_boxes'\nactivation = 'softmax'");
    assert_eq!((detr.iou_threshold, detr.box_unit), (None, BoxUnit::Fraction));
    let nms = task_of(
        "layout = 'nms'\nscores = 's'\nboxes = 'b'\nclasses = 'c'\nbox_format = 'yxyx'\niou_threshold = 0.5",
    );
    assert_eq!((nms.iou_threshold, nms.box_format), (Some(0.5), BoxFormat::Yxyx));
}

#[test]
fn odd_margin_is_split_as_configured() {
    let first_margins =
        |rounding: Rounding| [0, 1, 2, 3, 4, 5, 7].map(|margin| rounding.first_margin(margin));
    assert_eq!(first_margins(Rounding::Down), [0, 0, 1, 1, 2, 2, 3]);
    // As `int(round(margin / 2.0))` computes in Python.
    assert_eq!(first_margins(Rounding::HalfEven), [0, 0, 1, 2, 2, 2, 4]);
    assert_eq!([Position::Centre.first_margin(3), Position::TopLeft.first_margin(3)], [1, 0]);
}

/// Checks that each change of a card leads to an error that contains a text. A change is the old text, the new text,
/// and the text in the error.
fn assert_refused(card: &str, changes: &[(&str, &str, &str)]) {
    for (from, to, expected) in changes {
        assert!(card.contains(from), "{from}");
        let error = Card::parse(&card.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn contradictory_keys_are_named() {
    assert_refused(
        SMALL,
        &[
            ("shape = [1, 1, 1, 2]", "shape = [2, 1, 1, 2]", "batch of 2"),
            ("shape = [1, 1, 1, 2]", "shape = [1, 2]", "has 2 lengths"),
            (
                "colour = \"grey\"",
                "colour = \"rgb\"",
                "1 channels with layout = \"nchw\", but colour = \"rgb\" has 3",
            ),
            (
                "shape = [1, 1, 1, 2]\ncolour = \"grey\"",
                "shape = [1, 32, 32, 3]\ncolour = \"rgb\"",
                "32 channels with layout = \"nchw\", but colour = \"rgb\" has 3; is layout = \"nhwc\" meant?",
            ),
            ("colour = \"grey\"", "", "its colour is missing"),
            (
                "colour = \"grey\"\n[preprocessing]",
                "colour = \"grey\"\n[provenance]",
                "its preprocessing is missing",
            ),
            (
                "layout = \"nchw\"\nshape = [1, 1, 1, 2]\ncolour = \"grey\"",
                "shape = [1]",
                "applies to no input",
            ),
            ("mean = [1.0]", "mean = []", "mean has 0 numbers"),
            ("scale = 0.5", "scale = 0.0", "preprocessing.scale must not be 0"),
            ("std = [2.0]", "std = [0.0]", "larger than 0"),
            ("std = [2.0]", "std = [-0.25]", "preprocessing.std has -0.25"),
            ("std = [2.0]", "", "preprocessing.std is missing"),
            ("scale = 0.5", "scale = nan", "finite"),
            ("width = 2,", "width = 3,", "3 × 1 pixels"),
            ("mode = \"exact\", width = 2, height = 1", "mode = \"shortest\", size = 2", "needs a crop"),
            ("mode = \"exact\", width = 2", "mode = \"letterbox\", width = 4", "4 × 1 pixels"),
            (
                "mode = \"exact\", width = 2, height = 1 }",
                "mode = \"shortest\", size = 1 }\ncrop = { width = 2, height = 2 }",
                "crop cuts out 2 × 2 pixels, but preprocessing.resize makes a shorter side of 1 pixels; write a larger size",
            ),
            (
                "width = 2, height = 1 }",
                "width = 2, height = 1 }\ncrop = { width = 2, height = 2 }",
                "crop cuts out 2 × 2 pixels, but preprocessing.resize makes 2 × 1 pixels",
            ),
            ("labels = [\"a\", \"b\"]", "labels = []", "labels is empty; write one label"),
            ("labels = [", "top_k = 0\nlabels = [", "top_k is 0; write the number"),
            ("labels = [\"a\", \"b\"]", "labels = [\"a\", \"b\", \"a\"]", "has \"a\" twice"),
            ("labels = [", "top_k = 3\nlabels = [", "write top_k = 2"),
            ("shape = [1, 1, 1, 2]", "shape = [-1, 1, 1, 2]", "a length is -1; write the length"),
            ("shape = [1, 1, 1, 2]", "shape = [\"batch\", 1, 1, 2]", "1 for the batch"),
            ("shape = [1, 1, 1, 2]", "shape = [1, 65536, 65536, 2]", "at most 268435456 elements"),
            ("task = \"classification\"", "task = \"counting\"", "classification"),
            ("task = \"classification\"", "task = \"detection\"", "layout"),
            ("dtype = \"float32\"", "dtype = \"float8\"", "float32"),
            ("dtype = \"float32\"", "dtype = \"bool\"", "picture of dtype bool"),
            ("scale = 0.5", "scale = 0.5\nmeans = [1.0]", "means"),
        ],
    );
}

#[test]
fn contradictory_inputs_and_outputs_are_named() {
    assert_refused(
        POLICY,
        &[
            ("name = \"wrist\"", "name = \"front\"", "input names \"front\" twice"),
            ("name = \"done\"", "name = \"action\"", "output names \"action\" twice"),
            ("value = [[3, 4]]", "value = [3, 4, 5]", "has 3 numbers; its shape needs 2"),
            ("value = [[3, 4]]", "value = [3, 4.5]", "has 4.5, which the type int64 cannot represent"),
            (
                "value = [[3, 4]]",
                "value = 9007199254740993",
                "9007199254740993 is not between -2^53 and 2^53",
            ),
            (
                "dtype = \"int64\"\nshape = [1, 2]\nvalue = [[3, 4]]",
                "dtype = \"float16\"\nshape = [1, 2]\nvalue = [[3, 70000]]",
                "has 70000, which the type float16 cannot represent",
            ),
            (
                "dtype = \"int64\"\nshape = [1, 2]\nvalue = [[3, 4]]",
                "dtype = \"float64\"\nshape = [1, 2]\nvalue = [[1e300, inf]]",
                "has inf, which the type float64 cannot represent",
            ),
            (
                "dtype = \"int64\"\nshape = [1, 2]\nvalue = [[3, 4]]",
                "dtype = \"int32\"\nshape = [1, 2]\nvalue = [[2147483647, 2147483648]]",
                "has 2147483648, which the type int32 cannot represent",
            ),
            ("value = [[3, 4]]", "value = [[3, 4]]\ncolour = \"rgb\"", "input \"steps\" is a constant"),
            ("value = [[3, 4]]", "value = \"three\"", "is not a number"),
            ("dtype = \"bool\"", "", "missing field `dtype`"),
        ],
    );
    assert_refused(
        &detector("layout = \"yolov8\"\nname = \"output0\""),
        &[
            (
                "name = \"output0\"",
                "",
                "output.name is missing; layout \"yolov8\" has the keys name, activation",
            ),
            (
                "name = \"output0\"",
                "name = \"o\"\nscores = \"s\"",
                "output.scores is not a key of layout \"yolov8\"",
            ),
            (
                "layout = \"yolov8\"\nname = \"output0\"",
                "layout = \"detr\"\nscores = \"s\"\nboxes = \"b\"",
                "activation is missing",
            ),
            ("name = \"output0\"", "name = \"o\"\nscore_threshold = 25", "output.score_threshold is 25"),
            (
                "name = \"output0\"",
                "name = \"o\"\nactivation = \"softmax\"",
                "output.activation is \"softmax\"",
            ),
            ("name = \"output0\"", "name = \"o\"\nmax_detections = 0", "max_detections is 0"),
            (
                "layout = \"nchw\"\nshape = [1, 1, 2, 2]\ncolour = \"grey\"\n[preprocessing]",
                "shape = [1]\n[provenance]",
                "needs an input that is a picture",
            ),
        ],
    );
}
