//! Description of a card in words.

use peernet_imaging::Orientation;

use super::CardSummary;
use super::card::{
    Activation, Card, CentreCrop, Input, Normalisation, PictureSource, Position, Resize, Rounding, Source,
    Task, TensorOutput,
};

impl Card {
    /// Returns the texts that describe the card.
    pub(super) fn summary(&self) -> CardSummary {
        let is_single = self.inputs.len() == 1;
        let named = |input: &Input, text: String| {
            if is_single { text } else { format!("{}: {text}", input.name) }
        };
        let inputs: Vec<_> = self.inputs.iter().map(|input| named(input, describe_input(input))).collect();
        let steps = self.inputs.iter().flat_map(|input| {
            let steps = input.picture().map(describe_steps).unwrap_or_default();
            steps.into_iter().map(move |step| named(input, step))
        });
        CardSummary {
            name: self.name.clone(),
            version: self.version.clone(),
            task: self.task.name().to_owned(),
            description: self.description.clone(),
            input: inputs.join(", "),
            preprocessing: steps.collect(),
            output: describe_output(&self.task),
            labels: self.task.labels().unwrap_or_default().to_vec(),
            provenance: self.provenance.iter().map(|(key, value)| (key.clone(), plain_text(value))).collect(),
        }
    }
}

/// Returns shape, type and origin of an input: `1 × 3 × 384 × 384 float32 nchw`.
fn describe_input(input: &Input) -> String {
    let origin = match &input.source {
        Source::Picture(picture) => format!(" {}", picture.layout),
        Source::Array => String::new(),
        Source::Constant(_) => " constant".to_owned(),
    };
    format!("{} {}{origin}", describe_shape(&input.shape), input.data_type)
}

fn describe_shape(shape: &[usize]) -> String {
    match shape {
        // A tensor without dimensions has one element.
        [] => "one".to_owned(),
        shape => shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" × "),
    }
}

/// Returns the preprocessing of a picture, in the order in which it is applied.
fn describe_steps(picture: &PictureSource) -> Vec<String> {
    let mut steps = vec![format!("colours {}", format!("{:?}", picture.colour).to_lowercase())];
    if picture.preprocessing.orientation == Orientation::Exif {
        steps.push("upright by EXIF".to_owned());
    }
    steps.extend(picture.preprocessing.resize.map(describe_resize));
    steps.extend(picture.preprocessing.crop.map(describe_crop));
    let Normalisation { scale, mean, std } = &picture.normalisation;
    steps.push(format!("(byte × {scale} − mean) / std, mean {mean:?}, std {std:?}"));
    steps
}

fn describe_output(task: &Task) -> String {
    match task {
        Task::Classification(output) => {
            let scores = match output.activation {
                Activation::None => "scores as they come",
                Activation::Softmax => "softmax",
                Activation::Sigmoid => "sigmoid",
            };
            format!("{} classes, {scores}, best {} listed", output.labels.len(), output.listed_class_count())
        }
        Task::Detection(output) => {
            let suppression = match output.iou_threshold {
                Some(iou) => format!("boxes of a class overlap by at most {iou}"),
                None => "no suppression of overlapping boxes".to_owned(),
            };
            format!(
                "boxes of {} classes, layout {}, scores above {}, {suppression}, at most {}",
                output.labels.len(),
                output.outputs.layout(),
                output.score_threshold,
                output.max_detections
            )
        }
        Task::Segmentation(output) => format!("a class of {} for each pixel", output.labels.len()),
        Task::Embedding(output) => match output.normalise {
            true => "a vector of length 1".to_owned(),
            false => "a vector".to_owned(),
        },
        Task::Tensors(tensors) => {
            let text = |tensor: &TensorOutput| {
                format!("{}: {} {}", tensor.name, describe_shape(&tensor.shape), tensor.data_type)
            };
            tensors.iter().map(text).collect::<Vec<_>>().join(", ")
        }
    }
}

fn describe_resize(resize: Resize) -> String {
    let (size, filter, antialias) = match resize {
        Resize::Exact { width, height, filter, antialias } => {
            (format!("to {width} × {height}"), filter, antialias)
        }
        Resize::Shortest { size, filter, antialias } => {
            (format!("shorter side to {size}"), filter, antialias)
        }
        Resize::Letterbox { width, height, filter, antialias, fill, position } => {
            let position = match position {
                Position::Centre => "in the centre",
                Position::TopLeft => "in the upper left corner",
            };
            (format!("into {width} × {height} {position}, filled with {fill}"), filter, antialias)
        }
    };
    let antialiasing = if antialias { "antialiased" } else { "not antialiased" };
    format!("resize {size}, {}, {antialiasing}", format!("{filter:?}").to_lowercase())
}

fn describe_crop(CentreCrop { width, height, rounding }: CentreCrop) -> String {
    let rounding = match rounding {
        Rounding::Down => "",
        Rounding::HalfEven => ", margins rounded half to even",
    };
    format!("centre crop {width} × {height}{rounding}")
}

/// Returns a TOML value as text; a string has no quotes.
fn plain_text(value: &toml::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::super::card::tests::{POLICY, detector, small_card_with};
    use super::*;

    #[test]
    fn summary_describes_every_step() {
        let card = small_card_with(
            "resize = { mode = \"exact\", width = 2, height = 1 }",
            "resize = { mode = \"shortest\", size = 3, filter = \"bicubic\" }\n\
             crop = { width = 2, height = 1, rounding = \"half-even\" }",
        );
        let summary = card.expect("the card is valid").summary();
        assert_eq!(summary.input, "1 × 1 × 1 × 2 float32 nchw");
        assert_eq!(
            summary.preprocessing,
            [
                "colours grey",
                "resize shorter side to 3, bicubic, antialiased",
                "centre crop 2 × 1, margins rounded half to even",
                "(byte × 0.5 − mean) / std, mean [1.0], std [2.0]",
            ]
        );
        assert_eq!(summary.output, "2 classes, softmax, best 2 listed");
    }

    #[test]
    fn several_inputs_are_described_by_name() {
        let summary = Card::parse(POLICY).expect("the card is valid").summary();
        assert_eq!(
            summary.input,
            "front: 1 × 1 × 2 × 3 uint8 nhwc, state: 2 float64, wrist: 1 × 1 × 1 × 1 × 2 float32 nchw, \
             steps: 1 × 2 int64 constant"
        );
        assert_eq!(
            summary.preprocessing[..2],
            [
                "front: colours rgb",
                "front: (byte × 1 − mean) / std, mean [0.0, 0.0, 0.0], std [1.0, 1.0, 1.0]"
            ]
        );
        assert_eq!(summary.output, "action: 1 × 2 float32, done: one bool");
        let summary =
            Card::parse(&detector("layout = 'yolov8'\nname = 'o'")).expect("the card is valid").summary();
        assert_eq!(
            summary.preprocessing[1],
            "resize into 2 × 2 in the centre, filled with 114, bilinear, antialiased"
        );
        assert_eq!(
            summary.output,
            "boxes of 2 classes, layout yolov8, scores above 0.25, boxes of a class overlap by at most 0.45, at most 100"
        );
    }
}
