//! The card of a model, `model.toml`: the conversion of samples to the model's inputs, and of the model's outputs to
//! answers.

mod detection;
mod error;
mod input;
mod output;
mod preprocessing;
#[cfg(test)]
pub(super) mod tests;

pub(super) use detection::{BoxFormat, BoxUnit, Detection, DetectionOutputs};
pub(super) use error::ModelCardError;
pub(super) use input::{Input, PictureSource, Source};
pub(super) use output::{Activation, Classification, Embedding, Segmentation, TensorOutput};
pub(super) use preprocessing::{CentreCrop, Colour, Layout, Normalisation, Position, Resize, Rounding};

use std::fmt;
use std::io::{self, Read};
use std::marker::PhantomData;
use std::path::Path;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{DeserializeOwned, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::regular_file;
use crate::LoadError;
use detection::DetectionTable;
use input::InputTable;
use preprocessing::Preprocessing;

/// Maximum size of a card, bytes. A thousand labels take some ten kilobytes.
const MAX_CARD_BYTES: u64 = 1 << 20;

/// Card of a model. To add a model, one writes a card and no code.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Card {
    pub(super) name: String,
    pub(super) description: String,
    pub(super) version: String,
    /// The model's inputs. The parts of a sample fill the inputs that are not constants, in this order.
    pub(super) inputs: Vec<Input>,
    pub(super) task: Task,
    /// Origin of the model, for people, in any form.
    pub(super) provenance: toml::Table,
}

/// Kind of the answers, with the names of the model's outputs and the settings of their conversion.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Task {
    Classification(Classification),
    Detection(Detection),
    Segmentation(Segmentation),
    Embedding(Embedding),
    /// Outputs that the answer contains unchanged, in this order.
    Tensors(Vec<TensorOutput>),
}

/// The `task` of a card.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum TaskName {
    Classification,
    Detection,
    Segmentation,
    Embedding,
    Tensors,
}

/// The key of a card that determines which keys `[output]` has.
#[derive(Deserialize)]
struct Header {
    task: TaskName,
}

/// The file of a card. `O` is the form of `[output]`, which depends on the task.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct CardFile<O> {
    name: String,
    #[expect(dead_code, reason = "`Header` reads this key")]
    task: TaskName,
    #[serde(default)]
    description: String,
    #[serde(default)]
    version: String,
    input: OneOrMany<InputTable>,
    /// Preprocessing of those pictures whose `[input]` has no preprocessing.
    preprocessing: Option<Preprocessing>,
    output: O,
    #[serde(default)]
    provenance: toml::Table,
}

/// A table, or a list of tables.
#[derive(Debug)]
struct OneOrMany<T>(Vec<T>);

fn read_text(file: &Path) -> io::Result<String> {
    let mut file = regular_file::open(file)?;
    let length = file.metadata()?.len();
    if length > MAX_CARD_BYTES {
        return Err(io::Error::other(format!("it has {length} bytes, the limit is {MAX_CARD_BYTES}")));
    }
    let mut text = String::new();
    file.read_to_string(&mut text)?;
    Ok(text)
}

impl Card {
    /// Reads and checks a card.
    pub(super) fn read(file: &Path) -> Result<Self, LoadError> {
        let file_error = |reason: String| LoadError::File { file: file.to_owned(), reason };
        let text = read_text(file).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => file_error(format!(
                "{error}; write a card for the model (docs/models.md), or correct the path of its folder"
            )),
            _ => file_error(error.to_string()),
        })?;
        Self::parse(&text).map_err(|error| file_error(error.to_string()))
    }

    pub(super) fn parse(text: &str) -> Result<Self, ModelCardError> {
        // Only the task is read here. `parse_as` parses the whole text again, so that errors name the lines of the
        // text.
        let Header { task } = toml::from_str(text)?;
        match task {
            TaskName::Classification => Self::parse_as(text, |output: Classification| {
                output.check()?;
                Ok(Task::Classification(output))
            }),
            TaskName::Detection => {
                Self::parse_as(text, |output: DetectionTable| output.try_into().map(Task::Detection))
            }
            TaskName::Segmentation => Self::parse_as(text, |output: Segmentation| {
                output.check()?;
                Ok(Task::Segmentation(output))
            }),
            TaskName::Embedding => Self::parse_as(text, |output| Ok(Task::Embedding(output))),
            TaskName::Tensors => Self::parse_as(text, |OneOrMany(outputs)| {
                output::check_tensors(&outputs)?;
                Ok(Task::Tensors(outputs))
            }),
        }
    }

    fn parse_as<O: DeserializeOwned>(
        text: &str,
        task: impl FnOnce(O) -> Result<Task, ModelCardError>,
    ) -> Result<Self, ModelCardError> {
        let file: CardFile<O> = toml::from_str(text)?;
        let CardFile { name, description, version, input, preprocessing, output, provenance, .. } = file;
        let inputs = Input::from_tables(input.0, preprocessing.as_ref())?;
        let card = Self { name, description, version, inputs, task: task(output)?, provenance };
        // The boxes or pixels of an answer relate to a picture, so one input must be a picture.
        if matches!(card.task, Task::Detection(_) | Task::Segmentation(_)) && card.picture().is_none() {
            return Err(ModelCardError::PictureTask(card.task.name()));
        }
        Ok(card)
    }

    /// Returns the first input that is a picture. The boxes or pixels of an answer relate to this picture.
    pub(super) fn picture(&self) -> Option<&PictureSource> {
        self.inputs.iter().find_map(Input::picture)
    }
}

impl Task {
    /// Returns the task's name in cards.
    pub(super) const fn name(&self) -> &'static str {
        match self {
            Self::Classification(_) => "classification",
            Self::Detection(_) => "detection",
            Self::Segmentation(_) => "segmentation",
            Self::Embedding(_) => "embedding",
            Self::Tensors(_) => "tensors",
        }
    }

    /// Returns the labels of the classes, in the order of the classes' numbers; `None` if the task has no classes.
    pub(super) fn labels(&self) -> Option<&[String]> {
        match self {
            Self::Classification(Classification { labels, .. })
            | Self::Detection(Detection { labels, .. })
            | Self::Segmentation(Segmentation { labels, .. }) => Some(labels),
            Self::Embedding(_) | Self::Tensors(_) => None,
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for OneOrMany<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TablesVisitor<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for TablesVisitor<T> {
            type Value = OneOrMany<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a table or a list of tables")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(|table| OneOrMany(vec![table]))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, tables: A) -> Result<Self::Value, A::Error> {
                Vec::deserialize(SeqAccessDeserializer::new(tables)).map(OneOrMany)
            }
        }

        // The visitor decides by the form of the value. An untagged enum would try both forms, and its errors would not
        // name the key.
        deserializer.deserialize_any(TablesVisitor(PhantomData))
    }
}
