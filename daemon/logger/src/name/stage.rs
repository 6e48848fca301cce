//! The standard names of nodes. Code, database, API and pages spell these names the same.

use crate::Name;

macro_rules! standard_names {
    (
        names { $($(#[$doc:meta])* $constant:ident = $name:literal;)* }
        symbols { $($symbol:literal)* }
    ) => {
        $($(#[$doc])* pub const $constant: Name = Name::from_static($name);)*

        /// The standard names that have a number on the wire: the position in this list.
        const NAMES: &[&str] = &[$($name),*];

        /// Returns the static form of a standard name with a number on the wire, or of a standard unit's symbol; `None`
        /// for any other text.
        pub(crate) fn standard(name: &str) -> Option<&'static str> {
            match name {
                $($name => Some($name),)*
                $($symbol => Some($symbol),)*
                _ => None,
            }
        }

        /// Returns the number of a standard name on the wire; `None` for a name that the wire form contains as text.
        pub(crate) fn code(name: &str) -> Option<u8> {
            #[expect(
                non_camel_case_types,
                clippy::upper_case_acronyms,
                reason = "variants are named like the constants"
            )]
            enum Position { $($constant),* }
            match name {
                $($name => Some(Position::$constant as u8),)*
                _ => None,
            }
        }
    };
}

/// Returns whether the stage is a one-way delay between hosts.
pub fn is_one_way(name: &str) -> bool {
    name == UPLOAD.as_str() || name == DOWNLOAD.as_str()
}

/// Returns the standard names that have a number on the wire, in the order of the numbers.
pub fn all() -> impl Iterator<Item = Name> {
    NAMES.iter().copied().map(Name::from_static)
}

/// Returns the standard name whose number on the wire is `code`; `None` if no name has this number.
pub(crate) fn decode(code: u64) -> Option<Name> {
    NAMES.get(usize::try_from(code).ok()?).copied().map(Name::from_static)
}

// The number of a standard name on the wire is its position in this list. New names are therefore added at the end, and
// each addition raises `wire::VERSION`: a reader refuses numbers that it does not know.
standard_names! {
    names {
        /// Root of every tree: the processing of one sample by a pipeline.
        ITERATION = "iteration";
        /// Edge: from the request to the sensor until the sample is ready to send. Parent of `capture` and `transform`.
        SENSING = "sensing";
        /// Edge: the sensor's part of `sensing`.
        CAPTURE = "capture";
        /// Edge: the transforms' part of `sensing`.
        TRANSFORM = "transform";
        /// Edge: conversion of the sample to wire frames.
        ENCODE = "encode";
        /// Edge: from when the sample is ready to send until it is handed to the network, including the wait while too
        /// many iterations are in flight.
        SEND_QUEUE = "send-queue";
        /// Edge to cloud: from when the sample's message is handed to the network until the whole message is received.
        /// The node is a transit whose delay has bounds.
        UPLOAD = "upload";
        /// Cloud or edge: from when the sample is received until a worker starts.
        QUEUE = "queue";
        /// Cloud or edge: preparation of the model's input.
        PREPROCESSING = "preprocessing";
        /// Cloud or edge: execution of the model until the result is available.
        INFERENCE = "inference";
        /// Cloud or edge: conversion of the model's output to an answer.
        POSTPROCESSING = "postprocessing";
        /// Cloud to edge: transit of the answer, defined like `upload`.
        DOWNLOAD = "download";
        /// Edge: from the answer until the actuator is done.
        ACTUATION = "actuation";
        /// Edge: from the intended start to the end of the iteration. The edge's monotonic clock measures both times,
        /// so that `total` contains no error between the clocks of two hosts.
        TOTAL = "total";
        /// Sum of the stages, called Total in the paper.
        STAGES_TOTAL = "stages-total";
        /// Part of `total` that no stage accounts for.
        UNATTRIBUTED = "unattributed";
        /// Payload bytes that the edge sent.
        UPLOAD_BYTES = "upload-bytes";
        /// Bytes of metadata (header and logger tree) that the edge sent.
        UPLOAD_LOGGER_BYTES = "upload-logger-bytes";
        /// Payload bytes that the cloud sent.
        DOWNLOAD_BYTES = "download-bytes";
        /// Bytes of metadata that the cloud sent.
        DOWNLOAD_LOGGER_BYTES = "download-logger-bytes";
        /// Bits of payload and metadata per second of `upload`. The bounds follow from the bounds of the delay.
        UPLOAD_THROUGHPUT = "upload-throughput";
        /// Bits of payload and metadata per second of `download`. The bounds follow from the bounds of the delay.
        DOWNLOAD_THROUGHPUT = "download-throughput";
        /// Time from the request to a language model until its first token. Child of a token rate.
        TIME_TO_FIRST_TOKEN = "time-to-first-token";
        /// Number of tokens that a language model returned. Child of a token rate.
        TOKENS = "tokens";
        /// Number of nodes that a recorder left out because the tree had reached its limits ([`crate::limits`]).
        SKIPPED_NODES = "skipped-nodes";
    }
    symbols { "" "s" "B" "bit/s" "token/s" "W" "°C" "J" "token" }
}

/// Cloud or edge: from when a worker takes a sample until the computation of its batch starts.
// The wire form contains this name as text, because a number would need a new version of the wire form.
pub const BATCH_WAIT: Name = Name::from_static("batch-wait");
/// Cloud or edge: overhead of the communication with the worker process that runs the model's code, in both directions.
// The wire form contains this name as text, like the names of custom nodes.
pub const IPC: Name = Name::from_static("ipc");
/// Overhead of the communication with a sensor's worker process, below `capture`.
// The name differs from `ipc`, because statistics are grouped by name.
pub const CAPTURE_IPC: Name = Name::from_static("capture-ipc");
/// Overhead of the communication with an actuator's worker process, below `actuation`.
pub const ACTUATION_IPC: Name = Name::from_static("actuation-ipc");

/// Cloud or edge: wait of a sample for the restart of a model's worker whose process died. It is part of
/// `unattributed`.
// The wait is not a stage, because the dead process causes the wait, not the pipeline. The wire form contains the name
// as text.
pub const RESTART: Name = Name::from_static("restart");
/// Wait for a sensor's restarted worker, below `capture` and part of it.
pub const CAPTURE_RESTART: Name = Name::from_static("capture-restart");
/// Wait for an actuator's restarted worker, below `actuation` and part of it.
pub const ACTUATION_RESTART: Name = Name::from_static("actuation-restart");

/// Edge, in an open loop: from the scheduled to the actual start, a part of `unattributed`.
// This name and those below are text on the wire, like `ipc`.
pub const LATENESS: Name = Name::from_static("lateness");
/// Number of starts of an open loop that were skipped before this iteration, because the pipeline was too far behind.
/// The node is absent if no start was skipped.
pub const SKIPPED_STARTS: Name = Name::from_static("skipped-starts");
/// 1 if the sample's label is the best class of the answer, else 0.
pub const TOP_1: Name = Name::from_static("top-1");
/// 1 if the sample's label is among the best five classes of the answer, else 0.
pub const TOP_5: Name = Name::from_static("top-5");
/// 1 for a sample whose label is not a class of the model.
pub const UNKNOWN_LABEL: Name = Name::from_static("unknown-label");
/// Number of samples that were lost since the previous sample, in the transport or because the pipeline was busy.
pub const DROPPED_SAMPLES: Name = Name::from_static("dropped-samples");
/// Number of chunks of a language model's answer. It is recorded even if the server counts no tokens.
pub const OUTPUT_CHUNKS: Name = Name::from_static("output-chunks");
/// Node below `inference`: the replayed latency that was drawn for the iteration, seconds.
pub const DRAWN_LATENCY: Name = Name::from_static("drawn-latency");
/// Node below `inference`: the time by which `inference` took longer than the drawn latency, seconds.
pub const OVERRUN: Name = Name::from_static("overrun");

/// Number of stages that add up to `stages-total`.
pub const COUNT: usize = 12;

/// The stages that add up to `stages-total`, in the order in which all stacked bars, legends and tables show them.
pub const ORDER: [Name; COUNT] = [
    SENSING,
    ENCODE,
    SEND_QUEUE,
    UPLOAD,
    QUEUE,
    BATCH_WAIT,
    IPC,
    PREPROCESSING,
    INFERENCE,
    POSTPROCESSING,
    DOWNLOAD,
    ACTUATION,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_names_are_recognised() {
        // These two stages have no number on the wire.
        for stage in ORDER.iter().filter(|stage| ![IPC, BATCH_WAIT].contains(stage)) {
            assert_eq!(standard(stage), Some(stage.as_str()));
        }
        assert_eq!(standard("gripper-force"), None);
    }

    #[test]
    fn wire_numbers_are_unchanged() {
        for (number, name) in
            [(0, ITERATION), (1, SENSING), (6, UPLOAD), (8, PREPROCESSING), (21, DOWNLOAD_THROUGHPUT)]
        {
            assert_eq!((code(&name), decode(number)), (u8::try_from(number).ok(), Some(name)));
        }
        for (number, name) in NAMES.iter().enumerate() {
            assert_eq!(code(name).map(usize::from), Some(number));
        }
        assert_eq!((code("gripper-force"), decode(NAMES.len() as u64)), (None, None));
    }
}
