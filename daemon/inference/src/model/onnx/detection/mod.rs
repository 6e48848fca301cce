//! Conversion of a detector's outputs to its answer.

mod layouts;
mod nms;

use serde::Serialize;

use super::card::Detection;
use super::geometry::PictureTransform;
use super::outputs::{OutputError, Outputs};
use layouts::CandidateReader;
use nms::{Rectangle, keep_best};

/// Answer of a detector, as JSON: `{"detections": [{"label": "dented", "score": 0.98, "box": [12.5, 40, 81, 96.25]},
/// …], "width": 1280, "height": 960}`.
#[derive(Debug, Serialize)]
struct Answer<'a> {
    /// The objects, the one with the highest score first.
    detections: Vec<DetectedObject<'a>>,
    /// Width of the sample's picture, pixels.
    width: u32,
    /// Height of the sample's picture, pixels.
    height: u32,
}

#[derive(Debug, Serialize)]
struct DetectedObject<'a> {
    label: &'a str,
    /// Score, from 0 to 1.
    score: f32,
    /// Left, top, right and bottom edge in the sample's picture, pixels.
    #[serde(rename = "box")]
    edges: [f32; 4],
}

/// Returns the answer, with boxes in pixels of the sample's picture.
///
/// # Errors
/// If an output does not have the shape of its layout, contains NaN or an infinite score, or names a class without
/// label.
pub(super) fn detect(
    detection: &Detection,
    outputs: &Outputs<'_, '_>,
    transform: &PictureTransform,
) -> Result<Vec<u8>, OutputError> {
    let mut candidates = CandidateReader::read(detection, outputs, transform.input)?;
    if let Some(candidate) = candidates.iter().find(|candidate| !candidate.score.is_finite()) {
        let name = detection.outputs.scores().to_owned();
        return Err(OutputError::NotFinite { name, number: candidate.score });
    }
    keep_best(&mut candidates, detection.iou_threshold, detection.max_detections);
    let objects = candidates.iter().filter_map(|candidate| {
        let edges = in_picture(candidate.rectangle, transform)?;
        let label = detection.labels.get(candidate.class)?;
        Some(DetectedObject { label, score: candidate.score, edges })
    });
    let (width, height) = transform.picture;
    Ok(serde_json::to_vec(&Answer { detections: objects.collect(), width, height })?)
}

/// Checks the types and shapes of the outputs that a session computes from zeros while it is warmed up. The numbers in
/// these outputs mean nothing and are not checked.
pub(super) fn check(
    detection: &Detection,
    outputs: &Outputs<'_, '_>,
    input: (u32, u32),
) -> Result<(), OutputError> {
    match CandidateReader::read(detection, outputs, input) {
        // These errors are about the numbers of an output.
        Ok(_)
        | Err(OutputError::NotANumber(_) | OutputError::UnknownClass { .. } | OutputError::RowCount { .. }) => {
            Ok(())
        }
        Err(error) => Err(error),
    }
}

/// Returns the edges of a box in the picture; `None` if the box is outside of the picture, or an edge is NaN.
fn in_picture(rectangle: Rectangle, transform: &PictureTransform) -> Option<[f32; 4]> {
    let Rectangle { left, top, right, bottom } = rectangle;
    let ((left, top), (right, bottom)) =
        (transform.to_picture((left, top)), transform.to_picture((right, bottom)));
    let (width, height) = (transform.picture.0 as f32, transform.picture.1 as f32);
    let edges =
        [left.clamp(0.0, width), top.clamp(0.0, height), right.clamp(0.0, width), bottom.clamp(0.0, height)];
    // A NaN fails each comparison.
    (edges[0] < edges[2] && edges[1] < edges[3]).then_some(edges)
}
