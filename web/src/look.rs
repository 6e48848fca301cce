//! Appearance of the stages: order, labels, and the CSS class that gives a stage its colour everywhere.

use std::sync::LazyLock;

pub(crate) use peernet_analysis::rows::LATENESS;
use peernet_analysis::stage_split::part_order;
pub(crate) use peernet_figures::look::label;
use peernet_logger::Name;

/// Names of all parts that a `total` can have.
static PARTS: LazyLock<Vec<Name>> = LazyLock::new(|| part_order().collect());

/// Name of both directions of the network together, for delays that the clocks cannot split.
pub(crate) const NETWORK: &str = peernet_analysis::slowness::BOTH_DIRECTIONS;

/// Returns the names of all parts that a `total` can have, in the order of every stack, key and table.
pub(crate) fn parts() -> impl Iterator<Item = &'static str> {
    PARTS.iter().map(Name::as_str)
}

/// Returns the [`parts`], separated by commas, for the scripts of pages: of each its name, its [`class`], and `edge` if
/// its fill is pale and has a darker edge, such as `ipc:encode:edge`.
pub(crate) fn part_looks() -> String {
    let looks = parts().map(|name| {
        let stage = peernet_figures::look::stage(name);
        format!("{name}:{}:{}", stage.class, if stage.edge.is_some() { "edge" } else { "" })
    });
    looks.collect::<Vec<_>>().join(",")
}

/// Returns the entries of the colour key. Stages of the same colour, such as `queue` and `send-queue`, share an entry.
pub(crate) fn key_entries() -> impl Iterator<Item = &'static str> {
    // The class of a colour has the name of one of the stages with this colour. The entry has the name of this stage.
    parts().filter(|name| class(name) == *name)
}

/// Returns the label of an entry of the colour key. Two labels also name a second stage of the same colour. The word
/// `queue` also covers the stage `send-queue`.
pub(crate) fn key_entry_label(name: &str) -> &str {
    match name {
        "encode" => "encode, ipc",
        "queue" => "queue, batch-wait",
        name => name,
    }
}

/// Returns the CLASS in the names of a node's CSS classes: `f-CLASS` colours an area, and `o-CLASS` colours text on
/// that area.
pub(crate) fn class(name: &str) -> &'static str {
    peernet_figures::look::stage(name).class
}

#[cfg(test)]
mod tests {
    use peernet_logger::stage;

    use super::*;

    /// Returns the names of the stages and `unattributed`.
    fn stages() -> Vec<Name> {
        stage::ORDER.into_iter().chain([stage::UNATTRIBUTED]).collect()
    }

    #[test]
    fn key_names_every_stage() {
        for name in stages() {
            let entry = key_entries().find(|known| *known == class(&name)).expect("an entry");
            assert!(entry_covers(entry, &name), "{name} is not in {:?}", key_entry_label(entry));
        }
    }

    /// Returns whether the label of an entry covers a stage; `queue` covers `send-queue`, too.
    fn entry_covers(key_entry: &str, name: &str) -> bool {
        key_entry_label(key_entry)
            .split(", ")
            .any(|known| name == known || name.ends_with(&format!("-{known}")))
    }

    #[test]
    fn style_sheet_has_colours_of_every_part() {
        let tokens = include_str!("../assets/css/tokens.css");
        for part in part_looks().split(',') {
            let fields: Vec<&str> = part.split(':').collect();
            let [_, class, edge] = fields[..] else { panic!("{part}") };
            // The script draws both directions in the colours of the two.
            if class != "network" {
                assert!(tokens.contains(&format!("--s-{class}:")), "{part}");
            }
            assert_eq!(tokens.contains(&format!("--e-{class}:")), edge == "edge", "{part}");
        }
    }

    #[test]
    fn every_stage_has_a_colour_and_a_key_entry() {
        for name in parts() {
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
        // `send-queue` has the colour and the entry of `queue`, although other stages lie between the two in a stack.
        assert!(key_entries().eq(keys));
        assert_eq!(class("\"><script>"), "other");
    }
}
