//! Other participants of a domain.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

use peernet_ros::ros2::{ParticipantId, Ros2Node};

use crate::transport::ros::interface::RemoteNode;

/// Returns a description of a participant for people, with its nodes, such as `node /viewer`.
pub(super) fn describe(node: &Ros2Node, participant: &str) -> String {
    let names_and_host = participant.parse().map(|id: ParticipantId| (node.nodes_of(id), node.host_of(id)));
    let (names, host) = names_and_host.unwrap_or_default();
    let host = host.map(|host| format!(" on host {host}")).unwrap_or_default();
    match &names[..] {
        [] => format!("participant {participant}{host}"),
        [name] => format!("node {name}{host}"),
        names => format!("one of the nodes {}{host}", names.join(", ")),
    }
}

/// Returns the name and the addresses of a participant. Its host is the host that it announces; the ports are
/// meaningless.
pub(super) fn remote_node(node: &Ros2Node, id: ParticipantId) -> RemoteNode {
    let loopback = IpAddr::V4(Ipv4Addr::LOCALHOST);
    let remote = SocketAddr::new(node.host_of(id).unwrap_or(loopback), 0);
    let local = local_address(remote).unwrap_or(SocketAddr::new(loopback, 0));
    RemoteNode { node: id.to_string().into(), local, remote }
}

/// Returns the local address of packets to `remote`. Sends nothing.
fn local_address(remote: SocketAddr) -> Option<SocketAddr> {
    let any = if remote.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(any).ok()?;
    // Port 9 is arbitrary: connecting a datagram socket only looks up the route.
    socket.connect(SocketAddr::new(remote.ip(), 9)).ok()?;
    Some(SocketAddr::new(socket.local_addr().ok()?.ip(), 0))
}
