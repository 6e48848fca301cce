//! Tests of the source's structure: crates depend on crates of lower layers only, and the top-level modules of a
//! crate have no cycles.

mod cycles;
pub(crate) mod modules;

use std::collections::{BTreeMap, BTreeSet};

use cargo_metadata::{DependencyKind, Metadata, MetadataCommand, TargetKind};

/// Crates of each layer, from the lowest one on. ARCHITECTURE.md has the same list.
const LAYERS: [&[&str]; 8] = [
    &["peernet-clock", "peernet-permissions", "peernet-sample", "peernet-statistics"],
    &["peernet-logger", "peernet-imaging", "peernet-external", "peernet-ros"],
    &["peernet-stream"],
    &[
        "peernet-sensors",
        "peernet-networks",
        "peernet-probes",
        "peernet-inference",
        "peernet-actuators",
        "peernet-analysis",
    ],
    &["peernet-store", "peernet-results", "peernet-figures"],
    &["peernet-aggregator", "peernet-agent"],
    &["peernet-web", "peernet-cli"],
    &["peernetd"],
];

/// Crates without a layer: only tests use them.
const CRATES_WITHOUT_LAYER: [&str; 2] = ["peernet-tests", "peernet-test-ports"];

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
    let mut problems = Vec::new();
    for package in metadata().workspace_packages() {
        let name = package.name.as_str();
        if CRATES_WITHOUT_LAYER.contains(&name) {
            continue;
        }
        let Some(layer) = layer_of.get(name) else {
            problems.push(format!("{name} has no layer: give it one here and in ARCHITECTURE.md"));
            continue;
        };
        for dependency in
            package.dependencies.iter().filter(|dependency| dependency.kind == DependencyKind::Normal)
        {
            if let Some(other) = layer_of.get(dependency.name.as_str())
                && other >= layer
            {
                let dependency = &dependency.name;
                problems.push(format!("{name} (layer {layer}) depends on {dependency} (layer {other})"));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn layers_name_each_existing_crate_once() {
    let metadata = metadata();
    let packages: BTreeSet<&str> =
        metadata.workspace_packages().into_iter().map(|package| package.name.as_str()).collect();
    let mut names = BTreeSet::new();
    for name in LAYERS.iter().copied().flatten().chain(&CRATES_WITHOUT_LAYER) {
        assert!(packages.contains(name), "the workspace has no crate {name}");
        assert!(names.insert(name), "{name} is named twice");
    }
}

#[test]
fn top_level_modules_have_no_cycles() {
    let mut problems = String::new();
    for package in metadata().workspace_packages() {
        let is_source = |kind: &TargetKind| matches!(kind, TargetKind::Lib | TargetKind::Bin);
        for target in package.targets.iter().filter(|target| target.kind.iter().any(is_source)) {
            let uses = modules::uses(target.src_path.as_std_path());
            for cycle in cycles::cycles(&uses) {
                problems.push_str(&format!("{}: {cycle:?}\n{}", target.name, cycles::explain(&uses, &cycle)));
            }
        }
    }
    assert!(
        problems.is_empty(),
        "cycles of modules; move what both need to a module below them:\n{problems}"
    );
}
