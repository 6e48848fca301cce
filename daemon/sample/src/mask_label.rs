//! Label with the class of each pixel of a picture: the expected answer of a segmentation.

use serde::{Deserialize, Serialize};

/// Expected answer of a segmentation, as the label of a sample in JSON: `{"mask": "data/masks/street-1.png"}`.
// The label names the mask and does not contain it, because labels are sent with their samples.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskLabel {
    /// Path of the mask on the host of the sensor: an indexed or grey PNG file whose pixel values are class numbers.
    pub mask: String,
}

impl MaskLabel {
    /// Reads the label of a sample. Returns `None` if the label has another form, such as the name of a class.
    pub fn parse(label: &str) -> Option<Self> {
        label.starts_with('{').then(|| serde_json::from_str(label).ok())?
    }

    /// Returns the text of the label.
    pub fn format(&self) -> String {
        // Writing a string as JSON cannot fail.
        serde_json::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mask_round_trips_as_label() {
        let label = MaskLabel { mask: "masks/a \"b\".png".to_owned() };
        assert_eq!(MaskLabel::parse(&label.format()), Some(label));
        for other in ["good", "", "{", r#"{"objects": [], "width": 4, "height": 3}"#, r#"{"mask": 3}"#] {
            assert_eq!(MaskLabel::parse(other), None, "{other}");
        }
    }
}
