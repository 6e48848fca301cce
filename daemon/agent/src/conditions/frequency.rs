//! Frequency scaling of the processors.

use std::collections::BTreeMap;
use std::path::Path;

use peernet_stream::Grade;

use super::files::{processors, read_text, read_value};
use super::{Finding, InspectionSettings};

const ABOUT: &str = "CPU governor";
const ADVICE: &str = "set it to `performance` for the measurement: `sudo cpupower frequency-set -g performance` \
                      (on a Jetson `sudo jetson_clocks`)";

/// Grades the governors of all processors (Linux documentation, admin-guide/pm/cpufreq). With a governor that follows
/// the load, the same work takes longer after a pause than in a busy loop, so latency depends on the rate.
pub(super) fn governor(settings: &InspectionSettings) -> Option<Finding> {
    let mut governors = BTreeMap::<String, u32>::new();
    let mut are_fixed = true;
    for processor in processors(&settings.sys) {
        let folder = processor.join("cpufreq");
        let Some(governor) = read_text(&folder.join("scaling_governor")) else { continue };
        *governors.entry(governor).or_default() += 1;
        are_fixed &= is_fixed(&folder);
    }
    if governors.is_empty() {
        return Some(Finding::unknown(
            ABOUT,
            "the kernel does not report the governor (usual in virtual machines)",
        ));
    }
    let is_performance = governors.keys().all(|governor| governor == "performance");
    let names = match governors.len() {
        1 => governors.into_keys().next().unwrap_or_default(),
        _ => {
            let entries = governors.iter().map(|(governor, count)| format!("{governor} on {count}"));
            entries.collect::<Vec<_>>().join(", ")
        }
    };
    Some(match (is_performance, are_fixed) {
        (true, _) => Finding::good(ABOUT, names),
        (false, true) => {
            Finding::good(ABOUT, format!("{names}, with the lowest frequency raised to the highest"))
        }
        (false, false) => Finding::graded(
            ABOUT,
            Grade::Doubtful,
            format!("{names}: the frequency follows the load, so latency depends on how busy the host is"),
            ADVICE,
        ),
    })
}

/// Returns whether the limits allow a single frequency, as after `jetson_clocks`.
fn is_fixed(folder: &Path) -> bool {
    let limit = |name: &str| read_value::<u64>(&folder.join(name));
    matches!((limit("scaling_min_freq"), limit("scaling_max_freq")), (Some(min), Some(max)) if min == max)
}
