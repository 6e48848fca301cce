//! The house keeps its floors: a crate imports only from floors below its own.

use std::collections::BTreeMap;

use cargo_metadata::{DependencyKind, MetadataCommand};

const FLOORS: [&[&str]; 6] = [
    &["peernet-clock", "peernet-permissions", "peernet-sample", "peernet-statistics"],
    &["peernet-logger", "peernet-imaging", "peernet-external"],
    &[
        "peernet-sensors",
        "peernet-networks",
        "peernet-probes",
        "peernet-inference",
        "peernet-actuators",
        "peernet-report",
    ],
    &["peernet-aggregator", "peernet-agent"],
    &["peernet-web"],
    &["peernetd"],
];

#[test]
fn every_crate_imports_from_floors_below_its_own() {
    let floor_of: BTreeMap<&str, usize> = FLOORS
        .iter()
        .enumerate()
        .flat_map(|(floor, crates)| crates.iter().map(move |name| (*name, floor)))
        .collect();
    let metadata = MetadataCommand::new()
        .manifest_path(peernet_tests::root().join("Cargo.toml"))
        .no_deps()
        .other_options(["--offline".to_owned(), "--locked".to_owned()])
        .exec()
        .expect("cargo metadata works in the checkout");

    let mut wrong = Vec::new();
    for package in metadata.workspace_packages() {
        let name = package.name.as_str();
        if name == "peernet-tests" {
            continue;
        }
        let Some(floor) = floor_of.get(name) else {
            wrong.push(format!("{name} has no floor: give it one here and in ARCHITECTURE.md"));
            continue;
        };
        for dependency in package.dependencies.iter().filter(|d| d.kind == DependencyKind::Normal) {
            if let Some(below) = floor_of.get(dependency.name.as_str())
                && below >= floor
            {
                wrong.push(format!(
                    "{name} (floor {}) imports {} (floor {})",
                    floor + 1,
                    dependency.name,
                    below + 1
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
