//! `sensor` and `transforms` in the configuration of a pipeline.

use std::path::PathBuf;

use peernet_external::exec::{ExecConfig, FingerprintKey, Role};
use peernet_external::hide_values;
use peernet_external::python::PythonConfig;
use peernet_imaging::Filter;
use serde::{Deserialize, Serialize};

/// `sensor` in the configuration of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum SensorConfig {
    /// Pictures from files, sent as they are.
    ///
    /// Their labels come from the file `labels`, otherwise from `labels.csv` in the folder where there is one, otherwise
    /// from the name of the folder below `path` that a picture lies in.
    Images {
        /// A picture, or a folder that is searched with all folders below it for `.jpg`, `.jpeg` and `.png`.
        path: PathBuf,
        /// In which order.
        #[serde(default)]
        order: Order,
        /// What the order `shuffled` follows from.
        #[serde(default = "one")]
        seed: u64,
        /// Begin again after the last picture; when shuffled, in a new order.
        #[serde(default = "yes")]
        repeat: bool,
        /// A file of labels, wherever it lies: comma-separated, with the columns `file` (below `path`) and `label`. It may
        /// hold more files than there are.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        labels: Option<PathBuf>,
    },
    /// Random letters and digits, for ever, another text each time: what was published as "random string".
    Text {
        /// Characters of every sample, one byte each.
        length: usize,
        /// What the text follows from.
        #[serde(default = "one")]
        seed: u64,
    },
    /// A program of your own: docs/external-programs.md.
    Exec(ExecConfig),
    /// A Python object of your own with `sample()`: docs/python.md.
    Python(PythonConfig),
    /// Random bytes, for ever: made once per size, so that a sample costs nothing.
    Synthetic {
        /// Payload of every sample, in bytes. Give this or `sizes_bytes`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        size_bytes: Option<usize>,
        /// Payloads of successive samples, in bytes, over and over: a size sweep.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        sizes_bytes: Vec<usize>,
        /// What the bytes follow from.
        #[serde(default = "one")]
        seed: u64,
    },
}

impl SensorConfig {
    /// What tells programs with different arguments apart, as a fact; the arguments themselves may be secret.
    pub fn arguments(&self, key: &FingerprintKey) -> Option<(String, String)> {
        match self {
            Self::Exec(config) => config.arguments(Role::Sensor, key),
            Self::Python(_) | Self::Images { .. } | Self::Text { .. } | Self::Synthetic { .. } => None,
        }
    }

    /// Takes out what may not be published: the values of `env`.
    pub fn hide_secrets(&mut self) {
        match self {
            Self::Exec(config) => hide_values(&mut config.env),
            Self::Python(config) => hide_values(&mut config.env),
            Self::Images { .. } | Self::Text { .. } | Self::Synthetic { .. } => {}
        }
    }
}

/// Order of the pictures of a folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// By path, as bytes.
    #[default]
    Name,
    /// As the seed decides, anew each round.
    Shuffled,
}

/// One of `transforms` in the configuration of a pipeline; they are applied in their order.
///
/// `resize`, `crop` and `decode` leave decoded pixels (of a file: in colour): put an `encode` after them to send a
/// small file again. Each changes every picture of the sample and leaves its other parts as they are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum TransformConfig {
    /// Scales a picture to exactly this size, decoding it first where needed.
    Resize {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// How pixels are combined.
        #[serde(default)]
        filter: Filter,
    },
    /// Cuts a rectangle out of a picture, decoding it first where needed.
    Crop {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// Left edge in pixels; without it the rectangle is centred.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        x: Option<u32>,
        /// Upper edge in pixels; without it the rectangle is centred.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        y: Option<u32>,
    },
    /// Compresses a picture; one that is a file already is decoded first and compressed anew.
    Encode {
        /// Into which kind of file.
        format: Format,
        /// 1 to 100, of JPEG alone; 85 unless given.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        quality: Option<u8>,
    },
    /// Decodes a picture into pixels.
    Decode {},
}

/// Formats of picture files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// Lossy, small.
    Jpeg,
    /// Lossless.
    Png,
}

const fn one() -> u64 {
    1
}

const fn yes() -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    struct Pipeline {
        sensor: SensorConfig,
        #[serde(default)]
        transforms: Vec<TransformConfig>,
    }

    #[test]
    fn the_documented_forms_are_read() {
        let pipeline: Pipeline = toml::from_str(
            "sensor = { kind = \"images\", path = \"pictures\", order = \"shuffled\", seed = 7 }\n\
             transforms = [ { kind = \"resize\", width = 320, height = 240, filter = \"bilinear\" }, \
             { kind = \"crop\", width = 10, height = 10 }, { kind = \"encode\", format = \"jpeg\", quality = 85 }, \
             { kind = \"decode\" } ]",
        )
        .expect("reads");
        let images = SensorConfig::Images {
            path: "pictures".into(),
            order: Order::Shuffled,
            seed: 7,
            repeat: true,
            labels: None,
        };
        assert_eq!(pipeline.sensor, images);
        assert_eq!(
            pipeline.transforms[0],
            TransformConfig::Resize { width: 320, height: 240, filter: Filter::Bilinear }
        );
        assert_eq!(pipeline.transforms[3], TransformConfig::Decode {});
    }

    #[test]
    fn a_misspelt_key_is_refused_by_name() {
        for text in [
            "sensor = { kind = \"images\", path = \"p\", sed = 1 }",
            "sensor = { kind = \"synthetic\", sized_bytes = 1 }",
            "sensor = { kind = \"images\", path = \"p\" }\ntransforms = [{ kind = \"decode\", quality = 3 }]",
        ] {
            let error = toml::from_str::<Pipeline>(text).expect_err("has an unknown key").to_string();
            assert!(error.contains("unknown field"), "{error}");
        }
    }
}
