//! The standard names of nodes, written the same way in code, storage, API and pages.

use crate::Name;

macro_rules! standard_names {
    (
        names { $($(#[$doc:meta])* $constant:ident = $name:literal;)* }
        symbols { $($symbol:literal)* }
    ) => {
        $($(#[$doc])* pub const $constant: Name = Name::from_static($name);)*

        /// All standard names; the position is the number that stands for the name on the wire.
        const NAMES: &[&str] = &[$($name),*];

        /// The static form of a standard name, of a standard unit's symbol, or `None` for any other text.
        pub(crate) fn standard(name: &str) -> Option<&'static str> {
            match name {
                $($name => Some($name),)*
                $($symbol => Some($symbol),)*
                _ => None,
            }
        }

        /// The number that stands for a standard name on the wire.
        pub(crate) fn code(name: &str) -> Option<u8> {
            #[expect(non_camel_case_types, clippy::upper_case_acronyms, reason = "counts the constants")]
            enum Position { $($constant),* }
            match name {
                $($name => Some(Position::$constant as u8),)*
                _ => None,
            }
        }
    };
}

/// All standard names, in the order of the numbers that stand for them on the wire.
pub fn all() -> impl Iterator<Item = Name> {
    NAMES.iter().copied().map(Name::from_static)
}

/// The standard name of a number on the wire.
pub(crate) fn decode(code: u64) -> Option<Name> {
    NAMES.get(usize::try_from(code).ok()?).copied().map(Name::from_static)
}

// On the wire a standard name is its position in this list: append only, and raise `wire::VERSION` when doing so.
standard_names! {
    names {
        /// The root of every tree: one sample's trip through a pipeline.
        ITERATION = "iteration";
        /// Edge: asking the sensor → sample ready to send. Parent of `capture` and `transform`.
        SENSING = "sensing";
        /// Edge: the sensor's own part of `sensing`.
        CAPTURE = "capture";
        /// Edge: the transforms' part of `sensing`.
        TRANSFORM = "transform";
        /// Edge: sample → wire frames.
        ENCODE = "encode";
        /// Edge: ready → handed to the network (waiting for a free place in flight).
        SEND_QUEUE = "send-queue";
        /// Edge → cloud: handed to the network → whole message received. A transit, with bounds.
        UPLOAD = "upload";
        /// Cloud or edge: received → worker starts.
        QUEUE = "queue";
        /// Cloud or edge: input of the model made ready.
        PREPROCESSING = "preprocessing";
        /// Cloud or edge: the model itself, until the result is really there.
        INFERENCE = "inference";
        /// Cloud or edge: output of the model made into an answer.
        POSTPROCESSING = "postprocessing";
        /// Cloud → edge: as `upload`.
        DOWNLOAD = "download";
        /// Edge: answer → actuator done.
        ACTUATION = "actuation";
        /// Edge: intended start → end, monotonic, no cross-host error.
        TOTAL = "total";
        /// Sum of the stages: what the paper calls Total.
        STAGES_TOTAL = "stages-total";
        /// What `total` holds beyond the sum of its stages.
        UNATTRIBUTED = "unattributed";
        /// Payload bytes sent up.
        UPLOAD_BYTES = "upload-bytes";
        /// Bytes of metadata (header and logger tree) sent up.
        UPLOAD_LOGGER_BYTES = "upload-logger-bytes";
        /// Payload bytes sent down.
        DOWNLOAD_BYTES = "download-bytes";
        /// Bytes of metadata sent down.
        DOWNLOAD_LOGGER_BYTES = "download-logger-bytes";
        /// Payload and metadata over `upload`, bits per second, with the bounds that follow from the delay's.
        UPLOAD_THROUGHPUT = "upload-throughput";
        /// As `upload-throughput`, the other way.
        DOWNLOAD_THROUGHPUT = "download-throughput";
        /// Time from asking a language model to its first token. Child of a token rate.
        TIME_TO_FIRST_TOKEN = "time-to-first-token";
        /// How many tokens a language model gave. Child of a token rate.
        TOKENS = "tokens";
        /// How many nodes a recorder left out because the tree had reached its limits ([`crate::limits`]).
        SKIPPED_NODES = "skipped-nodes";
    }
    symbols { "" "s" "B" "bit/s" "token/s" "W" "°C" "J" "token" }
}

/// Cloud or edge: what the border of a worker process costs around the model's code in it, both ways. On the wire it is
/// spelt out, as names of users' own are.
pub const IPC: Name = Name::from_static("ipc");
/// The same of a sensor, below `capture`. It has a name of its own because summaries go by name.
pub const CAPTURE_IPC: Name = Name::from_static("capture-ipc");

/// Cloud or edge: a sample's wait for a model's worker that was started anew, because the last one had died. No stage:
/// it belongs to the death before it, and is part of `unattributed`. Spelt out on the wire.
pub const RESTART: Name = Name::from_static("restart");
/// The same of a sensor, below `capture` and part of it.
pub const CAPTURE_RESTART: Name = Name::from_static("capture-restart");
/// The same of an actuator, below `actuation` and part of it.
pub const ACTUATION_RESTART: Name = Name::from_static("actuation-restart");

/// The stages that add up to `stages-total`, in the order of every stack, key and table.
pub const ORDER: [Name; 11] = [
    SENSING,
    ENCODE,
    SEND_QUEUE,
    UPLOAD,
    QUEUE,
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
        for stage in ORDER.iter().filter(|stage| **stage != IPC) {
            assert_eq!(standard(stage), Some(stage.as_str()));
        }
        assert_eq!(standard("gripper-force"), None);
    }

    #[test]
    fn the_numbers_on_the_wire_stay_what_they_were() {
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
