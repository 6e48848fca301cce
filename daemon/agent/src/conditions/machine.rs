//! Whether the host is a machine at all.

use super::files::text;
use super::{Finding, Places};

/// What tells a container's first process from a host's (cgroup names).
const CONTAINERS: [&str; 5] = ["docker", "kubepods", "libpod", "lxc", "containerd"];

/// A virtual machine shares its hardware with others that it cannot see: nothing speaks against it, but what is not seen
/// is not known either.
pub(super) fn kind(places: &Places) -> Finding {
    const ABOUT: &str = "machine";
    let (sys, proc) = (&places.sys, &places.proc);
    let hypervisor = text(&proc.join("cpuinfo")).is_some_and(|info| {
        let flags = info.lines().find(|line| line.starts_with("flags"));
        flags.is_some_and(|flags| flags.split_ascii_whitespace().any(|flag| flag == "hypervisor"))
    }) || text(&sys.join("hypervisor/type")).is_some_and(|kind| kind != "none");
    let groups = text(&proc.join("self/cgroup")).unwrap_or_default();
    let container = CONTAINERS.iter().find(|name| groups.contains(**name));
    let made = |name: &str| text(&sys.join("class/dmi/id").join(name)).filter(|text| !text.is_empty());
    let product =
        [made("sys_vendor"), made("product_name")].into_iter().flatten().collect::<Vec<_>>().join(" ");
    let product = if product.is_empty() { product } else { format!(" ({product})") };
    match (hypervisor, container) {
        (true, _) => Finding::unknown(
            ABOUT,
            format!("a virtual machine{product}: what else its hardware does cannot be seen from inside"),
        ),
        (false, Some(name)) => Finding::unknown(
            ABOUT,
            format!("a container ({name}): it shares its host with what is not seen from inside"),
        ),
        (false, None) => Finding::good(ABOUT, format!("not virtual{product}, as far as can be seen")),
    }
}
