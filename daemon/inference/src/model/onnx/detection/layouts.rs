//! Reading of candidates from a detector's outputs.

use super::nms::{Candidate, Rectangle};
use crate::model::onnx::card::{Activation, BoxFormat, BoxUnit, Detection, DetectionOutputs};
use crate::model::onnx::outputs::{Output, OutputError, Outputs};

/// Reader of the candidates whose score is above the card's threshold.
pub(super) struct CandidateReader<'a> {
    detection: &'a Detection,
    /// Horizontal and vertical size of the unit of the boxes, in pixels of the input.
    unit: (f32, f32),
    candidates: Vec<Candidate>,
}

impl<'a> CandidateReader<'a> {
    /// Reads the candidates, with boxes in pixels of an input of this width and height.
    ///
    /// # Errors
    /// If an output does not have the shape of its layout, contains NaN, or names a class without label.
    pub(super) fn read(
        detection: &'a Detection,
        outputs: &Outputs<'a, '_>,
        (width, height): (u32, u32),
    ) -> Result<Vec<Candidate>, OutputError> {
        let unit = match detection.box_unit {
            BoxUnit::Pixels => (1.0, 1.0),
            BoxUnit::Fraction => (width as f32, height as f32),
        };
        let mut reader = Self { detection, unit, candidates: Vec::new() };
        match &detection.outputs {
            DetectionOutputs::Yolov5 { name, activation } => {
                reader.read_yolov5(&outputs.get(name)?, *activation)?;
            }
            DetectionOutputs::Yolov8 { name, activation } => {
                reader.read_yolov8(&outputs.get(name)?, *activation)?;
            }
            DetectionOutputs::Yolov10 { name } => reader.read_yolov10(&outputs.get(name)?)?,
            DetectionOutputs::Detr { scores, boxes, is_softmax } => {
                reader.read_detr(&outputs.get(scores)?, &outputs.get(boxes)?, *is_softmax)?;
            }
            DetectionOutputs::Nms { boxes, scores, classes, count } => {
                let count = count.as_ref().map(|name| outputs.get(name)).transpose()?;
                let outputs = [outputs.get(boxes)?, outputs.get(scores)?, outputs.get(classes)?];
                reader.read_nms(&outputs, count.as_ref())?;
            }
        }
        Ok(reader.candidates)
    }

    fn label_count(&self) -> usize {
        self.detection.labels.len()
    }

    /// Adds a candidate if its score is above the threshold.
    fn add(&mut self, class: usize, score: f32, numbers: [f32; 4]) {
        if score > self.detection.score_threshold {
            let rectangle = rectangle(self.detection.box_format, numbers, self.unit);
            self.candidates.push(Candidate { class, score, rectangle });
        }
    }

    fn read_yolov5(&mut self, output: &Output<'_>, activation: Activation) -> Result<(), OutputError> {
        let length = 5 + self.label_count();
        let expected = format!("[1, n, {length}]");
        let [_, actual] = output.unbatched(&expected)?;
        if actual != length {
            return Err(output.wrong_shape(&expected));
        }
        for row in output.numbers()?.chunks_exact(length) {
            let (numbers, scores) = row.split_at(4);
            let object = activate(activation, scores[0]);
            // The final score is the product with a class's score, and so at most `object`. Most rows are skipped here.
            if object <= self.detection.score_threshold {
                continue;
            }
            let (class, score) = best(&scores[1..]);
            self.add(class, object * activate(activation, score), first_four(numbers));
        }
        Ok(())
    }

    fn read_yolov8(&mut self, output: &Output<'_>, activation: Activation) -> Result<(), OutputError> {
        let rows = 4 + self.label_count();
        let expected = format!("[1, {rows}, n]");
        let [actual, count] = output.unbatched(&expected)?;
        if actual != rows {
            return Err(output.wrong_shape(&expected));
        }
        let numbers = output.numbers()?;
        let (boxes, scores) = numbers.split_at(4 * count);
        // The scores are read class by class, because the scores of one class are contiguous.
        let mut best = vec![(0, f32::NEG_INFINITY); count];
        // A model may return no candidates, and `chunks_exact(0)` panics.
        for (class, scores) in scores.chunks_exact(count.max(1)).enumerate() {
            for (best, score) in best.iter_mut().zip(scores) {
                if *score > best.1 {
                    *best = (class, *score);
                }
            }
        }
        for (at, (class, score)) in best.into_iter().enumerate() {
            let numbers = [0, 1, 2, 3].map(|row| boxes[row * count + at]);
            // The activation keeps the order of scores, so it is computed only for the best class.
            self.add(class, activate(activation, score), numbers);
        }
        Ok(())
    }

    fn read_yolov10(&mut self, output: &Output<'_>) -> Result<(), OutputError> {
        let expected = "[1, n, 6]";
        let [_, 6] = output.unbatched(expected)? else { return Err(output.wrong_shape(expected)) };
        for row in output.numbers()?.chunks_exact(6) {
            let (numbers, score, class) = (first_four(row), row[4], row[5]);
            // Rows with which a model pads the output have low scores and often no valid class.
            if score > self.detection.score_threshold {
                self.add(self.class_index(output.name, class)?, score, numbers);
            }
        }
        Ok(())
    }

    fn read_detr(
        &mut self,
        scores: &Output<'_>,
        boxes: &Output<'_>,
        is_softmax: bool,
    ) -> Result<(), OutputError> {
        let labels = self.label_count();
        let logits = labels + usize::from(is_softmax);
        let expected = format!("[1, n, {logits}]");
        let [count, actual] = scores.unbatched(&expected)?;
        if actual != logits {
            return Err(scores.wrong_shape(&expected));
        }
        let expected = format!("[1, {count}, 4]");
        if boxes.unbatched(&expected)? != [count, 4] {
            return Err(boxes.wrong_shape(&expected));
        }
        let (scores, boxes) = (scores.numbers()?, boxes.numbers()?);
        for (row, numbers) in scores.chunks_exact(logits).zip(boxes.chunks_exact(4)) {
            let numbers = first_four(numbers);
            if is_softmax {
                // "No object" is not a class, but its logit is part of the softmax.
                let (class, score) = best(&row[..labels]);
                self.add(class, softmax(row, score), numbers);
            } else {
                // A row may belong to several classes, each with a score of its own.
                for (class, logit) in row.iter().enumerate() {
                    self.add(class, activate(Activation::Sigmoid, *logit), numbers);
                }
            }
        }
        Ok(())
    }

    /// Reads the layout `nms`: boxes, scores and classes in three outputs.
    fn read_nms(
        &mut self,
        [boxes, scores, classes]: &[Output<'_>; 3],
        count: Option<&Output<'_>>,
    ) -> Result<(), OutputError> {
        let [rows] = scores.unbatched("[1, n] or [n]")?;
        let expected = format!("[1, {rows}, 4] or [{rows}, 4]");
        if boxes.unbatched(&expected)? != [rows, 4] {
            return Err(boxes.wrong_shape(&expected));
        }
        let expected = format!("[1, {rows}] or [{rows}]");
        if classes.unbatched(&expected)? != [rows] {
            return Err(classes.wrong_shape(&expected));
        }
        let counted_rows = count.map(|output| {
            // The count is an array of one element or a scalar, whose shape is `[]`.
            let [length] = output.unbatched("[1]").or_else(|error| match output.shape[..] {
                [] => Ok([1]),
                _ => Err(error),
            })?;
            let numbers = output.numbers()?;
            let count = numbers.first().filter(|_| length == 1).copied();
            let count = count.ok_or_else(|| output.wrong_shape("[1]"))?;
            // The cast saturates and drops fractions. Only a whole number from 0 to `rows` stays equal.
            let valid_rows = (count as usize).min(rows);
            let error = || OutputError::RowCount { name: output.name.to_owned(), count, rows };
            if valid_rows as f32 == count { Ok(valid_rows) } else { Err(error()) }
        });
        // Rows after the last valid row are padding. Their classes need not be valid.
        let valid_rows = counted_rows.transpose()?.unwrap_or(rows);
        let (box_numbers, score_numbers, class_numbers) =
            (boxes.numbers()?, scores.numbers()?, classes.numbers()?);
        for ((numbers, score), class) in
            box_numbers.chunks_exact(4).zip(score_numbers.iter()).zip(class_numbers.iter()).take(valid_rows)
        {
            if *score > self.detection.score_threshold {
                self.add(self.class_index(classes.name, *class)?, *score, first_four(numbers));
            }
        }
        Ok(())
    }

    /// Converts the number of a class in an output to the index of the class's label.
    fn class_index(&self, name: &str, class: f32) -> Result<usize, OutputError> {
        let labels = self.label_count();
        // The cast saturates and drops fractions. The comparison with `class` accepts only whole numbers.
        let index = class as usize;
        if index < labels && index as f32 == class {
            Ok(index)
        } else {
            Err(OutputError::UnknownClass { name: name.to_owned(), class, labels })
        }
    }
}

/// Converts the numbers of a box to pixels of the input.
fn rectangle(format: BoxFormat, [a, b, c, d]: [f32; 4], (x, y): (f32, f32)) -> Rectangle {
    let (left, top, right, bottom) = match format {
        BoxFormat::Cxcywh => (a - c / 2.0, b - d / 2.0, a + c / 2.0, b + d / 2.0),
        BoxFormat::Xyxy => (a, b, c, d),
        BoxFormat::Xywh => (a, b, a + c, b + d),
        BoxFormat::Yxyx => (b, a, d, c),
    };
    Rectangle { left: left * x, top: top * y, right: right * x, bottom: bottom * y }
}

/// Returns the first four of at least four numbers.
fn first_four(numbers: &[f32]) -> [f32; 4] {
    [numbers[0], numbers[1], numbers[2], numbers[3]]
}

/// Returns the index of the largest score, and this score; the first of several equal scores. Returns 0 and minus
/// infinity if there are no scores.
fn best(scores: &[f32]) -> (usize, f32) {
    let mut best = (0, f32::NEG_INFINITY);
    for (class, score) in scores.iter().enumerate() {
        if *score > best.1 {
            best = (class, *score);
        }
    }
    best
}

/// Returns the softmax score of `logit`, which is one of `logits`.
fn softmax(logits: &[f32], logit: f32) -> f32 {
    // The greatest logit is subtracted, so that `exp` is never infinite. The subtraction does not change the result.
    let (_, greatest) = best(logits);
    let sum: f32 = logits.iter().map(|other| (other - greatest).exp()).sum();
    (logit - greatest).exp() / sum
}

/// Returns the score that belongs to a number of the model. `activation` is never `Softmax`: the card's check excludes
/// `Softmax` for YOLO's outputs, and `read_detr` calls this function only with `Sigmoid`.
fn activate(activation: Activation, number: f32) -> f32 {
    match activation {
        Activation::Sigmoid => 1.0 / (1.0 + (-number).exp()),
        Activation::None | Activation::Softmax => number,
    }
}
