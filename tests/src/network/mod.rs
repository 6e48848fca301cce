//! Hosts in network namespaces, and the cables between them.
//!
//! A [`Network`] contains an edge and a cloud. The measured path is the cable between them: a plain veth pair, one
//! with a router in between, or a wire with delay and loss. Each host has a second interface to the namespace of the
//! tests, for the event stream, so that reporting does not disturb the measured path. All namespaces of a machine
//! share the kernel's clock, with which reported delays are compared.
//!
//! The network must be declared before its processes, because values are dropped in reverse order. A test that panics
//! removes its network as well; the network of a killed test is removed by the next test.

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

use command::{attempt, ip};
use slot::Slot;

use crate::until;

/// Name of the interface on the measured path, on edge and cloud.
pub const DATA: &str = "data";

/// Name of the interface to the namespace of the tests, on edge and cloud.
pub const HOME: &str = "home";

/// Properties of one direction of a wire.
#[derive(Clone, Copy, Debug)]
pub struct WireProperties {
    /// Delay, milliseconds.
    pub delay_ms: u32,
    /// Largest deviation from the delay in both directions, milliseconds.
    pub jitter_ms: u32,
    /// Lost packets, percent.
    pub loss_percent: u32,
}

impl WireProperties {
    /// Returns the argument of `wirefilter` for a direction.
    fn delay(self, direction: &str) -> String {
        format!("{direction}{}+{}", self.delay_ms, self.jitter_ms)
    }
}

/// An edge and a cloud, with the network between them.
#[derive(Debug)]
pub struct Network {
    edge: Host,
    cloud: Host,
    router: Option<Host>,
    third: Option<Host>,
    /// Socket for commands to the wire.
    wire: Option<PathBuf>,
    slot: Slot,
}

impl Network {
    /// Connects edge and cloud by a veth pair.
    ///
    /// # Panics
    /// If this process may not create namespaces, or if a tool is missing.
    pub fn direct() -> Self {
        let network = Self::hosts(false);
        let (edge, cloud) = (&network.edge, &network.cloud);
        veth(edge, DATA, cloud, DATA);
        edge.set_up(DATA, edge.address, 28);
        cloud.set_up(DATA, cloud.address, 28);
        network
    }

    /// Connects edge and cloud by a router, whose interfaces are named `edge` and `cloud`.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn routed() -> Self {
        let network = Self::hosts(true);
        let router = network.router();
        router.run("sysctl", &["-qw", "net.ipv4.ip_forward=1"]);
        for (host, port, gateway) in [(&network.edge, "edge", 17), (&network.cloud, "cloud", 33)] {
            let gateway = network.slot.address(gateway);
            veth(router, port, host, DATA);
            router.set_up(port, gateway, 30);
            host.set_up(DATA, host.address, 30);
            let rest = format!("{}/24", network.slot.address(0));
            ip(&["-n", &host.namespace, "route", "add", &rest, "via", &gateway.to_string()]);
        }
        network
    }

    /// Connects edge and cloud by a wire with delay, jitter and loss per direction. Its sockets are created in
    /// `folder`.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn wire(folder: &Path, up: WireProperties, down: WireProperties) -> Self {
        // With jitter, `wirefilter` must keep the order of packets. It keeps one order for both directions, so that a
        // packet of the quick direction would wait for one of the slow direction. Without jitter that is not needed.
        Self::wire_that_reorders(folder, up, down, up.jitter_ms + down.jitter_ms == 0)
    }

    /// Connects edge and cloud by a wire on which packets overtake each other if the delay varies.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn reordering_wire(folder: &Path, up: WireProperties, down: WireProperties) -> Self {
        Self::wire_that_reorders(folder, up, down, true)
    }

    fn wire_that_reorders(folder: &Path, up: WireProperties, down: WireProperties, reorders: bool) -> Self {
        let mut network = Self::hosts(false);
        let plug = |host: &Host| {
            let socket = folder.join(&host.namespace).display().to_string();
            host.run("vde_switch", &["--sock", &socket, "--tap", DATA, "--daemon"]);
            // It goes to the background before it is ready.
            let device = ["-n", &host.namespace, "link", "show", "dev", DATA];
            until("a virtual switch", || {
                attempt("ip", &device).ok().filter(|_| Path::new(&socket).join("ctl").exists())
            });
            host.set_up(DATA, host.address, 28);
            socket
        };
        let plugs = format!("{}:{}", plug(&network.edge), plug(&network.cloud));
        let loss = |name: &str, way: WireProperties| format!("{name}{}", way.loss_percent);
        let (up_delay, down_delay) = (up.delay("LR"), down.delay("RL"));
        let (up_loss, down_loss) = (loss("LR", up), loss("RL", down));
        let delays = ["-d", &up_delay, "-d", &down_delay, "-l", &up_loss, "-l", &down_loss];
        let order: &[&str] = if reorders { &["--nofifo"] } else { &[] };
        let commands = folder.join("wire");
        let managed = ["--daemon", "-M", &commands.display().to_string()];
        network.edge.run("wirefilter", &[&["-v", &plugs], &delays[..], order, &managed].concat());
        network.wire = Some(commands);
        network
    }

    /// Changes the delays of a wire; packets on their way keep their delay.
    ///
    /// # Panics
    /// If this is not a [`wire`](Self::wire), or if it does not answer.
    pub fn delay(&self, up: WireProperties, down: WireProperties) {
        let commands = self.wire.as_ref().expect("a wire");
        let mut stream = until("the wire", || UnixStream::connect(commands).ok());
        for delay in [up.delay("LR"), down.delay("RL")] {
            // In one write: the wire takes what one read returns for a whole command.
            stream.write_all(format!("delay {delay}\n").as_bytes()).expect("the wire listens");
            let mut answer = Vec::new();
            // Each answer ends with a code, which is 1000 for success, and a prompt.
            while !answer.windows(4).any(|code| code == b"1000") {
                let mut part = [0; 256];
                let length = stream.read(&mut part).expect("the wire answers");
                assert!(length > 0, "the wire said {}", String::from_utf8_lossy(&answer));
                answer.extend_from_slice(&part[..length]);
            }
        }
    }

    /// Connects edge and cloud by a router that translates addresses. A third host is behind it as well, and the
    /// cloud sees both at one address.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn behind_nat() -> Self {
        let mut network = Self::routed();
        let third = Host {
            namespace: network.slot.name("third"),
            address: network.slot.address(50),
            home: network.slot.address(73),
        };
        ip(&["netns", "add", &third.namespace]);
        ip(&["-n", &third.namespace, "link", "set", "lo", "up"]);
        third.run("sysctl", &["-qw", "net.ipv4.tcp_congestion_control=reno"]);
        network.connect_home(&third, "t");
        let (router, gateway) = (network.router(), network.slot.address(49));
        veth(router, "third", &third, DATA);
        router.set_up("third", gateway, 30);
        third.set_up(DATA, third.address, 30);
        let rest = format!("{}/24", network.slot.address(0));
        ip(&["-n", &third.namespace, "route", "add", &rest, "via", &gateway.to_string()]);
        router.run("nft", &["add", "table", "ip", "translation"]);
        let chain = ["add", "chain", "ip", "translation", "out"];
        router.run("nft", &[&chain[..], &["{ type nat hook postrouting priority 100 ; }"]].concat());
        router.run("nft", &["add", "rule", "ip", "translation", "out", "oifname", "cloud", "masquerade"]);
        network.third = Some(third);
        network
    }

    /// Adds a third host on a separate cable to the cloud, so that its traffic does not share the measured path.
    #[must_use]
    pub fn with_third_host(mut self) -> Self {
        let third = Host {
            namespace: self.slot.name("third"),
            address: self.slot.address(98),
            home: self.slot.address(0),
        };
        ip(&["netns", "add", &third.namespace]);
        ip(&["-n", &third.namespace, "link", "set", "lo", "up"]);
        veth(&self.cloud, "third", &third, DATA);
        self.cloud.set_up("third", self.cloud_address_for_third_host(), 30);
        third.set_up(DATA, third.address, 30);
        self.third = Some(third);
        self
    }

    /// Returns the third host.
    ///
    /// # Panics
    /// If it does not exist.
    pub fn third(&self) -> &Host {
        self.third.as_ref().expect("a network with a third host")
    }

    /// Returns the address at which the third host reaches the cloud.
    pub const fn cloud_address_for_third_host(&self) -> Ipv4Addr {
        self.slot.address(97)
    }

    /// Creates the namespaces, each with its interface to the namespace of the tests.
    fn hosts(with_router: bool) -> Self {
        let slot = Slot::take();
        let host = |role: &str, address: u8, home: u8| {
            let host =
                Host { namespace: slot.name(role), address: slot.address(address), home: slot.address(home) };
            ip(&["netns", "add", &host.namespace]);
            ip(&["-n", &host.namespace, "link", "set", "lo", "up"]);
            // Reno does not pace packets; BBR, the default of some machines, does.
            host.run("sysctl", &["-qw", "net.ipv4.tcp_congestion_control=reno"]);
            host
        };
        let network = Self {
            edge: host("edge", 18, 65),
            cloud: host("cloud", if with_router { 34 } else { 19 }, 69),
            router: with_router.then(|| host("router", 0, 0)),
            third: None,
            wire: None,
            slot,
        };
        network.connect_home(&network.edge, "e");
        network.connect_home(&network.cloud, "c");
        network
    }

    /// Creates a host's interface to the namespace of the tests.
    fn connect_home(&self, host: &Host, role: &str) {
        let outside = self.slot.interface(role);
        ip(&["link", "add", &outside, "type", "veth", "peer", "name", HOME, "netns", &host.namespace]);
        ip(&["address", "add", &format!("{}/30", host.home), "dev", &outside]);
        ip(&["link", "set", &outside, "up"]);
        host.set_up(HOME, Ipv4Addr::from_bits(host.home.to_bits() + 1), 30);
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
        self.slot.remove_remains();
    }
}

fn veth(a: &Host, a_name: &str, b: &Host, b_name: &str) {
    let (a, b) = (&a.namespace, &b.namespace);
    ip(&["link", "add", a_name, "netns", a, "type", "veth", "peer", "name", b_name, "netns", b]);
}
