//! Use of swap space.

use peernet_stream::Grade;

use super::files::{number_after_key, read_text};
use super::{Finding, InspectionSettings};

/// Swap in use from which the grade is doubtful, as a share of the size of the memory. A small share is normal, because
/// unused pages are swapped out.
const DOUBTFUL_SHARE: f64 = 0.05;

/// Grades the swap in use. A program stops while swapped memory is read back from the disk.
pub(super) fn swap(settings: &InspectionSettings) -> Option<Finding> {
    const ABOUT: &str = "swap";
    let info = read_text(&settings.proc.join("meminfo"))?;
    let (total, free) = (number_after_key(&info, "SwapTotal")?, number_after_key(&info, "SwapFree")?);
    let memory = number_after_key(&info, "MemTotal").filter(|kib| *kib > 0)?;
    if total == 0 {
        return Some(Finding::good(ABOUT, "none on this host"));
    }
    let used = total.saturating_sub(free);
    let found = format!("{} MiB in use", used / 1024);
    Some(if used as f64 / memory as f64 >= DOUBTFUL_SHARE {
        let advice = "free memory: stop other programs, or restart the host to empty the swap";
        Finding::graded(ABOUT, Grade::Doubtful, found, advice)
    } else {
        Finding::good(ABOUT, found)
    })
}
