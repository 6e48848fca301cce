//! Kind of the machine: hardware, a virtual machine or a container.
//!
//! The kind is detected by the same signs as in `systemd-detect-virt`.

use std::path::Path;

use super::files::{list_entries, read_text};
use super::{Finding, InspectionSettings};

/// Names of container managers in the paths of control groups. A container's process sees them if the container shares
/// the host's namespace of control groups.
const CGROUP_MANAGERS: [&str; 5] = ["docker", "kubepods", "libpod", "lxc", "containerd"];

/// Marker files that container managers create in the root of each container, with the name of the manager.
const MARKERS: [(&str, &str); 2] = [(".dockerenv", "docker"), ("run/.containerenv", "podman")];

/// Prefixes of the vendor or product names of virtual machines.
const VIRTUAL_PRODUCTS: [&str; 17] = [
    "Amazon EC2",
    "Apple Virtualization",
    "BHYVE",
    "Bochs",
    "Google Compute Engine",
    "Hyper-V",
    "innotek GmbH",
    "KVM",
    "KubeVirt",
    "OpenStack",
    "Parallels",
    "QEMU",
    "VMW",
    "VMware",
    "Virtual Machine",
    "VirtualBox",
    "Xen",
];

/// Grades the kind of the machine. A virtual machine or a container has the grade unknown, because it shares its
/// hardware with other machines or containers that are not visible from inside.
pub(super) fn machine_kind(settings: &InspectionSettings) -> Finding {
    const ABOUT: &str = "machine";
    let products = products(&settings.sys);
    let product = if products.is_empty() { String::new() } else { format!(" ({})", products.join(" ")) };
    match (is_virtual(settings, &products), container(settings)) {
        (Some(true), _) => Finding::unknown(
            ABOUT,
            format!("a virtual machine{product}: other load of its hardware is not visible from inside"),
        ),
        (_, Some(name)) => Finding::unknown(
            ABOUT,
            format!("a container ({name}): other load of its host is not visible from inside"),
        ),
        (Some(false), None) => Finding::good(ABOUT, format!("no sign of a virtual machine{product}")),
        (None, None) => Finding::unknown(
            ABOUT,
            format!("neither the processor nor a device tree shows whether the machine is virtual{product}"),
        ),
    }
}

/// Returns the names of the vendor and the product that the firmware reports; names that the firmware does not report
/// are left out.
fn products(sys: &Path) -> Vec<String> {
    let read_name =
        |name: &str| read_text(&sys.join("class/dmi/id").join(name)).filter(|text| !text.is_empty());
    [read_name("sys_vendor"), read_name("product_name")].into_iter().flatten().collect()
}

/// Returns whether the host is a virtual machine; `None` if there is no sign, for example on ARM servers.
fn is_virtual(settings: &InspectionSettings, products: &[String]) -> Option<bool> {
    // Amazon also rents bare-metal machines, whose vendor name is the same.
    let is_bare_metal = products.iter().any(|name| name.ends_with(".metal"));
    let has_virtual_name =
        products.iter().any(|name| VIRTUAL_PRODUCTS.iter().any(|product| name.starts_with(product)));
    let has_hypervisor = read_text(&settings.sys.join("hypervisor/type")).is_some_and(|kind| kind != "none");
    let by_processor = processor_flag(&settings.proc);
    let by_tree = device_tree_is_virtual(&settings.proc.join("device-tree"));
    let signs = [by_processor, by_tree];
    if has_hypervisor || (has_virtual_name && !is_bare_metal) || signs.contains(&Some(true)) {
        return Some(true);
    }
    (is_bare_metal || signs.contains(&Some(false))).then_some(false)
}

/// Returns whether the processor has the flag `hypervisor`, which marks the processor of a virtual machine; `None` on
/// ARM, which has no such flag.
fn processor_flag(proc: &Path) -> Option<bool> {
    let info = read_text(&proc.join("cpuinfo"))?;
    let flags = info.lines().find(|line| line.starts_with("flags"))?;
    Some(flags.split_ascii_whitespace().any(|flag| flag == "hypervisor"))
}

/// Returns whether a device tree belongs to a virtual machine; `None` if there is no device tree.
fn device_tree_is_virtual(tree: &Path) -> Option<bool> {
    let model = read_text(&tree.join("model"))?;
    let is_virtual = model.starts_with("linux,dummy-virt")
        || read_text(&tree.join("hypervisor/compatible")).is_some()
        || !list_entries(tree, "fw-cfg@").is_empty();
    Some(is_virtual)
}

/// Returns the container manager, if the host is a container.
fn container(settings: &InspectionSettings) -> Option<String> {
    let stated_manager =
        read_text(&settings.root.join("run/systemd/container")).filter(|name| !name.is_empty());
    let manager_by_marker = || {
        let marker = MARKERS.iter().find(|(file, _)| settings.root.join(file).exists());
        marker.map(|(_, manager)| (*manager).to_owned())
    };
    stated_manager.or_else(manager_by_marker).or_else(|| {
        let groups = read_text(&settings.proc.join("self/cgroup"))?;
        // `0::/system.slice/docker-1f0c.scope`
        let paths = groups.lines().filter_map(|line| line.splitn(3, ':').nth(2));
        let mut components = paths.flat_map(|path| path.split('/'));
        components
            .find_map(|component| CGROUP_MANAGERS.into_iter().find(|name| is_container_of(name, component)))
            .map(str::to_owned)
    })
}

/// Returns whether a component of a control group's path is a container of a manager, and not a service of the host
/// such as `docker.service`.
fn is_container_of(manager: &str, component: &str) -> bool {
    // Kubernetes names the group of a container of containerd `cri-containerd-ID.scope`.
    let Some(after_manager) = component.strip_prefix("cri-").unwrap_or(component).strip_prefix(manager)
    else {
        return false;
    };
    let starts_with = |start: &str| after_manager.starts_with(start);
    !component.ends_with(".service")
        && (after_manager.is_empty() || ["-", ".slice", ".payload"].into_iter().any(starts_with))
}
