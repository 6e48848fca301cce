//! Names that a program must not use for its stages and values.

use super::super::timeline::MODEL_STAGES;
use super::{FramingError, REWARD_FORM, SUCCESS_FORM};

/// Names of nodes that PEERNet itself records, and of the columns that every `data.csv` has. Programs must not use them.
// Statistics group nodes by name: the figures of a program would be mixed with PEERNet's own.
const RESERVED_NAMES: [&str; 69] = [
    "iteration",
    "sensing",
    "capture",
    "transform",
    "encode",
    "send-queue",
    "upload",
    "queue",
    "batch-wait",
    "download",
    "actuation",
    "total",
    "stages-total",
    "unattributed",
    "ipc",
    "capture-ipc",
    "actuation-ipc",
    "restart",
    "capture-restart",
    "actuation-restart",
    "upload-bytes",
    "upload-logger-bytes",
    "download-bytes",
    "download-logger-bytes",
    "upload-throughput",
    "download-throughput",
    "upload-throughput-lo",
    "upload-throughput-hi",
    "download-throughput-lo",
    "download-throughput-hi",
    "upload-raw",
    "upload-lo",
    "upload-hi",
    "upload-verdict",
    "upload-source",
    "download-raw",
    "download-lo",
    "download-hi",
    "download-verdict",
    "download-source",
    "skipped-nodes",
    "skipped-starts",
    "lateness",
    "deadline-missed",
    "dropped-samples",
    "capture-delay",
    "dropped-answers",
    "parts",
    "parts-sent",
    "first-part",
    "first-part-download",
    "batch-size",
    "at",
    "episode",
    "step",
    "warm-up",
    "outcome",
    "reason",
    "map-50",
    "mean-iou",
    "top-1",
    "top-5",
    "unknown-label",
    "superseded",
    "episode-success",
    "episode-return",
    "reward",
    "success",
    "episode-ended",
];
/// Reserved names for which an actuator writes a separate line, and the form of this line.
const FEEDBACK_FORMS: [(&str, &str); 3] =
    [("reward", REWARD_FORM), ("success", SUCCESS_FORM), ("episode-ended", "episode-ended")];

/// Returns `name` if programs may use it. `allows_model_stages` is `true` for a stage that a model reports.
pub(super) fn check_name(name: &str, allows_model_stages: bool) -> Result<String, FramingError> {
    let is_reserved = RESERVED_NAMES.contains(&name) || !allows_model_stages && MODEL_STAGES.contains(&name);
    if !is_reserved {
        return Ok(name.to_owned());
    }
    match FEEDBACK_FORMS.iter().find(|(reserved, _)| *reserved == name) {
        Some((_, form)) => Err(FramingError::FeedbackName { name: name.to_owned(), form }),
        None => Err(FramingError::Name(name.to_owned())),
    }
}
