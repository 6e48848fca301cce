//! A session of ONNX Runtime. Each worker has its own session.
//!
//! `ort` needs `&mut` access to run a session, because parts of the library are not safe under concurrent runs.
//! Therefore two workers cannot use one session. [`SharedModel`] lets the sessions share the weights.

use ort::session::Session;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};

use super::library::Runtime;
use super::shared_model::SharedModel;
use super::{ModelSettings, card_match};
use crate::LoadError;

/// Opens a session and checks that the model matches its card.
pub(super) fn open(
    settings: &ModelSettings,
    runtime: &Runtime,
    shared: Option<&SharedModel>,
) -> Result<Session, LoadError> {
    let session = build(settings, runtime, shared).map_err(|error| session_error(settings, &error))?;
    let is_batched = settings.batching.is_on();
    let checked = card_match::check(&settings.card, session.inputs(), session.outputs()).and_then(|()| {
        if is_batched { card_match::check_batch(&settings.card, session.inputs()) } else { Ok(()) }
    });
    match checked {
        Ok(()) => Ok(session),
        Err(error) => Err(LoadError::File { file: settings.file.clone(), reason: error.to_string() }),
    }
}

fn build(settings: &ModelSettings, runtime: &Runtime, shared: Option<&SharedModel>) -> ort::Result<Session> {
    let builder = builder(settings, runtime)?;
    // Other programs may delete temporary folders. A worker that is rebuilt later then opens the original file.
    match shared.filter(|shared| shared.file().exists()) {
        Some(shared) => {
            let level = GraphOptimizationLevel::Disable; // the shared model is already optimised
            builder.with_optimization_level(level)?.commit_from_file(shared.file())
        }
        None => {
            builder.with_optimization_level(GraphOptimizationLevel::All)?.commit_from_file(&settings.file)
        }
    }
}

/// Returns the settings that all sessions of a model have in common.
pub(super) fn builder(settings: &ModelSettings, runtime: &Runtime) -> ort::Result<SessionBuilder> {
    let mut builder =
        SessionBuilder::new(runtime.environment())?.with_intra_threads(settings.intra_threads)?;
    if settings.inter_threads > 1 {
        builder = builder.with_parallel_execution(true)?.with_inter_threads(settings.inter_threads)?;
    }
    if let Some(provider) = settings.device.provider() {
        // With these two settings, the whole model runs on the device, or the session cannot be opened.
        builder = builder.with_execution_providers([provider])?.with_disable_cpu_fallback()?;
    }
    Ok(builder)
}

pub(super) fn session_error(settings: &ModelSettings, error: &ort::Error) -> LoadError {
    LoadError::Session {
        file: settings.file.clone(),
        device: settings.device.to_string(),
        reason: reason(&error.to_string()),
    }
}

/// Returns the message of ONNX Runtime in one line, without the position in its source code. Adds what to do if a
/// library was not loaded or if the file has a newer format.
fn reason(text: &str) -> String {
    // As in "…/info.cc:63 static … [ONNXRuntimeError] : 1 : FAIL : options.h:187 Parse Failed to parse …: Invalid
    // device ID: 7".
    let message = text.rsplit_once("[ONNXRuntimeError] : ").map_or(text, |(_, message)| message);
    let message = message
        .split_once(" : ")
        .filter(|(code, _)| code.parse::<u32>().is_ok())
        .map_or(message, |(_, text)| text);
    let line = message.split_whitespace().collect::<Vec<_>>().join(" ");
    // As in "…/model.cc:256 onnxruntime::Model::Model(…) Unsupported model IR version: 14, max supported IR version:
    // 13".
    let newer_format = line.find("Unsupported model IR version").map(|start| &line[start..]);
    if let Some(message) = newer_format {
        let supported = message.rsplit(' ').next().unwrap_or_default();
        format!(
            "{message}; save it with Python's onnx package after `model.ir_version = {supported}`, or install a newer ONNX Runtime"
        )
    } else if line.contains("Failed to load library") {
        format!("{line}; check that the device's own libraries, such as CUDA's, are in LD_LIBRARY_PATH")
    } else {
        line
    }
}

#[cfg(test)]
mod tests {
    use super::reason;

    #[test]
    fn library_error_is_one_line_without_source_location() {
        let message = "/onnxruntime_src/cuda_execution_provider_info.cc:63 static onnxruntime::Info [ONNXRuntimeError] : 1 : FAIL : \
                    options.h:187 Parse Failed to parse provider option \"device_id\": Invalid device ID: 7, must be between 0 \
                    (inclusive) and 1 (exclusive).\n";
        let short = "FAIL : options.h:187 Parse Failed to parse provider option \"device_id\": Invalid device ID: 7, must be between 0 \
                     (inclusive) and 1 (exclusive).";
        assert_eq!(reason(message), short);
        let library = "[ONNXRuntimeError] : 1 : FAIL : Failed to load library /opt/libcuda.so with error: file too short";
        assert!(reason(library).ends_with(
            "file too short; check that the device's own libraries, such as CUDA's, are in LD_LIBRARY_PATH"
        ));
        assert_eq!(reason("no such operator"), "no such operator");
    }
}
