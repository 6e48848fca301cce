//! Cycles in the graph of modules.

use std::collections::{BTreeMap, BTreeSet};

use super::modules::Uses;

/// Returns the strongly connected components with more than one module.
pub(super) fn cycles(uses: &Uses) -> Vec<BTreeSet<String>> {
    let reachable_from: BTreeMap<&String, BTreeSet<&String>> =
        uses.keys().map(|start| (start, reachable(uses, start))).collect();
    let mut cycles: Vec<BTreeSet<String>> = Vec::new();
    for (module, targets) in &reachable_from {
        let leads_back = |target: &&String| reachable_from[target].contains(module);
        let cycle: BTreeSet<String> = targets.iter().copied().filter(leads_back).cloned().collect();
        if cycle.len() > 1 && !cycles.contains(&cycle) {
            cycles.push(cycle);
        }
    }
    cycles
}

/// Returns the modules that are reachable from a module. The module itself is among them only if it is in a cycle.
fn reachable<'a>(uses: &'a Uses, start: &String) -> BTreeSet<&'a String> {
    let mut modules = BTreeSet::new();
    let mut pending: Vec<&String> = uses[start].keys().collect();
    while let Some(module) = pending.pop() {
        if modules.insert(module) {
            pending.extend(uses[module].keys());
        }
    }
    modules
}

/// Lists the references between the modules of a cycle.
pub(super) fn explain(uses: &Uses, cycle: &BTreeSet<String>) -> String {
    let mut lines = String::new();
    for module in cycle {
        for (other, file) in uses[module].iter().filter(|(other, _)| cycle.contains(*other)) {
            lines.push_str(&format!("    {module} -> {other}: {}\n", file.display()));
        }
    }
    lines
}
