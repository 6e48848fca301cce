//! Throttling of the processor by heat or under-voltage, now and since the start of the host.

use std::path::Path;

use peernet_stream::Grade;

use super::files::{list_entries, processors, read_text, read_value};
use super::{Finding, InspectionSettings};

const ABOUT: &str = "thermal throttling";
const COOLING_ADVICE: &str = "cool the host or lower its load, wait, and repeat the run";
const OBSERVING_ADVICE: &str = "compare the halves of the run to find out whether the host is throttled during the run as well, and \
                                improve the cooling";
/// Distance below a trip point within which a temperature counts as near the trip point, °C.
const TRIP_POINT_MARGIN_CELSIUS: f64 = 5.0;
/// Prefixes of the types of cooling devices that slow down processors or GPUs, on x86, Arm and Jetson.
const THROTTLING_DEVICES: [&str; 6] =
    ["Processor", "cpufreq", "thermal-cpufreq", "gpu", "devfreq", "intel_powerclamp"];

/// Grades all signs of throttling. Throttling that is active now is bad; earlier throttling since the start of the host
/// is doubtful.
pub(super) fn throttling(settings: &InspectionSettings) -> Vec<Finding> {
    let sys = &settings.sys;
    let mut has_source = false;
    let mut findings = Vec::new();
    for find in [active_cooling_devices, zones_near_trip_point, firmware_flags, throttle_counters] {
        if let Some(new_findings) = find(sys) {
            has_source = true;
            findings.extend(new_findings);
        }
    }
    match (findings.is_empty(), has_source) {
        (false, _) => findings,
        (true, true) => vec![Finding::good(ABOUT, "none, neither now nor since the host was started")],
        (true, false) => {
            vec![Finding::unknown(ABOUT, "the kernel does not report throttling (usual in virtual machines)")]
        }
    }
}

/// Finds active cooling devices (kernel documentation, driver-api/thermal/sysfs-api); the alerts of a Jetson are such
/// devices, too.
fn active_cooling_devices(sys: &Path) -> Option<Vec<Finding>> {
    let devices = list_entries(&sys.join("class/thermal"), "cooling_device");
    let mut has_devices = false;
    let mut active = Vec::new();
    for device in devices {
        let Some(kind) = read_text(&device.join("type")) else { continue };
        if !kind.contains("throttle-alert") && !THROTTLING_DEVICES.iter().any(|name| kind.starts_with(name)) {
            continue;
        }
        let Some(state) = read_value::<i64>(&device.join("cur_state")) else { continue };
        has_devices = true;
        // The power clamp reports −1 while the clamp is off.
        if state > 0 && !active.contains(&kind) {
            active.push(kind);
        }
    }
    let finding = || {
        let found = format!("the kernel throttles the host now ({})", active.join(", "));
        Finding::graded(ABOUT, Grade::Bad, found, COOLING_ADVICE)
    };
    has_devices.then(|| if active.is_empty() { Vec::new() } else { vec![finding()] })
}

/// Finds thermal zones at or near a trip point, above which the kernel slows the host down.
fn zones_near_trip_point(sys: &Path) -> Option<Vec<Finding>> {
    let mut has_zones = false;
    let mut findings = Vec::new();
    for zone in list_entries(&sys.join("class/thermal"), "thermal_zone") {
        let Some(celsius) = read_value::<f64>(&zone.join("temp")).map(|millis| millis / 1e3) else {
            continue;
        };
        // At a passive trip point the kernel slows the host down. At the other types the kernel starts a fan, notifies
        // the driver, or shuts the host down.
        let passive_type_files = list_entries(&zone, "trip_point_").into_iter().filter(|path| {
            path.to_string_lossy().ends_with("_type") && read_text(path).as_deref() == Some("passive")
        });
        let trip_points = passive_type_files.filter_map(|path| {
            let temperature_file = path.to_string_lossy().replace("_type", "_temp");
            read_value::<f64>(Path::new(&temperature_file))
                .map(|millis| millis / 1e3)
                // A trip point that is not set has a temperature of 0 °C or below.
                .filter(|celsius| *celsius > 0.0)
        });
        let Some(point) = trip_points.min_by(f64::total_cmp) else { continue };
        has_zones = true;
        let name = read_text(&zone.join("type")).unwrap_or_else(|| "a sensor".to_owned());
        let text = format!("{name} is at {celsius:.0} °C; the host is throttled from {point:.0} °C on");
        if celsius >= point {
            findings.push(Finding::graded(ABOUT, Grade::Bad, text, COOLING_ADVICE));
        } else if celsius >= point - TRIP_POINT_MARGIN_CELSIUS {
            findings.push(Finding::graded(ABOUT, Grade::Doubtful, text, COOLING_ADVICE));
        }
    }
    has_zones.then_some(findings)
}

/// Reads the flags of a Raspberry Pi's firmware: bits 0 to 3 are the current state, bits 16 to 19 say what has occurred
/// since the board was started (documentation of `vcgencmd get_throttled`).
fn firmware_flags(sys: &Path) -> Option<Vec<Finding>> {
    let bits = read_text(&sys.join("devices/platform/soc/soc:firmware/get_throttled"))?;
    let bits = u32::from_str_radix(bits.trim_start_matches("0x"), 16).ok()?;
    let flag_names = |shift: u32| {
        let names = ["under-voltage", "frequency capped", "throttled", "soft temperature limit"];
        let set_flags = names.into_iter().enumerate().filter(|(bit, _)| bits >> shift & 1 << bit != 0);
        set_flags.map(|(_, name)| name).collect::<Vec<_>>().join(", ")
    };
    let (current_flags, earlier_flags) = (flag_names(0), flag_names(16));
    Some(if !current_flags.is_empty() {
        let advice = "use the power supply meant for the board, cool it, and repeat the run";
        vec![Finding::graded(ABOUT, Grade::Bad, format!("the firmware reports {current_flags} now"), advice)]
    } else if !earlier_flags.is_empty() {
        let found = format!("the firmware reports {earlier_flags} since the board was started");
        vec![Finding::graded(ABOUT, Grade::Doubtful, found, OBSERVING_ADVICE)]
    } else {
        Vec::new()
    })
}

/// Reads the counters of throttling events since the start of the host: on Intel one per core and one per package, on
/// Tegra the counters of over-current events.
fn throttle_counters(sys: &Path) -> Option<Vec<Finding>> {
    let cores = processors(sys).into_iter().map(|processor| processor.join("thermal_throttle"));
    let counters = cores
        .flat_map(|folder| ["core_throttle_count", "package_throttle_count"].map(|name| folder.join(name)));
    let board_counters = list_entries(&sys.join("class/hwmon"), "hwmon").into_iter().flat_map(|folder| {
        list_entries(&folder, "oc").into_iter().filter(|path| path.to_string_lossy().ends_with("_event_cnt"))
    });
    let counts: Vec<u64> = counters.chain(board_counters).filter_map(|path| read_value(&path)).collect();
    // Each core of a package repeats the counter of the package, so a sum would count events several times.
    let count = counts.into_iter().max()?;
    let text = || format!("the processor was throttled {count} times since the host was started");
    Some(if count == 0 {
        Vec::new()
    } else {
        vec![Finding::graded(ABOUT, Grade::Doubtful, text(), OBSERVING_ADVICE)]
    })
}
