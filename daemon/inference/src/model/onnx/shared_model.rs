//! One copy of a model's weights for several workers.
//!
//! Optimising a model rearranges its weights, so each session that optimises has its own copy. Sharing prepacked
//! weights between sessions does not avoid these copies. With a ResNet-50 of 94 MB each further worker took another 120
//! MB. Therefore the model is optimised once and written to a temporary folder, with its weights in a separate file.
//! Each session maps that file, and the kernel keeps one copy for all sessions: a further worker takes 10 MB and is
//! ready after 55 ms instead of 350 ms.

use std::path::PathBuf;

use ort::logging::LogLevel;
use ort::session::builder::GraphOptimizationLevel;

use super::device::Device;
use super::library::Runtime;
use super::{MODEL, ModelSettings, session};
use crate::temp_dirs::TempDirs;
use crate::{LoadError, LockedTempDir};

/// Initialisers (constant tensors) with fewer bytes stay in the model's file.
const MIN_SHARED_BYTES: &str = "1024";

/// Optimised model on disk; dropping the value deletes the files.
pub(super) struct SharedModel {
    /// Folder of the optimised model.
    folder: LockedTempDir,
    /// Temporary folders of all models, which the end of the process deletes; `folder` is one of them.
    temp_dirs: TempDirs,
}

impl Drop for SharedModel {
    fn drop(&mut self) {
        self.temp_dirs.deregister(self.folder.path());
    }
}

impl SharedModel {
    /// Optimises the model for this machine. Returns `None` if nothing would be shared: with one worker, and on devices
    /// other than the CPU, whose own memory holds a copy for each session in any case.
    pub(super) fn prepare(
        settings: &ModelSettings,
        runtime: &Runtime,
        temp_dirs: &TempDirs,
    ) -> Result<Option<Self>, LoadError> {
        if settings.workers < 2 || settings.device != Device::Cpu {
            return Ok(None);
        }
        let folder = LockedTempDir::new("model").map_err(|error| LoadError::File {
            file: std::env::temp_dir(),
            reason: format!(
                "{error}; several workers share a model through a temporary folder: set TMPDIR or workers = 1"
            ),
        })?;
        temp_dirs.register(folder.path());
        let shared = Self { folder, temp_dirs: temp_dirs.clone() };
        shared.write(settings, runtime).map_err(|error| session::session_error(settings, &error))?;
        Ok(Some(shared))
    }

    /// Returns the path of the optimised model.
    pub(super) fn file(&self) -> PathBuf {
        self.folder.path().join(MODEL)
    }

    fn write(&self, settings: &ModelSettings, runtime: &Runtime) -> ort::Result<()> {
        session::builder(settings, runtime)?
            .with_optimization_level(GraphOptimizationLevel::All)?
            .with_optimized_model_path(self.file())?
            .with_config_entry("session.optimized_model_external_initializers_file_name", "weights.bin")?
            .with_config_entry(
                "session.optimized_model_external_initializers_min_size_in_bytes",
                MIN_SHARED_BYTES,
            )?
            // The library would warn that the result suits this machine only, which is intended.
            .with_log_level(LogLevel::Error)?
            .commit_from_file(&settings.file)
            .map(drop)
    }
}
