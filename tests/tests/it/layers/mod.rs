//! The structure of the source: a crate depends on crates of lower layers only, and the top-level modules of a crate have no
//! cycles.

mod cycles;
mod modules;

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, TargetKind};

/// From the lowest. The same stands in ARCHITECTURE.md.
const LAYERS: [&[&str]; 7] = [
    &["peernet-clock", "peernet-permissions", "peernet-sample", "peernet-statistics"],
    &["peernet-logger", "peernet-imaging", "peernet-external"],
    &["peernet-stream"],
    &[
        "peernet-sensors",
        "peernet-networks",
        "peernet-probes",
        "peernet-inference",
        "peernet-actuators",
        "peernet-report",
    ],
    &["peernet-aggregator", "peernet-agent", "peernet-results"],
    &["peernet-web"],
    &["peernetd"],
];

/// Cycles that are still there: the crate or program, and its modules. To be shortened only.
const CYCLES: [(&str, &[&str]); 12] = [
    ("peernet_clock", &["rehearsal", "source"]),
    ("peernet_logger", &["guard", "recorder"]),
    ("peernet_logger", &["measure", "tree"]),
    ("peernet_logger", &["name", "stage"]),
    ("peernet_agent", &["error", "serve"]),
    ("peernet_agent", &["host", "incidents", "link", "outbox"]),
    ("peernet_inference", &["config", "exec", "python"]),
    ("peernet_imaging", &["decode", "error", "picture", "probe"]),
    ("peernet_sensors", &["config", "transform"]),
    ("peernet_aggregator", &["config", "error", "store"]),
    ("peernet", &["compare", "run"]),
    (
        "peernet_web",
        &[
            "access",
            "api",
            "assets",
            "config",
            "connections",
            "error",
            "metrics",
            "pages",
            "state",
            "svg",
            "view",
        ],
    ),
];

fn metadata() -> Metadata {
    MetadataCommand::new()
        .manifest_path(peernet_tests::root().join("Cargo.toml"))
        .no_deps()
        .other_options(["--offline".to_owned(), "--locked".to_owned()])
        .exec()
        .expect("cargo metadata works in the checkout")
}

#[test]
fn every_crate_depends_on_lower_layers_only() {
    let layer_of: BTreeMap<&str, usize> = LAYERS
        .iter()
        .enumerate()
        .flat_map(|(layer, crates)| crates.iter().map(move |name| (*name, layer + 1)))
        .collect();
    let mut wrong = Vec::new();
    for package in metadata().workspace_packages() {
        let name = package.name.as_str();
        if name == "peernet-tests" {
            continue;
        }
        let Some(layer) = layer_of.get(name) else {
            wrong.push(format!("{name} has no layer: give it one here and in ARCHITECTURE.md"));
            continue;
        };
        for dependency in package.dependencies.iter().filter(|d| d.kind == DependencyKind::Normal) {
            if let Some(other) = layer_of.get(dependency.name.as_str())
                && other >= layer
            {
                let dependency = &dependency.name;
                wrong.push(format!("{name} (layer {layer}) depends on {dependency} (layer {other})"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn top_level_modules_have_no_cycles() {
    let mut left: BTreeSet<(String, BTreeSet<String>)> = CYCLES
        .iter()
        .map(|(krate, modules)| {
            ((*krate).to_owned(), modules.iter().map(|module| (*module).to_owned()).collect())
        })
        .collect();
    let mut wrong = String::new();
    for package in metadata().workspace_packages() {
        let is_source = |kind: &TargetKind| matches!(kind, TargetKind::Lib | TargetKind::Bin);
        for target in package.targets.iter().filter(|target| target.kind.iter().any(is_source)) {
            let uses = modules::uses(target.src_path.as_std_path());
            for cycle in cycles::cycles(&uses) {
                let found = (target.name.clone(), cycle);
                if !left.remove(&found) {
                    let (krate, cycle) = &found;
                    wrong.push_str(&format!("{krate}: {cycle:?}\n{}", cycles::explain(&uses, cycle)));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "modules that name each other in a circle:\n{wrong}");
    assert!(left.is_empty(), "no longer cycles, to be taken off the list: {left:?}");
}
