//! Label with the objects in a picture: the expected answer of a detector.

use serde::{Deserialize, Serialize};

/// Expected answer of a detector, as the label of a sample in JSON:
/// `{"objects": [{"label": "dented", "box": [12.5, 40, 81, 96.25]}, …], "width": 1280, "height": 960}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectsLabel {
    /// The objects in the picture; may be empty.
    pub objects: Vec<LabelledObject>,
    /// Width of the picture that the boxes refer to, pixels. The sample's picture may have another size with the same
    /// proportions.
    pub width: u32,
    /// Height of the picture that the boxes refer to, pixels.
    pub height: u32,
}

/// An object in a picture, with its class and its position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LabelledObject {
    /// Class of the object.
    pub label: String,
    /// Left, top, right and bottom edge, pixels.
    #[serde(rename = "box")]
    pub edges: [f32; 4],
}

impl ObjectsLabel {
    /// Reads the label of a sample. Returns `None` if the label has another form, such as the name of a class.
    pub fn parse(label: &str) -> Option<Self> {
        let label: Self = label.starts_with('{').then(|| serde_json::from_str(label).ok())??;
        let is_valid =
            label.width > 0 && label.height > 0 && label.objects.iter().all(LabelledObject::is_valid);
        is_valid.then_some(label)
    }

    /// Returns the text of the label.
    pub fn format(&self) -> String {
        // Writing strings and numbers as JSON cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl LabelledObject {
    /// Returns whether the edges are finite, the left edge is not right of the right edge, and the top edge is not
    /// below the bottom edge.
    pub fn is_valid(&self) -> bool {
        let [left, top, right, bottom] = self.edges;
        self.edges.iter().all(|edge| edge.is_finite()) && left <= right && top <= bottom
    }
}

/// Returns the area of the intersection of two boxes divided by the area of their union, from 0 to 1; 0 if both boxes
/// are empty. Each box has its left, top, right and bottom edge.
pub fn iou(a: [f64; 4], b: [f64; 4]) -> f64 {
    let area = |[left, top, right, bottom]: [f64; 4]| (right - left).max(0.0) * (bottom - top).max(0.0);
    let common = area([a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]);
    let union = area(a) + area(b) - common;
    if union > 0.0 { common / union } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_round_trip_as_label() {
        let object = LabelledObject { label: "hole missing".to_owned(), edges: [1.5, 2.0, 30.0, 4.25] };
        for objects in [vec![], vec![object.clone(), object]] {
            let label = ObjectsLabel { objects, width: 40, height: 30 };
            assert_eq!(ObjectsLabel::parse(&label.format()), Some(label));
        }
    }

    #[test]
    fn label_of_other_form_is_not_parsed() {
        let label_with = |objects: &str| format!(r#"{{"objects": [{objects}], "width": 4, "height": 3}}"#);
        assert!(ObjectsLabel::parse(&label_with(r#"{"label": "a", "box": [0, 0, 1, 1]}"#)).is_some());
        for label in [
            "good".to_owned(),
            String::new(),
            "{".to_owned(),
            "{good}".to_owned(),
            r#"[{"label": "a", "box": [0, 0, 1, 1]}]"#.to_owned(),
            r#"{"objects": []}"#.to_owned(),
            r#"{"objects": [], "width": 0, "height": 3}"#.to_owned(),
            label_with(r#"{"label": "a", "box": [0, 0, 1]}"#),
            label_with(r#"{"label": "a", "box": [2, 0, 1, 1]}"#),
            label_with(r#"{"label": "a"}"#),
        ] {
            assert_eq!(ObjectsLabel::parse(&label), None, "{label}");
        }
    }
}
