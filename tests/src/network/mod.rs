//! Hosts in network namespaces, and the links between them.
//!
//! A [`Network`] contains an edge and a cloud. The measured path between them is a plain veth pair, a router with two veth
//! pairs, or a simulated wire with delay and loss. Edge and cloud have a second interface to the namespace of the tests.
//! It carries the event stream, so that reporting does not disturb the measured path. All namespaces of a machine share
//! the kernel's clock, with which reported delays are compared.
//!
//! A test must declare the network before its processes, because values are dropped in reverse order. A test that panics
//! removes its network, too. The next test removes the network of a killed test.

mod capture;
mod chronyd;
mod command;
mod host;
mod slot;

pub use capture::{Capture, Packet};
pub use chronyd::TimeDaemons;
pub use host::Host;

use std::io::{Read, Write};
use std::net::Ipv4Addr;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use command::{ip, try_run};
use slot::Slot;

use crate::{TEST_TIMEOUT, wait_until};

/// Name of the interface on the measured path, on edge and cloud.
pub const DATA_INTERFACE: &str = "data";

/// Name of the interface to the namespace of the tests, on edge and cloud.
pub const CONTROL_INTERFACE: &str = "home";

/// Last octet that means that a host has no address on a link. It belongs to the address of the subnet, so no host has it.
const NO_ADDRESS: u8 = 0;

// Last octets of the addresses of a network:
// - On the measured path the edge has 18 and the cloud 19. With a router the cloud has 34, and the router has 17
//   towards the edge and 33 towards the cloud.
// - A third host has 50 behind the router's 49, or 98 on a link to the cloud's 97.
// - On the links to the namespace of the tests, the tests have 65, 69 and 73; edge, cloud and third host have 66, 70
//   and 74.

/// Properties of one direction of a wire.
#[derive(Clone, Copy, Debug)]
pub struct WireProperties {
    /// Delay, milliseconds.
    pub delay_ms: u32,
    /// Largest deviation from the delay, earlier or later, milliseconds.
    pub jitter_ms: u32,
    /// Share of lost packets, percent.
    pub loss_percent: u32,
}

impl WireProperties {
    /// Returns the argument of `wirefilter` for a direction.
    fn delay_argument(self, direction: &str) -> String {
        format!("{direction}{}+{}", self.delay_ms, self.jitter_ms)
    }
}

/// An edge and a cloud, with the network between them.
#[derive(Debug)]
pub struct Network {
    edge: Host,
    cloud: Host,
    router: Option<Host>,
    third_host: Option<Host>,
    /// Socket for commands to the wire.
    wire: Option<PathBuf>,
    slot: Slot,
}

impl Network {
    /// Connects edge and cloud by a veth pair.
    ///
    /// # Panics
    /// If this process has no permission to create namespaces, or if a tool is missing.
    pub fn direct() -> Self {
        let with_router = false;
        let network = Self::create_hosts(with_router);
        let (edge, cloud) = (&network.edge, &network.cloud);
        veth(edge, DATA_INTERFACE, cloud, DATA_INTERFACE);
        edge.configure_interface(DATA_INTERFACE, edge.address, 28);
        cloud.configure_interface(DATA_INTERFACE, cloud.address, 28);
        network
    }

    /// Connects edge and cloud by a router, whose interfaces are named `edge` and `cloud`.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn routed() -> Self {
        let with_router = true;
        let network = Self::create_hosts(with_router);
        let router = network.router();
        router.run("sysctl", &["-qw", "net.ipv4.ip_forward=1"]);
        for (host, interface, gateway) in [(&network.edge, "edge", 17), (&network.cloud, "cloud", 33)] {
            let gateway = network.slot.address(gateway);
            veth(router, interface, host, DATA_INTERFACE);
            router.configure_interface(interface, gateway, 30);
            host.configure_interface(DATA_INTERFACE, host.address, 30);
            let subnet = format!("{}/24", network.slot.address(0));
            ip(&["-n", &host.namespace, "route", "add", &subnet, "via", &gateway.to_string()]);
        }
        network
    }

    /// Connects edge and cloud by a wire with delay, jitter and loss per direction. Its sockets are created in
    /// `folder`.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn wire(folder: &Path, up: WireProperties, down: WireProperties) -> Self {
        // With a FIFO, `wirefilter` makes packets of the fast direction wait for packets of the slow direction. A FIFO is used
        // only with jitter, because jitter would reorder packets without a FIFO.
        let with_fifo = up.jitter_ms + down.jitter_ms > 0;
        Self::new_wire(folder, up, down, with_fifo)
    }

    /// Connects edge and cloud by a wire on which packets overtake each other if the delay varies.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn reordering_wire(folder: &Path, up: WireProperties, down: WireProperties) -> Self {
        let with_fifo = false;
        Self::new_wire(folder, up, down, with_fifo)
    }

    fn new_wire(folder: &Path, up: WireProperties, down: WireProperties, with_fifo: bool) -> Self {
        let with_router = false;
        let mut network = Self::create_hosts(with_router);
        let start_switch = |host: &Host| {
            let socket = folder.join(&host.namespace).display().to_string();
            host.run("vde_switch", &["--sock", &socket, "--tap", DATA_INTERFACE, "--daemon"]);
            // The switch daemonises before it is ready.
            let device = ["-n", &host.namespace, "link", "show", "dev", DATA_INTERFACE];
            wait_until("a virtual switch", || {
                try_run("ip", &device).ok().filter(|_| Path::new(&socket).join("ctl").exists())
            });
            host.configure_interface(DATA_INTERFACE, host.address, 28);
            socket
        };
        let switches = format!("{}:{}", start_switch(&network.edge), start_switch(&network.cloud));
        let loss = |name: &str, direction: WireProperties| format!("{name}{}", direction.loss_percent);
        let (up_delay, down_delay) = (up.delay_argument("LR"), down.delay_argument("RL"));
        let (up_loss, down_loss) = (loss("LR", up), loss("RL", down));
        let delays = ["-d", &up_delay, "-d", &down_delay, "-l", &up_loss, "-l", &down_loss];
        let fifo: &[&str] = if with_fifo { &[] } else { &["--nofifo"] };
        let commands = folder.join("wire");
        let management = ["--daemon", "-M", &commands.display().to_string()];
        network.edge.run("wirefilter", &[&["-v", &switches], &delays[..], fifo, &management].concat());
        network.wire = Some(commands);
        network
    }

    /// Changes delay and jitter of a wire. The loss is not changed, and packets on their way keep their delay.
    ///
    /// # Panics
    /// If this is not a [`wire`](Self::wire), or if it does not confirm the change.
    pub fn set_delays(&self, up: WireProperties, down: WireProperties) {
        let commands = self.wire.as_ref().expect("a wire");
        let mut stream = wait_until("the wire", || UnixStream::connect(commands).ok());
        // Without a timeout, the loop below would wait forever after an answer with another code than
        // 1000.
        stream.set_read_timeout(Some(TEST_TIMEOUT)).expect("the timeout is not zero");
        for delay in [up.delay_argument("LR"), down.delay_argument("RL")] {
            // This is one write, because the wire takes the result of one `read` as a whole command.
            stream.write_all(format!("delay {delay}\n").as_bytes()).expect("the wire listens");
            let mut answer = Vec::new();
            // Each answer ends with a code, which is 1000 for success, and a prompt.
            while !answer.windows(4).any(|code| code == b"1000") {
                let mut buffer = [0; 256];
                let length = stream.read(&mut buffer).expect("the wire answers");
                assert!(length > 0, "the wire answered {}", String::from_utf8_lossy(&answer));
                answer.extend_from_slice(&buffer[..length]);
            }
        }
    }

    /// Connects edge and cloud by a router that translates addresses. A third host is behind the router, too, and the
    /// cloud sees both hosts at the same address.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn behind_nat() -> Self {
        let mut network = Self::routed();
        let third_host = Host {
            namespace: network.slot.name("third"),
            address: network.slot.address(50),
            test_address: network.slot.address(73),
        };
        ip(&["netns", "add", &third_host.namespace]);
        ip(&["-n", &third_host.namespace, "link", "set", "lo", "up"]);
        third_host.run("sysctl", &["-qw", "net.ipv4.tcp_congestion_control=reno"]);
        network.add_control_interface(&third_host, "t");
        let (router, gateway) = (network.router(), network.slot.address(49));
        veth(router, "third", &third_host, DATA_INTERFACE);
        router.configure_interface("third", gateway, 30);
        third_host.configure_interface(DATA_INTERFACE, third_host.address, 30);
        let subnet = format!("{}/24", network.slot.address(0));
        ip(&["-n", &third_host.namespace, "route", "add", &subnet, "via", &gateway.to_string()]);
        router.run("nft", &["add", "table", "ip", "translation"]);
        let add_chain = ["add", "chain", "ip", "translation", "out"];
        router.run("nft", &[&add_chain[..], &["{ type nat hook postrouting priority 100 ; }"]].concat());
        router.run("nft", &["add", "rule", "ip", "translation", "out", "oifname", "cloud", "masquerade"]);
        network.third_host = Some(third_host);
        network
    }

    /// Adds a third host with its own link to the cloud, so that its traffic does not use the measured path.
    #[must_use]
    pub fn with_third_host(mut self) -> Self {
        let third_host = Host {
            namespace: self.slot.name("third"),
            address: self.slot.address(98),
            test_address: self.slot.address(NO_ADDRESS),
        };
        ip(&["netns", "add", &third_host.namespace]);
        ip(&["-n", &third_host.namespace, "link", "set", "lo", "up"]);
        veth(&self.cloud, "third", &third_host, DATA_INTERFACE);
        self.cloud.configure_interface("third", self.cloud_address_for_third_host(), 30);
        third_host.configure_interface(DATA_INTERFACE, third_host.address, 30);
        self.third_host = Some(third_host);
        self
    }

    /// Returns the third host.
    ///
    /// # Panics
    /// If it does not exist.
    pub fn third_host(&self) -> &Host {
        self.third_host.as_ref().expect("a network with a third host")
    }

    /// Returns the address at which the third host reaches the cloud.
    pub const fn cloud_address_for_third_host(&self) -> Ipv4Addr {
        self.slot.address(97)
    }

    /// Creates the namespaces, and the interfaces of edge and cloud to the namespace of the tests.
    fn create_hosts(with_router: bool) -> Self {
        let slot = Slot::acquire();
        let host = |role: &str, address: u8, test_address: u8| {
            let host = Host {
                namespace: slot.name(role),
                address: slot.address(address),
                test_address: slot.address(test_address),
            };
            ip(&["netns", "add", &host.namespace]);
            ip(&["-n", &host.namespace, "link", "set", "lo", "up"]);
            // Reno does not pace packets; BBR, the default of some machines, does. Delays must not depend on the
            // machine's default.
            host.run("sysctl", &["-qw", "net.ipv4.tcp_congestion_control=reno"]);
            host
        };
        let network = Self {
            edge: host("edge", 18, 65),
            cloud: host("cloud", if with_router { 34 } else { 19 }, 69),
            router: with_router.then(|| host("router", NO_ADDRESS, NO_ADDRESS)),
            third_host: None,
            wire: None,
            slot,
        };
        network.add_control_interface(&network.edge, "e");
        network.add_control_interface(&network.cloud, "c");
        network
    }

    /// Creates a host's interface to the namespace of the tests.
    fn add_control_interface(&self, host: &Host, role: &str) {
        let outside = self.slot.interface(role);
        ip(&[
            "link",
            "add",
            &outside,
            "type",
            "veth",
            "peer",
            "name",
            CONTROL_INTERFACE,
            "netns",
            &host.namespace,
        ]);
        ip(&["address", "add", &format!("{}/30", host.test_address), "dev", &outside]);
        ip(&["link", "set", &outside, "up"]);
        host.configure_interface(CONTROL_INTERFACE, Ipv4Addr::from_bits(host.test_address.to_bits() + 1), 30);
    }

    /// Returns the edge.
    pub const fn edge(&self) -> &Host {
        &self.edge
    }

    /// Returns the cloud.
    pub const fn cloud(&self) -> &Host {
        &self.cloud
    }

    /// Returns the router.
    ///
    /// # Panics
    /// If this is not a [`routed`](Self::routed) network.
    pub fn router(&self) -> &Host {
        self.router.as_ref().expect("a routed network")
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.slot.remove_namespaces();
    }
}

fn veth(a: &Host, a_name: &str, b: &Host, b_name: &str) {
    let (a, b) = (&a.namespace, &b.namespace);
    ip(&["link", "add", a_name, "netns", a, "type", "veth", "peer", "name", b_name, "netns", b]);
}
