//! Tests of the harness's networks.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use peernet_clock::{Clock, ClockIdentity, Span, SystemClock};
use peernet_tests::network::{Host, Network, WireProperties};

fn udp_socket(host: &Host, port: u16) -> UdpSocket {
    let address = host.address;
    host.run_in_namespace(move || {
        let socket = UdpSocket::bind((address, port)).expect("a namespace has all ports for itself");
        socket.set_read_timeout(Some(Duration::from_secs(1))).expect("a second is a timeout");
        socket
    })
}

#[test]
fn capture_shows_rate_of_limited_link() {
    const BYTES: usize = 250_000;
    let folder = tempfile::tempdir().expect("the temporary folder is writable");
    let network = Network::routed();
    network.router().limit_rate("cloud", 20);
    let capture = network.router().capture("tcp port 7000", folder.path());
    let (edge, cloud) = (network.edge().address, network.cloud().address);
    let listener =
        network.cloud().run_in_namespace(move || TcpListener::bind((cloud, 7000)).expect("a free port"));
    let sender = std::thread::spawn(move || {
        let (mut stream, from) = listener.accept().expect("the edge connects");
        assert_eq!(from.ip(), edge);
        stream.read_to_end(&mut Vec::new()).expect("the edge sends")
    });
    let mut stream =
        network.edge().run_in_namespace(move || TcpStream::connect((cloud, 7000)).expect("it listens"));
    stream.write_all(&[7; BYTES]).expect("there is room");
    drop(stream);
    assert_eq!(sender.join().expect("no panic"), BYTES);

    let packets = capture.finish();
    let passage_times = |is_outgoing: bool| {
        let outgoing =
            packets.iter().filter(move |packet| packet.is_outgoing == is_outgoing && packet.payload > 0);
        let upload: Vec<_> =
            outgoing.filter(|packet| (packet.source, packet.destination) == (edge, cloud)).collect();
        let bytes: usize = upload.iter().map(|packet| packet.payload).sum();
        assert!(bytes >= BYTES, "{bytes}");
        (upload[0].at, upload[upload.len() - 1].at)
    };
    let ((first, _), (_, last)) = (passage_times(false), passage_times(true));
    // At 20 Mbit/s 250 kB take 100 ms, minus the time of one burst.
    assert!(last - first > Span::from_millis(85), "{}", last - first);
}

#[test]
fn blocked_port_and_losses_affect_only_matching_packets() {
    let network = Network::direct();
    let cloud = network.cloud();
    cloud.block_udp(7001);
    let (from, blocked, open) =
        (udp_socket(network.edge(), 7000), udp_socket(cloud, 7001), udp_socket(cloud, 7002));
    let address = cloud.address;
    for port in [7001, 7002] {
        from.send_to(b"probe", (address, port)).expect("there is a route");
    }
    let mut buffer = [0; 16];
    assert_eq!(open.recv(&mut buffer).expect("what was sent last arrives"), 5);
    blocked.set_nonblocking(true).expect("a socket");
    assert_eq!(blocked.recv(&mut buffer).expect_err("dropped").kind(), std::io::ErrorKind::WouldBlock);

    cloud.drop_percent(30);
    let arrived_probes = (0..500).filter(|_| {
        from.send_to(b"probe", (address, 7002)).expect("there is a route");
        open.set_nonblocking(true).expect("a socket");
        // A veth pair delivers a packet before the send call returns.
        open.recv(&mut buffer).is_ok()
    });
    let arrived = arrived_probes.count();
    assert!((200..450).contains(&arrived), "{arrived} of 500");
}

#[test]
fn wire_delays_directions_separately() {
    let folder = tempfile::tempdir().expect("the temporary folder is writable");
    let wire_direction = |delay_ms| WireProperties { delay_ms, jitter_ms: 0, loss_percent: 0 };
    let network = Network::wire(folder.path(), wire_direction(40), wire_direction(5));
    let (edge, cloud) = (udp_socket(network.edge(), 7000), udp_socket(network.cloud(), 7000));
    let clock = SystemClock::new(ClockIdentity::new("boot", "system"));
    let mut buffer = [0; 16];
    let mut delay = |from: &UdpSocket, to: &UdpSocket, address: Ipv4Addr| {
        let sent = clock.wall();
        from.send_to(b"probe", (address, 7000)).expect("there is a route");
        to.recv(&mut buffer).expect("nothing is lost");
        clock.wall() - sent
    };
    // The first packet needs an ARP request, which takes a round trip as well.
    let (to_cloud, to_edge) = (network.cloud().address, network.edge().address);
    delay(&edge, &cloud, to_cloud);
    assert!(delay(&edge, &cloud, to_cloud) > Span::from_millis(38));
    let down = (0..10).map(|_| delay(&cloud, &edge, to_edge)).min().expect("ten");
    assert!(down > Span::from_millis(3) && down < Span::from_millis(38), "{down}");
}

/// Returns the kernel's number of the interface that has an address.
fn index_of_interface(address: Ipv4Addr) -> u32 {
    let printed = output_of_ip(&["-oneline", "address", "show", "to", &address.to_string()]);
    let (index, _) = printed.split_once(':').expect("one line that begins with the index");
    index.parse().expect("an index is a number")
}

fn output_of_ip(arguments: &[&str]) -> String {
    let output = Command::new("ip").args(arguments).output().expect("ip is installed");
    assert!(output.status.success(), "ip {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("ip prints UTF-8")
}

#[test]
fn panicking_test_removes_its_network() {
    let (sender, receiver) = std::sync::mpsc::sync_channel(1);
    let test = std::thread::spawn(move || {
        let network = Network::direct();
        let inode = network.edge().run("readlink", &["/proc/self/ns/net"]);
        let process = network.edge().start(Path::new("sleep"), &["1000"], Path::new("/"), &[]);
        // This address is at the other end of the host's second interface, in the namespace of the tests.
        let interface = index_of_interface(network.edge().test_address);
        sender.send((inode, process.pid(), interface)).expect("the test waits");
        // The process is leaked, as if the test could not stop it.
        std::mem::forget(process);
        panic!("a test fails here, on purpose");
    });
    let (inode, pid, interface) = receiver.recv().expect("the test sends before it panics");
    test.join().expect_err("it panics");
    let is_in_namespace =
        |path: String| std::fs::read_link(path).is_ok_and(|link| link.display().to_string() == inode.trim());
    // The killed process remains as a zombie of this process, but is in no namespace.
    assert!(!is_in_namespace(format!("/proc/{pid}/ns/net")));
    // A test that runs beside this one may already have the same address, but never the same index.
    let links = output_of_ip(&["-oneline", "link", "show"]);
    assert!(
        !links.lines().any(|line| line.starts_with(&format!("{interface}:"))),
        "interface {interface} is still there"
    );
}
