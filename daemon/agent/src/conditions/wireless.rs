//! Power save of Wi-Fi interfaces.

use std::path::Path;
use std::process::{Command, Stdio};

use peernet_networks::is_wireless;
use peernet_stream::Grade;

use super::files::{list_entries, read_text};
use super::{Finding, InspectionSettings};

const ABOUT: &str = "Wi-Fi power save";

/// Checks the power save of each wireless interface that is up. An interface in power save wakes for each beacon,
/// about every 102 ms, and packets that arrive between beacons wait at the access point (IEEE 802.11-2020, 11.2).
///
/// The state is available only through nl80211, which `iw` queries. Without `iw` the state is unknown.
pub(super) fn power_save(settings: &InspectionSettings) -> Vec<Finding> {
    let is_up = |path: &std::path::PathBuf| read_text(&path.join("operstate")).as_deref() == Some("up");
    let interfaces = list_entries(&settings.sys.join("class/net"), "")
        .into_iter()
        .filter(|path| is_wireless(path))
        .filter(is_up);
    interfaces.map(|path| inspect_interface(settings, &path)).collect()
}

fn inspect_interface(settings: &InspectionSettings, interface: &Path) -> Finding {
    let name = interface.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match settings.iw.iter().find_map(|iw| query_power_save(iw, &name)).as_deref() {
        Some("Power save: off") => Finding::good(ABOUT, format!("off on {name}")),
        Some("Power save: on") => Finding::graded(
            ABOUT,
            Grade::Doubtful,
            format!("on for {name}: incoming packets can wait for the next beacon, 0.1 s or longer"),
            format!("switch it off for the measurement: `sudo iw dev {name} set power_save off`"),
        ),
        Some(other) => Finding::unknown(ABOUT, format!("`iw` printed for {name}: {other}")),
        None => Finding::unknown(
            ABOUT,
            format!("cannot be read for {name}: the command `iw` is missing or failed"),
        ),
    }
}

/// Returns the line that `iw` prints; `None` if `iw` cannot be run or fails.
fn query_power_save(iw: &Path, interface: &str) -> Option<String> {
    let output = Command::new(iw)
        .args(["dev", interface, "get", "power_save"])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().next().map(|line| line.trim().to_owned())
}
