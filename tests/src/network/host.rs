//! A network namespace that stands for a machine.

use std::ffi::OsStr;
use std::fs::File;
use std::net::Ipv4Addr;
use std::os::fd::AsFd;
use std::path::Path;

use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};

use super::command::{ip, run};
use super::{Capture, DATA_INTERFACE};
use crate::Process;

/// Network namespace that stands for a machine.
#[derive(Debug)]
pub struct Host {
    pub(super) namespace: String,
    /// Address on the measured path.
    pub address: Ipv4Addr,
    /// Address at which the host reaches programs in the namespace of the tests.
    pub test_address: Ipv4Addr,
}

impl Host {
    /// Runs a tool in this namespace and returns its output.
    ///
    /// # Panics
    /// If it cannot be started or fails.
    pub fn run(&self, program: &str, arguments: &[&str]) -> String {
        let prefix = ["netns", "exec", &self.namespace, program];
        run("ip", &[&prefix[..], arguments].concat())
    }

    /// Starts a program in this namespace.
    ///
    /// # Panics
    /// As [`Process::start`].
    pub fn start<A: AsRef<OsStr>>(
        &self,
        program: &Path,
        arguments: &[A],
        folder: &Path,
        environment: &[(&str, &str)],
    ) -> Process {
        let prefix = ["netns", "exec", &self.namespace].map(OsStr::new);
        let arguments = arguments.iter().map(AsRef::as_ref);
        let arguments: Vec<&OsStr> =
            prefix.into_iter().chain([program.as_os_str()]).chain(arguments).collect();
        Process::start(Path::new("ip"), &arguments, folder, environment)
    }

    /// Runs a closure in this namespace, on a separate thread. A socket that the closure creates stays in this namespace.
    ///
    /// # Panics
    /// If the namespace does not exist, or if `closure` panics.
    pub fn run_in_namespace<T: Send + 'static>(&self, closure: impl FnOnce() -> T + Send + 'static) -> T {
        let path = Path::new("/run/netns").join(&self.namespace);
        let namespace =
            File::open(&path).unwrap_or_else(|error| panic!("cannot open {}: {error}", path.display()));
        let thread = std::thread::spawn(move || {
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network))
                .expect("root may enter the namespace");
            closure()
        });
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }

    /// Adds an address to an interface, with a prefix of 24 bits.
    pub fn add_address(&self, interface: &str, address: &str) {
        ip(&["-n", &self.namespace, "address", "add", &format!("{address}/24"), "dev", interface]);
    }

    /// Adds an address to an interface and activates the interface.
    pub(super) fn configure_interface(&self, interface: &str, address: Ipv4Addr, prefix: u8) {
        let address = format!("{address}/{prefix}");
        ip(&["-n", &self.namespace, "address", "add", &address, "dev", interface]);
        ip(&["-n", &self.namespace, "link", "set", interface, "up"]);
    }

    /// Limits the rate out of an interface; up to 4 MB are queued.
    pub fn limit_rate(&self, interface: &str, mbit_per_second: u32) {
        self.shape(interface, &format!("{mbit_per_second}mbit"), "16kb", ["limit", "4mb"]);
    }

    /// Limits the rate out of an interface to a few packets per second. Packets that would be queued longer than 300 ms are
    /// dropped.
    pub fn throttle(&self, interface: &str, kbit_per_second: u32) {
        self.shape(interface, &format!("{kbit_per_second}kbit"), "2kb", ["latency", "300ms"]);
    }

    /// Adds a token bucket filter (tc-tbf(8)) to an interface; `queue_limit` is an option of the filter and its value.
    fn shape(&self, interface: &str, rate: &str, burst: &str, queue_limit: [&str; 2]) {
        let [limit, value] = queue_limit;
        let filter = ["root", "tbf", "rate", rate, "burst", burst, limit, value];
        self.run("tc", &[&["qdisc", "add", "dev", interface], &filter[..]].concat());
    }

    /// Removes the limit of an interface's rate.
    pub fn remove_limit(&self, interface: &str) {
        self.run("tc", &["qdisc", "delete", "dev", interface, "root"]);
    }

    /// Drops packets that arrive on the measured path for a UDP port.
    pub fn block_udp(&self, port: u16) {
        let port = port.to_string();
        self.add_input_rule(&["udp", "dport", &port, "drop"]);
    }

    /// Drops this percentage of all packets that arrive on the measured path.
    pub fn drop_percent(&self, percent: u32) {
        let percent = percent.to_string();
        self.add_input_rule(&["numgen", "random", "mod", "100", "<", &percent, "drop"]);
    }

    /// Drops all packets that arrive on the measured path.
    pub fn drop_all(&self) {
        self.add_input_rule(&["drop"]);
    }

    /// Drops packets of more than `bytes`, including the IP header, that arrive on the measured path. No ICMP message
    /// reports the loss.
    pub fn drop_longer_than(&self, bytes: u32) {
        self.add_input_rule(&["meta", "length", ">", &bytes.to_string(), "drop"]);
    }

    /// Replaces the address of the interface on the measured path; the prefix has 28 bits.
    pub fn change_address(&self, address: Ipv4Addr) {
        let (old, new) = (format!("{}/28", self.address), format!("{address}/28"));
        // The order matters: removing the first address of a network also removes the second.
        ip(&["-n", &self.namespace, "address", "delete", &old, "dev", DATA_INTERFACE]);
        ip(&["-n", &self.namespace, "address", "add", &new, "dev", DATA_INTERFACE]);
    }

    /// Removes the rules that drop packets on the measured path.
    pub fn clear_rules(&self) {
        self.run("nft", &["delete", "table", "inet", "test"]);
    }

    /// Limits the size of packets out of an interface, bytes.
    pub fn set_mtu(&self, interface: &str, bytes: u32) {
        ip(&["-n", &self.namespace, "link", "set", interface, "mtu", &bytes.to_string()]);
    }

    fn add_input_rule(&self, rule: &[&str]) {
        self.run("nft", &["add", "table", "inet", "test"]);
        let add_chain = ["add", "chain", "inet", "test", "input"];
        self.run("nft", &[&add_chain[..], &["{ type filter hook input priority 0 ; }"]].concat());
        let add_rule = ["add", "rule", "inet", "test", "input", "iifname", DATA_INTERFACE];
        self.run("nft", &[&add_rule[..], rule].concat());
    }

    /// Captures the packets on all interfaces of this host from now on; `filter` is an expression of
    /// tcpdump.
    ///
    /// # Panics
    /// As [`Process::start`], and if tcpdump does not begin to listen.
    pub fn capture(&self, filter: &str, folder: &Path) -> Capture {
        Capture::start(self, filter, folder)
    }
}
