//! Appearance of the stages: the class that carries their colour in every picture.

use std::sync::LazyLock;

use peernet_logger::{Name, stage};

static STAGES: [Name; 11] = stage::ORDER;

/// The stages of a stack, and `unattributed`, in the order of every stack, key and table. Pages pass it to the scripts.
pub(crate) static STACK: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| STAGES.iter().map(Name::as_str).chain(["unattributed"]).collect());

/// Both directions of the network together, where the clocks cannot tell them apart.
pub(crate) const NETWORK: &str = peernet_analysis::slowness::BOTH_WAYS;

/// Rest of an iteration where neither the directions nor the unattributed time are known.
pub(crate) const NETWORK_AND_REST: &str = "upload + download + unattributed";

/// Time from the intended start to the actual start: a named part of the unattributed time.
pub(crate) const LATENESS: &str = "lateness";

/// Values of a model's accuracy, and their titles: means of 0 and 1.
pub(crate) const ACCURACIES: [(&str, &str); 2] = [("top-1", "Top-1"), ("top-5", "Top-5")];

/// Returns the entries of the key: stages of one colour, such as the two queues, share an entry.
pub(crate) fn key() -> impl Iterator<Item = &'static str> {
    STACK.iter().copied().filter(|name| class(name) == *name)
}

/// Returns the label of an entry of the key. The entry of `encode` names `ipc` too: the time in a model's separate process has the same
/// colour.
pub(crate) fn entry(name: &str) -> &str {
    if name == "encode" { "encode, ipc" } else { name }
}

/// Returns the colour class of a node: `f-CLASS` is the fill, `o-CLASS` the text on it.
pub(crate) fn class(name: &str) -> &'static str {
    peernet_figures::look::stage(name).class
}

/// Returns whether the node is a message's way between hosts.
pub(crate) fn is_one_way(name: &str) -> bool {
    name == stage::UPLOAD.as_str() || name == stage::DOWNLOAD.as_str()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_names_every_stage_that_looks_like_no_other_by_name() {
        for name in STACK.iter().copied() {
            let entry = key().find(|known| *known == class(name)).expect("an entry");
            assert!(entry_names(entry, name), "{name} is not in {:?}", super::entry(entry));
        }
    }

    /// Waiting to be sent is waiting by its name.
    fn entry_names(of: &str, name: &str) -> bool {
        entry(of).split(", ").any(|known| name == known || name.ends_with(&format!("-{known}")))
    }

    #[test]
    fn every_stage_has_its_colour_and_its_place() {
        for name in STACK.iter().copied() {
            assert_ne!(class(name), "other", "{name}");
        }
        let keys = [
            "sensing",
            "encode",
            "upload",
            "queue",
            "preprocessing",
            "inference",
            "postprocessing",
            "download",
            "actuation",
            "unattributed",
        ];
        // `send-queue` comes before `upload` in a stack, and `queue`, whose look it has, after it.
        assert!(key().eq(keys));
        assert_eq!(class("\"><script>"), "other");
    }
}
