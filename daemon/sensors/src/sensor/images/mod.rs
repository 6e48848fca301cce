//! Sensor kind `images`: pictures from files, without any change.

mod data_set;
mod folder;
mod labels;

use std::collections::{BTreeSet, HashMap};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use peernet_clock::SharedClock;
use peernet_external::describe_with_hash;
use peernet_imaging::{Header, ImageError, probe};
use peernet_logger::{Recorder, fact};
use peernet_sample::{Description, MaskLabel, MediaType, ObjectsLabel, Sample, list_examples};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use super::{SensorConfig, SensorKind, default_seed};
use crate::{Sensor, SensorError, file, read_mask};
use labels::Label;

/// Configuration of the sensor: `{ kind = "images", … }`.
///
/// Labels come from the file `labels`, otherwise from `labels.csv` in the folder if it exists, otherwise from the
/// name of the folder below `path` that contains the picture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImagesConfig {
    /// A picture, or a folder that is searched for `.jpg`, `.jpeg` and `.png` files with all folders below it.
    pub path: PathBuf,
    /// Order of the pictures. Default: `name`.
    #[serde(default)]
    pub order: Order,
    /// Seed of the order `shuffled`. Default: 1.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// `true` to begin again after the last picture; the order `shuffled` then shuffles again. Default: `true`.
    #[serde(default = "default_true")]
    pub repeat: bool,
    /// File with labels, in any folder. It is comma-separated and has the columns `file` (path below `path`) and
    /// `label`, and for boxes of objects also `left`, `top`, `right` and `bottom`; or it has the columns `file` and
    /// `mask`. It may list files that are not in the folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub labels: Option<PathBuf>,
}

/// Order of the pictures of a folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// By path, as bytes.
    #[default]
    Name,
    /// In a random order that depends on the seed and is different in each round through the pictures.
    Shuffled,
}

const fn default_true() -> bool {
    true
}

impl ImagesConfig {
    /// Returns the configuration of pictures with all defaults.
    fn new(path: PathBuf) -> Self {
        Self { path, order: Order::default(), seed: default_seed(), repeat: default_true(), labels: None }
    }
}

impl SensorKind for ImagesConfig {
    fn open(&self, _clock: &SharedClock) -> Result<Box<dyn Sensor>, SensorError> {
        Ok(Box::new(ImagesSensor::open(self)?))
    }
}

impl SensorConfig {
    /// Returns the configuration of a picture, or of the pictures in a folder in the order of their names, repeated.
    pub fn pictures(path: PathBuf) -> Self {
        ImagesConfig::new(path).into()
    }

    /// Returns the configuration of a picture, or of the pictures in a folder in the order of their names, each once.
    pub fn pictures_once(path: PathBuf) -> Self {
        ImagesConfig { repeat: false, ..ImagesConfig::new(path) }.into()
    }
}

/// Sensor with a list of picture files. It reads a file when the sample is requested.
struct ImagesSensor {
    path: PathBuf,
    pictures: Vec<Picture>,
    /// File from which the labels were read.
    labels_file: Option<PathBuf>,
    /// Index of the next picture.
    next: usize,
    /// Random numbers for shuffling before every round; `None` keeps the order of names.
    shuffle_rng: Option<StdRng>,
    repeat: bool,
}

/// A picture file with its label.
struct Picture {
    file: PathBuf,
    media: MediaType,
    /// Path below the folder.
    source: String,
    label: Option<Label>,
}

impl Label {
    /// Returns the names of the classes in the label.
    fn classes(&self) -> Vec<&str> {
        match self {
            Self::Class(class) => vec![class],
            // A mask has class numbers and no names.
            Self::Mask(_) => Vec::new(),
            Self::Objects(objects) => objects.iter().map(|object| object.label.as_str()).collect(),
        }
    }

    /// Returns the path of the mask, if the label is a mask.
    fn mask(&self) -> Option<&Path> {
        match self {
            Self::Mask(mask) => Some(Path::new(mask)),
            _ => None,
        }
    }

    /// Returns the text of the label, for the sample whose picture is `file`.
    ///
    /// # Errors
    /// If the label has boxes and the size cannot be read from the header of the file.
    fn text(&self, file: &[u8]) -> Result<String, ImageError> {
        match self {
            Self::Class(class) => Ok(class.clone()),
            Self::Mask(mask) => Ok(MaskLabel { mask: mask.clone() }.format()),
            // The label contains the size that its boxes refer to, because a transform may resize the picture.
            Self::Objects(objects) => {
                let Header { width, height, .. } = probe(file)?;
                Ok(ObjectsLabel { objects: objects.clone(), width, height }.format())
            }
        }
    }
}

impl ImagesSensor {
    fn open(config: &ImagesConfig) -> Result<Self, SensorError> {
        let (path, labels) = (config.path.as_path(), config.labels.as_deref());
        let metadata =
            fs::metadata(path).map_err(|error| SensorError::Read { path: path.to_owned(), error })?;
        let (pictures, labels_file) =
            if metadata.is_dir() { read_folder(path, labels)? } else { read_single(path, labels)? };
        let mut images = Self {
            path: path.to_owned(),
            pictures,
            labels_file,
            next: 0,
            shuffle_rng: (config.order == Order::Shuffled).then(|| StdRng::seed_from_u64(config.seed)),
            repeat: config.repeat,
        };
        // The first round is shuffled, too: `sample` shuffles only before later rounds.
        images.shuffle();
        Ok(images)
    }

    fn shuffle(&mut self) {
        if let Some(random) = &mut self.shuffle_rng {
            self.pictures.shuffle(random);
        }
    }

    /// Returns the path of a file below the folder; for a single picture the name of the file.
    fn name_in_data_set<'a>(&self, file: &'a Path) -> &'a OsStr {
        let below = file.strip_prefix(&self.path).ok().filter(|below| *below != Path::new(""));
        below.map_or_else(|| file.file_name().unwrap_or_default(), Path::as_os_str)
    }

    /// Returns the number of pictures with a label, and some of the labels: `100 of 100: dented, good`.
    fn describe_labels(&self) -> String {
        let all: Vec<&Label> = self.pictures.iter().filter_map(|picture| picture.label.as_ref()).collect();
        let count = format!("{} of {}", all.len(), self.pictures.len());
        let classes: BTreeSet<&str> = all.into_iter().flat_map(Label::classes).collect();
        if classes.is_empty() { count } else { format!("{count}: {}", list_examples(classes)) }
    }
}

impl Sensor for ImagesSensor {
    fn sample(&mut self, _recorder: &mut Recorder) -> Result<Option<Sample>, SensorError> {
        if self.next == self.pictures.len() {
            if !self.repeat {
                return Ok(None);
            }
            self.next = 0;
            self.shuffle();
        }
        let picture = &self.pictures[self.next];
        // The index is incremented before reading, so that the next call does not try an unreadable picture again.
        self.next += 1;
        let bytes = file::read(&picture.file)?;
        let mut sample = Sample::from_part(Description::unshaped(picture.media.clone()), Bytes::from(bytes));
        sample.source.clone_from(&picture.source);
        sample.label =
            picture.label.as_ref().map(|label| label.text(&sample.parts[0].bytes)).transpose().map_err(
                |error| SensorError::Read { path: picture.file.clone(), error: std::io::Error::other(error) },
            )?;
        Ok(Some(sample))
    }

    fn facts(&self) -> Vec<(String, String)> {
        let count = self.pictures.len();
        let order = if self.shuffle_rng.is_some() { "shuffled" } else { "by name" };
        let times = if self.repeat { "repeated" } else { "once" };
        let noun = if count == 1 { "image" } else { "images" };
        let images = format!("{count} {noun} of {}, {order}, {times}", self.path.display());
        let files = self
            .pictures
            .iter()
            .map(|picture| (self.name_in_data_set(&picture.file), picture.file.as_path()));
        let mut facts = vec![
            ("Sensor".to_owned(), images),
            ("Data set".to_owned(), data_set::describe_files(files)),
            (fact::LABELS.to_owned(), self.describe_labels()),
        ];
        let masks = self.pictures.iter().filter_map(|picture| picture.label.as_ref()?.mask());
        let masks: Vec<_> = masks.map(|mask| (self.name_in_data_set(mask), mask)).collect();
        if !masks.is_empty() {
            facts.push(("Masks".to_owned(), data_set::describe_files(masks.into_iter())));
        }
        facts.extend(
            self.labels_file.as_deref().map(|file| ("Labels file".to_owned(), describe_with_hash(file))),
        );
        facts
    }
}

/// Pictures, and the file from which their labels were read.
type LabelledPictures = (Vec<Picture>, Option<PathBuf>);

/// Returns the pictures in a folder, with the labels from the configured file, from `labels.csv` in the folder, or from
/// the names of the folders.
fn read_folder(path: &Path, configured_file: Option<&Path>) -> Result<LabelledPictures, SensorError> {
    let mut files = folder::pictures(path)?;
    let (mut labels, origin) = labels::read(path, configured_file)?.unzip();
    // Masks may be in the same folder and are not pictures of the data set.
    let masks: BTreeSet<PathBuf> =
        labels.iter().flat_map(HashMap::values).filter_map(|label| Some(label.mask()?.to_owned())).collect();
    files.retain(|file| !masks.contains(file));
    if files.is_empty() {
        return Err(SensorError::Empty(path.to_owned()));
    }
    if let Some(mask) = masks.first() {
        // A mask of a wrong type is reported at once, and not after the first answer. Only the first mask is checked.
        read_mask(mask)?;
    }
    let pictures: Vec<_> = files
        .into_iter()
        .filter_map(|file| {
            let media = folder::media_type(&file)?;
            let below = file.strip_prefix(path).unwrap_or(&file);
            let source = below.to_string_lossy().into_owned();
            // Without a file with labels, the label of a picture is the name of its folder below `path`.
            let label = match &mut labels {
                Some(labels) => labels.remove(&source),
                None => below
                    .iter()
                    .rev()
                    .nth(1)
                    .map(|folder| Label::Class(folder.to_string_lossy().into_owned())),
            };
            Some(Picture { media, source, label, file })
        })
        .collect();
    let has_labels = pictures.iter().any(|picture| picture.label.is_some());
    match (labels.and_then(|unused| unused.into_keys().min()), configured_file) {
        // Only a configured file may label pictures that are not in the folder, because it may belong to a larger data
        // set.
        (Some(missing), None) => Err(SensorError::Labels {
            file: path.join(labels::LABELS_FILE),
            reason: format!("it labels {missing}, which is not among the pictures of the folder"),
        }),
        (Some(other), Some(file)) if !has_labels => Err(SensorError::Labels {
            file: file.to_owned(),
            reason: format!(
                "it labels no picture of {}; it labels {other}, for example; write paths below that folder",
                path.display()
            ),
        }),
        _ => Ok((pictures, origin)),
    }
}

/// Returns a single picture with its label.
fn read_single(file: &Path, configured_file: Option<&Path>) -> Result<LabelledPictures, SensorError> {
    let media = folder::media_type(file).filter(|_| folder::is_file(file));
    let media = media.ok_or_else(|| SensorError::NotAPicture(file.to_owned()))?;
    let source = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    // A `labels.csv` next to a single picture may label other pictures of the folder, too, so unused labels are no
    // error.
    let (labels, origin) =
        file.parent().map_or(Ok(None), |folder| labels::read(folder, configured_file))?.unzip();
    let label = labels.and_then(|mut labels| labels.remove(&source));
    Ok((vec![Picture { file: file.to_owned(), media, source, label }], origin))
}
