//! A model that was unloaded.

use std::fmt;

use peernet_clock::Span;
use peernet_logger::Slug;

/// A model that was unloaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnloadedModel {
    /// Name of the model.
    pub name: Slug,
    /// Device on which the model ran, such as `cpu`.
    pub device: String,
    /// Time for which the model was loaded.
    pub loaded_for: Span,
    /// Decrease of this process's resident memory during the unloading, bytes; `None` if it is unknown. The
    /// decrease may be smaller than the model, because the memory allocator may keep memory for later use.
    pub memory_released: Option<u64>,
    /// Reason for unloading the model.
    pub reason: UnloadReason,
}

/// Reason for unloading a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnloadReason {
    /// The model was unloaded to make room for this requested model, because the maximum number of models was loaded.
    MakesRoomFor(Slug),
    /// The files of the model have changed.
    FilesChanged,
    /// The agent stops.
    Shutdown,
}

impl fmt::Display for UnloadReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MakesRoomFor(model) => write!(f, "to make room for {model}"),
            Self::FilesChanged => f.write_str("because its files have changed"),
            Self::Shutdown => f.write_str("because the agent stops"),
        }
    }
}
