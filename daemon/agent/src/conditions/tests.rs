//! Tests of the conditions with file trees that imitate boards.

use std::fs;
use std::path::Path;

use tempfile::TempDir;

use super::*;

/// A file tree that imitates a board.
struct HostFiles(TempDir);

impl HostFiles {
    fn new() -> Self {
        let host_files = Self(tempfile::tempdir().expect("a folder"));
        for core in ["sys/devices/system/cpu/cpu0/online", "sys/devices/system/cpu/cpu1/online"] {
            host_files.write_file(core, "1");
        }
        host_files.write_file("sys/devices/system/cpu/cpufreq/boost", "1");
        host_files
    }

    fn write_file(&self, path: &str, text: &str) {
        let path = self.0.path().join(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, format!("{text}\n")).expect("written");
    }

    fn settings(&self) -> InspectionSettings {
        let path = |name: &str| self.0.path().join(name);
        InspectionSettings {
            sys: path("sys"),
            proc: path("proc"),
            root: path("root"),
            written_paths: Vec::new(),
            iw: vec![path("iw")],
            network: true,
            counting_rounds: 1,
        }
    }

    /// Returns the findings about a subject.
    fn findings_about(&self, subject: &str) -> Vec<(Grade, String)> {
        let findings = inspect_host(&self.settings(), "robot")
            .into_iter()
            .filter(|condition| condition.about == subject);
        findings.map(|condition| (condition.grade, condition.found)).collect()
    }

    fn only_finding_about(&self, subject: &str) -> (Grade, String) {
        let mut findings = self.findings_about(subject);
        assert_eq!(findings.len(), 1, "{subject}: {findings:?}");
        findings.remove(0)
    }
}

#[test]
fn empty_tree_has_only_good_and_unknown_grades() {
    let host_files = HostFiles(tempfile::tempdir().expect("a folder"));
    let findings = inspect_host(&host_files.settings(), "robot");
    assert!(findings.iter().all(|condition| condition.grade <= Grade::Unknown), "{findings:?}");
    assert!(findings.iter().all(|condition| condition.host == "robot"), "{findings:?}");
    assert!(
        host_files.findings_about("Wi-Fi power save").is_empty()
            && host_files.findings_about("swap").is_empty()
    );
}

#[test]
fn dynamic_governors_are_doubtful_unless_limits_fix_frequency() {
    let host_files = HostFiles::new();
    let governor = |core: u32, name: &str| {
        host_files.write_file(&format!("sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor"), name);
    };
    assert_eq!(host_files.only_finding_about("CPU governor").0, Grade::Unknown);
    governor(0, "performance");
    governor(1, "performance");
    assert_eq!(host_files.only_finding_about("CPU governor"), (Grade::Good, "performance".to_owned()));
    governor(1, "schedutil");
    let (grade, finding) = host_files.only_finding_about("CPU governor");
    assert_eq!(grade, Grade::Doubtful);
    assert!(finding.starts_with("performance on 1, schedutil on 1"), "{finding}");
    for (core, limit) in
        [(0, "scaling_min_freq"), (0, "scaling_max_freq"), (1, "scaling_min_freq"), (1, "scaling_max_freq")]
    {
        host_files.write_file(&format!("sys/devices/system/cpu/cpu{core}/cpufreq/{limit}"), "1510400");
    }
    assert_eq!(host_files.only_finding_about("CPU governor").0, Grade::Good);
}

#[test]
fn throttled_jetson_is_reported() {
    let host_files = HostFiles::new();
    host_files.write_file("sys/class/thermal/cooling_device0/type", "cpufreq-cpu0");
    host_files.write_file("sys/class/thermal/cooling_device0/cur_state", "0");
    host_files.write_file("sys/class/thermal/cooling_device1/type", "gpu-throttle-alert");
    host_files.write_file("sys/class/thermal/cooling_device1/cur_state", "0");
    host_files.write_file("sys/class/thermal/cooling_device2/type", "pwm-fan");
    host_files.write_file("sys/class/thermal/cooling_device2/cur_state", "3");
    assert_eq!(host_files.only_finding_about("thermal throttling").0, Grade::Good);
    host_files.write_file("sys/class/thermal/cooling_device1/cur_state", "1");
    let (grade, finding) = host_files.only_finding_about("thermal throttling");
    assert_eq!((grade, finding.contains("gpu-throttle-alert")), (Grade::Bad, true), "{finding}");
}

#[test]
fn zone_is_graded_by_distance_to_passive_trip_point() {
    let host_files = HostFiles::new();
    host_files.write_file("sys/class/thermal/thermal_zone0/type", "CPU-therm");
    host_files.write_file("sys/class/thermal/thermal_zone0/trip_point_0_type", "critical");
    host_files.write_file("sys/class/thermal/thermal_zone0/trip_point_0_temp", "105000");
    host_files.write_file("sys/class/thermal/thermal_zone0/trip_point_1_type", "passive");
    host_files.write_file("sys/class/thermal/thermal_zone0/trip_point_1_temp", "85000");
    for (millis, expected) in [("52000", Grade::Good), ("81500", Grade::Doubtful), ("85000", Grade::Bad)] {
        host_files.write_file("sys/class/thermal/thermal_zone0/temp", millis);
        assert_eq!(host_files.only_finding_about("thermal throttling").0, expected, "{millis}");
    }
}

#[test]
fn raspberry_pi_distinguishes_current_from_past_throttling() {
    let host_files = HostFiles::new();
    let file = "sys/devices/platform/soc/soc:firmware/get_throttled";
    // The bits are hexadecimal: 5 are the bits 0 and 2, 50000 the same bits of the past.
    for (bits, grade, part) in [
        ("0", Grade::Good, "none"),
        ("50000", Grade::Doubtful, "under-voltage, throttled since"),
        ("50005", Grade::Bad, "under-voltage, throttled now"),
        ("0x80008", Grade::Bad, "soft temperature limit now"),
    ] {
        host_files.write_file(file, bits);
        let (found_grade, text) = host_files.only_finding_about("thermal throttling");
        assert!(found_grade == grade && text.contains(part), "{bits}: {found_grade:?} {text}");
    }
}

#[test]
fn throttle_counts_since_boot_are_doubtful() {
    let host_files = HostFiles::new();
    host_files.write_file("sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_count", "0");
    host_files.write_file("sys/devices/system/cpu/cpu1/thermal_throttle/package_throttle_count", "0");
    assert_eq!(host_files.only_finding_about("thermal throttling").0, Grade::Good);
    host_files.write_file("sys/devices/system/cpu/cpu1/thermal_throttle/package_throttle_count", "17");
    let (grade, finding) = host_files.only_finding_about("thermal throttling");
    assert_eq!((grade, finding.contains("17 times")), (Grade::Doubtful, true), "{finding}");
}

#[test]
fn own_threads_are_no_competing_load() {
    let host_files = HostFiles::new();
    let write_own_thread = |id: u32, state: &str| {
        host_files
            .write_file(&format!("proc/self/task/{id}/stat"), &format!("{id} (peernetd (R) x) {state} 1 1"));
    };
    // The fourth field counts: 2 of 512 threads are runnable. The load averages before this field do not count.
    host_files.write_file("proc/loadavg", "0.10 0.20 0.30 2/512 4711");
    write_own_thread(1, "R");
    write_own_thread(2, "R");
    write_own_thread(3, "S");
    assert_eq!(host_files.only_finding_about("competing load").0, Grade::Good);
    host_files.write_file("proc/loadavg", "9.00 9.00 9.00 3/512 4711");
    assert_eq!(
        host_files.only_finding_about("competing load").0,
        Grade::Doubtful,
        "one thread of another process, on two processors"
    );
    host_files.write_file("proc/loadavg", "0.00 0.00 0.00 4/512 4711");
    host_files
        .write_file("proc/pressure/cpu", "some avg10=12.60 avg60=1.00 avg300=0.10 total=1\nfull avg10=0.00");
    let (grade, finding) = host_files.only_finding_about("competing load");
    assert_eq!(grade, Grade::Bad, "{finding}");
    assert!(finding.contains("2.0 other threads") && finding.contains("13 % of the time"), "{finding}");
}

#[test]
fn stolen_time_and_cpu_quota_are_reported() {
    let host_files = HostFiles::new();
    host_files.write_file("proc/stat", "cpu  600 0 300 100 0 0 0 0 0 0");
    host_files.write_file("proc/self/cgroup", "0::/system.slice/docker-1.scope");
    host_files.write_file("sys/fs/cgroup/system.slice/docker-1.scope/cpu.max", "max 100000");
    assert!(
        host_files.findings_about("stolen time").is_empty()
            && host_files.findings_about("CPU quota").is_empty()
    );
    assert!(host_files.only_finding_about("machine").1.contains("container (docker)"));
    // The 20 is the stolen time. The 500 is the time of guests, which is already in the 600.
    host_files.write_file("proc/stat", "cpu  600 0 300 80 0 0 0 20 500 0");
    host_files.write_file("sys/fs/cgroup/system.slice/docker-1.scope/cpu.max", "150000 100000");
    assert_eq!(host_files.only_finding_about("stolen time").0, Grade::Doubtful, "2 % of the time was stolen");
    let (grade, finding) = host_files.only_finding_about("CPU quota");
    assert_eq!((grade, finding.contains("1.50 processors")), (Grade::Doubtful, true), "{finding}");
}

#[test]
fn container_with_hidden_cgroups_is_recognised() {
    for (file, content, manager) in [
        ("root/.dockerenv", "", "docker"),
        ("root/run/.containerenv", "engine=\"podman-5\"", "podman"),
        ("root/run/systemd/container", "systemd-nspawn", "systemd-nspawn"),
        ("proc/self/cgroup", "0::/kubepods.slice/kubepods-pod7.slice/cri-containerd-1f.scope", "kubepods"),
        ("proc/self/cgroup", "4:memory:/lxc.payload.robot/init.scope\n0::/", "lxc"),
    ] {
        let host_files = HostFiles::new();
        host_files.write_file("proc/cpuinfo", "flags\t: fpu sse2");
        host_files.write_file("proc/self/cgroup", "0::/");
        assert_eq!(host_files.only_finding_about("machine").0, Grade::Good);
        host_files.write_file(file, content);
        let (grade, finding) = host_files.only_finding_about("machine");
        let expected = format!("a container ({manager})");
        assert!(grade == Grade::Unknown && finding.starts_with(&expected), "{file}: {finding}");
    }
}

#[test]
fn host_service_of_container_manager_is_no_container() {
    let host_files = HostFiles::new();
    host_files.write_file("proc/cpuinfo", "flags\t: fpu sse2");
    for group in ["docker.service", "docker-registry.service", "containerd.service", "dockerish.slice"] {
        host_files.write_file("proc/self/cgroup", &format!("0::/system.slice/{group}"));
        assert_eq!(host_files.only_finding_about("machine").0, Grade::Good, "{group}");
    }
}

#[test]
fn virtual_machine_is_recognised_without_x86_flag() {
    let grade_and_is_virtual = |files: &[(&str, &str)]| {
        let host_files = HostFiles::new();
        host_files.write_file("proc/cpuinfo", "Features\t: fp asimd");
        files.iter().for_each(|(file, content)| host_files.write_file(file, content));
        let (grade, finding) = host_files.only_finding_about("machine");
        (grade, finding.starts_with("a virtual machine"))
    };
    let (vendor, product) = ("sys/class/dmi/id/sys_vendor", "sys/class/dmi/id/product_name");
    let model = "proc/device-tree/model";
    assert_eq!(grade_and_is_virtual(&[]), (Grade::Unknown, false), "there is no sign");
    assert_eq!(grade_and_is_virtual(&[(vendor, "Ampere")]), (Grade::Unknown, false));
    assert_eq!(
        grade_and_is_virtual(&[(vendor, "QEMU"), (product, "KVM Virtual Machine")]),
        (Grade::Unknown, true)
    );
    assert_eq!(
        grade_and_is_virtual(&[(vendor, "Microsoft Corporation"), (product, "Virtual Machine")]),
        (Grade::Unknown, true)
    );
    assert_eq!(
        grade_and_is_virtual(&[(vendor, "Amazon EC2"), (product, "m6g.large")]),
        (Grade::Unknown, true)
    );
    assert_eq!(grade_and_is_virtual(&[(vendor, "Amazon EC2"), (product, "m6g.metal")]).0, Grade::Good);
    assert_eq!(grade_and_is_virtual(&[(model, "Raspberry Pi 4 Model B")]).0, Grade::Good);
    assert_eq!(grade_and_is_virtual(&[(model, "linux,dummy-virt")]), (Grade::Unknown, true));
    assert_eq!(
        grade_and_is_virtual(&[(model, "board"), ("proc/device-tree/hypervisor/compatible", "xen")]),
        (Grade::Unknown, true)
    );
}

#[test]
fn used_swap_is_graded_relative_to_memory() {
    let host_files = HostFiles::new();
    for (free, expected) in [("1000000", Grade::Good), ("960000", Grade::Good), ("500000", Grade::Doubtful)] {
        host_files.write_file(
            "proc/meminfo",
            &format!("MemTotal: 4000000 kB\nSwapTotal:  1000000 kB\nSwapFree: {free} kB"),
        );
        assert_eq!(host_files.only_finding_about("swap").0, expected, "{free}");
    }
}

#[test]
fn missing_folder_is_inspected_on_its_future_disk() {
    let host_files = HostFiles::new();
    let mut settings = host_files.settings();
    settings.written_paths = vec![("results".to_owned(), host_files.0.path().join("not/yet/there"))];
    let findings = inspect_host(&settings, "robot");
    let disk =
        findings.iter().find(|condition| condition.about == "free disk").expect("the folder is inspected");
    assert!(disk.found.contains("GiB for the results"), "{disk:?}");
    assert!(disk.grade != Grade::Unknown, "{disk:?}");
}

/// Installs a program in place of `iw`.
fn install_iw(host_files: &HostFiles, output: &str) {
    use std::os::unix::fs::PermissionsExt;
    let path = host_files.0.path().join("iw");
    // The rename replaces the program in one step.
    let new_file = host_files.0.path().join("iw.new");
    fs::write(&new_file, format!("#!/bin/sh\n[ \"$1 $3 $4\" = 'dev get power_save' ] && echo '{output}'\n"))
        .expect("written");
    fs::set_permissions(&new_file, fs::Permissions::from_mode(0o755)).expect("executable");
    fs::rename(new_file, path).expect("moved");
}

/// Adds a network interface; `marker` is the folder that marks a wireless interface, `None` for a wired interface.
fn add_interface(host_files: &HostFiles, name: &str, marker: Option<&str>, state: &str) {
    host_files.write_file(&format!("sys/class/net/{name}/operstate"), state);
    if let Some(marker) = marker {
        fs::create_dir_all(host_files.0.path().join(Path::new("sys/class/net").join(name).join(marker)))
            .expect("made");
    }
}

#[test]
fn only_active_wireless_interfaces_are_queried() {
    let host_files = HostFiles::new();
    add_interface(&host_files, "eth0", None, "up");
    add_interface(&host_files, "wlan1", Some("phy80211"), "down");
    assert!(host_files.findings_about("Wi-Fi power save").is_empty());
    add_interface(&host_files, "wlan0", Some("phy80211"), "up");
    let (grade, finding) = host_files.only_finding_about("Wi-Fi power save");
    assert_eq!((grade, finding.contains("`iw` is missing")), (Grade::Unknown, true), "{finding}");
    for (output, expected) in
        [("Power save: off", Grade::Good), ("Power save: on", Grade::Doubtful), ("?", Grade::Unknown)]
    {
        install_iw(&host_files, output);
        let (grade, finding) = host_files.only_finding_about("Wi-Fi power save");
        assert!(grade == expected && finding.contains("wlan0"), "{output}: {grade:?} {finding}");
    }
    let without_network = InspectionSettings { network: false, ..host_files.settings() };
    assert!(
        inspect_host(&without_network, "robot").iter().all(|condition| condition.about != "Wi-Fi power save")
    );
}

#[tokio::test]
async fn this_host_can_be_inspected() {
    let findings = inspect_host_in_time(InspectionSettings::default(), "here".to_owned()).await;
    for subject in ["CPU governor", "thermal throttling", "competing load", "machine"] {
        assert!(findings.iter().any(|condition| condition.about == subject), "{subject}: {findings:?}");
    }
    assert!(findings.iter().all(|condition| !condition.found.is_empty()), "{findings:?}");
}
