//! Hosts in network namespaces of their own, and the cables between them.
//!
//! A [`Network`] holds an edge and a cloud. What is measured goes over the cable between them, which can be a plain
//! veth pair, one with a router in the middle, or a wire that delays and loses. Each host has a second interface to
//! the namespace that the tests run in, for the event stream, so that reporting does not disturb the measured path.
//!
//! Declare the network before the processes on it: what is declared last goes first. Nothing is left behind, not even
//! by a test that panics; what a killed test run left is removed by the next.

mod capture;
mod chronyd;
mod command;
mod host;
mod slot;

pub use capture::{Capture, Packet};
pub use chronyd::TimeDaemons;
pub use host::Host;

use std::net::Ipv4Addr;
use std::path::Path;

use command::{attempt, ip};
use slot::Slot;

use crate::until;

/// The interface of the measured path, on edge and cloud.
pub const DATA: &str = "data";

/// The interface to the namespace that the tests run in, on edge and cloud.
pub const HOME: &str = "home";

/// How a wire treats what goes over it, in one direction.
#[derive(Clone, Copy, Debug)]
pub struct Way {
    /// Delay, milliseconds.
    pub delay_ms: u32,
    /// The delay varies by so much either way, milliseconds.
    pub jitter_ms: u32,
    /// Packets lost, percent.
    pub loss_percent: u32,
}

/// An edge and a cloud, and what is between them.
#[derive(Debug)]
pub struct Network {
    edge: Host,
    cloud: Host,
    router: Option<Host>,
    third: Option<Host>,
    slot: Slot,
}

impl Network {
    /// Edge and cloud at the two ends of a veth pair.
    ///
    /// # Panics
    /// When this process may not make namespaces, or a tool is missing.
    pub fn direct() -> Self {
        let network = Self::hosts(false);
        let (edge, cloud) = (&network.edge, &network.cloud);
        veth(edge, DATA, cloud, DATA);
        edge.set_up(DATA, edge.address, 28);
        cloud.set_up(DATA, cloud.address, 28);
        network
    }

    /// A router between edge and cloud; its interfaces are called `edge` and `cloud`.
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

    /// A wire with delay, jitter and loss of its own in each direction; its sockets are made in `folder`.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn wire(folder: &Path, up: Way, down: Way) -> Self {
        // It keeps all packets in one order, those of both directions: what goes the quick way would wait for what goes
        // the slow one. Only jitter needs that.
        Self::wire_that_reorders(folder, up, down, up.jitter_ms + down.jitter_ms == 0)
    }

    /// The same, and packets overtake each other where the delay varies.
    ///
    /// # Panics
    /// As [`direct`](Self::direct).
    pub fn reordering_wire(folder: &Path, up: Way, down: Way) -> Self {
        Self::wire_that_reorders(folder, up, down, true)
    }

    fn wire_that_reorders(folder: &Path, up: Way, down: Way, reorders: bool) -> Self {
        let network = Self::hosts(false);
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
        let delay = |name: &str, way: Way| format!("{name}{}+{}", way.delay_ms, way.jitter_ms);
        let loss = |name: &str, way: Way| format!("{name}{}", way.loss_percent);
        let (up_delay, down_delay) = (delay("LR", up), delay("RL", down));
        let (up_loss, down_loss) = (loss("LR", up), loss("RL", down));
        let delays = ["-d", &up_delay, "-d", &down_delay, "-l", &up_loss, "-l", &down_loss];
        let order: &[&str] = if reorders { &["--nofifo"] } else { &[] };
        network.edge.run("wirefilter", &[&["-v", &plugs], &delays[..], order, &["--daemon"]].concat());
        network
    }

    /// Adds a third host, on a cable of its own to the cloud: what it sends does not share the measured path.
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
        self.cloud.set_up("third", self.third_faces(), 30);
        third.set_up(DATA, third.address, 30);
        self.third = Some(third);
        self
    }

    /// The third host.
    ///
    /// # Panics
    /// When there is none.
    pub fn third(&self) -> &Host {
        self.third.as_ref().expect("a network with a third host")
    }

    /// The address at which the third host reaches the cloud.
    pub const fn third_faces(&self) -> Ipv4Addr {
        self.slot.address(97)
    }

    /// The namespaces, each with its interface to the one that the tests run in.
    fn hosts(with_router: bool) -> Self {
        let slot = Slot::take();
        let host = |role: &str, address: u8, home: u8| {
            let host =
                Host { namespace: slot.name(role), address: slot.address(address), home: slot.address(home) };
            ip(&["netns", "add", &host.namespace]);
            ip(&["-n", &host.namespace, "link", "set", "lo", "up"]);
            // It does not pace, which BBR, the default of some machines, does.
            host.run("sysctl", &["-qw", "net.ipv4.tcp_congestion_control=reno"]);
            host
        };
        let network = Self {
            edge: host("edge", 18, 65),
            cloud: host("cloud", if with_router { 34 } else { 19 }, 69),
            router: with_router.then(|| host("router", 0, 0)),
            third: None,
            slot,
        };
        for (host, role) in [(&network.edge, "e"), (&network.cloud, "c")] {
            let outside = network.slot.interface(role);
            ip(&["link", "add", &outside, "type", "veth", "peer", "name", HOME, "netns", &host.namespace]);
            ip(&["address", "add", &format!("{}/30", host.home), "dev", &outside]);
            ip(&["link", "set", &outside, "up"]);
            host.set_up(HOME, Ipv4Addr::from_bits(host.home.to_bits() + 1), 30);
        }
        network
    }

    /// Where samples come from.
    pub const fn edge(&self) -> &Host {
        &self.edge
    }

    /// Where they are computed on.
    pub const fn cloud(&self) -> &Host {
        &self.cloud
    }

    /// What is between them.
    ///
    /// # Panics
    /// When it is not a [`routed`](Self::routed) network.
    pub fn router(&self) -> &Host {
        self.router.as_ref().expect("a routed network")
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.slot.sweep();
    }
}

fn veth(a: &Host, a_name: &str, b: &Host, b_name: &str) {
    let (a, b) = (&a.namespace, &b.namespace);
    ip(&["link", "add", a_name, "netns", a, "type", "veth", "peer", "name", b_name, "netns", b]);
}
