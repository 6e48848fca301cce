//! Cycles in the graph of modules.

use std::collections::BTreeSet;

use super::modules::Uses;

/// Returns the strongly connected components with more than one module.
pub(super) fn cycles(uses: &Uses) -> Vec<BTreeSet<String>> {
    let reached: Vec<(&String, BTreeSet<&String>)> =
        uses.keys().map(|from| (from, reachable(uses, from))).collect();
    let mut cycles: Vec<BTreeSet<String>> = Vec::new();
    for (module, to) in &reached {
        let back = |other: &&String| reached.iter().any(|(name, to)| name == other && to.contains(module));
        let cycle: BTreeSet<String> = to.iter().copied().filter(back).cloned().collect();
        if cycle.len() > 1 && !cycles.contains(&cycle) {
            cycles.push(cycle);
        }
    }
    cycles
}

/// Returns the modules that are reachable from a module; itself only through a cycle.
fn reachable<'a>(uses: &'a Uses, from: &String) -> BTreeSet<&'a String> {
    let mut found = BTreeSet::new();
    let mut next: Vec<&String> = uses[from].keys().collect();
    while let Some(module) = next.pop() {
        if found.insert(module) {
            next.extend(uses[module].keys());
        }
    }
    found
}

/// Lists the edges inside a cycle.
pub(super) fn explain(uses: &Uses, cycle: &BTreeSet<String>) -> String {
    let mut lines = String::new();
    for module in cycle {
        for (other, file) in uses[module].iter().filter(|(other, _)| cycle.contains(*other)) {
            lines.push_str(&format!("    {module} -> {other}: {}\n", file.display()));
        }
    }
    lines
}
