//! The kernel's statistics of a TCP connection: `TCP_INFO`, requested through netlink by the addresses of both ends.
//!
//! `getsockopt` would need the socket, and the edge's ZeroMQ library does not give access to it. Netlink's `sock_diag`
//! finds any connection of this network namespace without a privilege. One request needs three system calls and takes
//! less than 30 µs.

use std::io;
use std::net::IpAddr;
use std::os::fd::AsRawFd;
use std::sync::atomic::{AtomicBool, Ordering};

use netlink_packet_core::{NLM_F_REQUEST, NetlinkHeader, NetlinkMessage, NetlinkPayload};
use netlink_packet_sock_diag::SockDiagMessage;
use netlink_packet_sock_diag::constants::{AF_INET, AF_INET6, IPPROTO_TCP};
use netlink_packet_sock_diag::inet::nlas::Nla;
use netlink_packet_sock_diag::inet::{ExtensionFlags, InetRequest, InetResponse, SocketId, StateFlags};
use nix::errno::Errno;
use nix::sys::socket::{AddressFamily, MsgFlags, SockFlag, SockProtocol, SockType, recv, send, socket};
use peernet_clock::Span;

use crate::statistics::{ConnectionAddresses, DatagramStatistics, TransportRoundTrip, TransportStatistics};

/// Size of the buffer for an answer. An answer has about 350 bytes; later kernels may add some.
const ANSWER_BYTES: usize = 4_096;

/// Cookie that matches any socket (`INET_DIAG_NOCOOKIE`).
const ANY_COOKIE: [u8; 8] = [0xFF; 8];

/// Reason why a connection has no statistics.
#[derive(Debug, thiserror::Error)]
enum TcpInfoError {
    #[error(transparent)]
    System(#[from] io::Error),
    #[error("the answer cannot be read: {0}")]
    Malformed(String),
}

/// Returns the kernel's statistics of the connection between these addresses. The statistics are empty if the
/// connection is gone or the system does not provide statistics; in the latter case the reason is logged once.
pub(super) fn tcp_statistics(addresses: &ConnectionAddresses) -> TransportStatistics {
    // Statistics are queried again and again, and the reason stays the same.
    static IS_LOGGED: AtomicBool = AtomicBool::new(false);
    match query(addresses) {
        Ok(info) => info.map_or_else(TransportStatistics::default, |info| parse_tcp_info(&info)),
        Err(error) => {
            if !IS_LOGGED.swap(true, Ordering::Relaxed) {
                tracing::info!(
                    %error,
                    "cannot query the kernel's statistics of TCP connections (netlink sock_diag): round trips and retransmissions \
                     are not shown; if a sandbox forbids sockets of the family AF_NETLINK, allow them"
                );
            }
            TransportStatistics::default()
        }
    }
}

/// Returns the bytes of the kernel's `struct tcp_info`. The number of bytes depends on the version of the kernel.
/// `None` if the connection is gone.
fn query(addresses: &ConnectionAddresses) -> Result<Option<Vec<u8>>, TcpInfoError> {
    let request_bytes = sock_diag_request(addresses);
    let (family, kind) = (AddressFamily::Netlink, SockType::Datagram);
    let socket = socket(family, kind, SockFlag::SOCK_CLOEXEC, SockProtocol::NetlinkSockDiag)
        .map_err(io::Error::from)?;
    send(socket.as_raw_fd(), &request_bytes, MsgFlags::empty()).map_err(io::Error::from)?;
    let mut answer = vec![0; ANSWER_BYTES];
    // The kernel answers within the call that sends the request, so the answer is already there.
    let length = recv(socket.as_raw_fd(), &mut answer, MsgFlags::MSG_DONTWAIT).map_err(io::Error::from)?;
    let answer = NetlinkMessage::<SockDiagMessage>::deserialize(&answer[..length])
        .map_err(|error| TcpInfoError::Malformed(error.to_string()))?;
    match answer.payload {
        NetlinkPayload::InnerMessage(SockDiagMessage::InetResponse(response)) => {
            Ok(find_tcp_info(addresses, *response))
        }
        NetlinkPayload::Error(error) if error.to_io().raw_os_error() == Some(Errno::ENOENT as i32) => {
            Ok(None)
        }
        NetlinkPayload::Error(error) => Err(error.to_io().into()),
        other => Err(TcpInfoError::Malformed(format!("{other:?}"))),
    }
}

fn sock_diag_request(addresses: &ConnectionAddresses) -> Vec<u8> {
    let ConnectionAddresses { local, remote } = addresses;
    let family = if local.is_ipv4() { AF_INET } else { AF_INET6 };
    let request = InetRequest {
        family,
        protocol: IPPROTO_TCP,
        extensions: ExtensionFlags::INFO,
        states: StateFlags::all(),
        socket_id: SocketId {
            source_port: local.port(),
            destination_port: remote.port(),
            source_address: local.ip(),
            destination_address: remote.ip(),
            interface_id: interface_index(local),
            cookie: ANY_COOKIE,
        },
    };
    let mut header = NetlinkHeader::default();
    // NLM_F_DUMP is not set, so the kernel looks up one connection and does not list all of them (sock_diag(7)).
    header.flags = NLM_F_REQUEST;
    let mut message = NetlinkMessage::new(header, SockDiagMessage::InetRequest(request).into());
    message.finalize();
    let mut bytes = vec![0; message.buffer_len()];
    message.serialize(&mut bytes);
    bytes
}

/// Returns the interface of a link-local address; 0 for any other address. A link-local address is valid on one
/// interface.
fn interface_index(address: &std::net::SocketAddr) -> u32 {
    match address {
        std::net::SocketAddr::V6(address) => address.scope_id(),
        std::net::SocketAddr::V4(_) => 0,
    }
}

/// Returns the bytes of `struct tcp_info` in an answer. If the connection is gone, the kernel answers with the
/// listening socket, which is ignored.
fn find_tcp_info(addresses: &ConnectionAddresses, response: InetResponse) -> Option<Vec<u8>> {
    let destination: (IpAddr, u16) =
        (response.header.socket_id.destination_address, response.header.socket_id.destination_port);
    if destination != (addresses.remote.ip(), addresses.remote.port()) {
        return None;
    }
    response.nlas.into_iter().find_map(|attribute| match attribute {
        Nla::TcpInfo(bytes) => Some(bytes),
        _ => None,
    })
}

/// Reads the fields by their offsets in `struct tcp_info` of `linux/tcp.h`. Kernels only add fields at the end; fields
/// that an older kernel does not have are `None`.
fn parse_tcp_info(info: &[u8]) -> TransportStatistics {
    let field = |offset: usize| Some(u32::from_ne_bytes(*info.get(offset..)?.first_chunk()?));
    let total = |offset: usize| field(offset).map(u64::from);
    let micros = |value: u32| Span::from_micros(value.into());
    // tcpi_rtt and tcpi_rttvar; 0 before the first measurement.
    let round_trip = field(68).zip(field(72)).filter(|(smoothed, _)| *smoothed > 0);
    TransportStatistics {
        sent: DatagramStatistics {
            datagrams: total(156),     // tcpi_data_segs_out
            lost: None,                // tcpi_lost estimates how many are lost now, it is no total
            duplicated: total(216),    // tcpi_dsack_dups
            reordered: total(220),     // tcpi_reord_seen
            retransmitted: total(100), // tcpi_total_retrans
        },
        received: DatagramStatistics {
            datagrams: total(152), // tcpi_data_segs_in
            reordered: total(224), // tcpi_rcv_ooopack
            // Only the sender counts its retransmissions.
            ..DatagramStatistics::default()
        },
        round_trip: round_trip.map(|(smoothed, variation)| TransportRoundTrip {
            // tcpi_min_rtt; all bits are set before the first measurement.
            min: field(148).filter(|min| *min != u32::MAX).map(micros),
            smoothed: micros(smoothed),
            variation: micros(variation),
        }),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::{TcpListener, TcpStream};

    use super::*;

    fn addresses(stream: &TcpStream) -> ConnectionAddresses {
        let (local, remote) = (stream.local_addr(), stream.peer_addr());
        ConnectionAddresses { local: local.expect("connected"), remote: remote.expect("connected") }
    }

    /// Returns a connection on which the accepting end has received and acknowledged 100 kB.
    fn used_connection(address: &str) -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind(address).expect("a port");
        let mut dialled =
            TcpStream::connect(listener.local_addr().expect("bound")).expect("the listener accepts");
        let (mut accepted, _) = listener.accept().expect("a connection");
        let mut received = vec![0; 100_000];
        std::thread::scope(|scope| {
            scope.spawn(|| dialled.write_all(&[7; 100_000]).expect("the connection is open"));
            accepted.read_exact(&mut received).expect("the connection is open");
        });
        accepted.write_all(b"done").expect("the connection is open");
        dialled.read_exact(&mut [0; 4]).expect("the connection is open");
        (dialled, accepted)
    }

    #[test]
    fn both_ends_of_connection_have_round_trip_and_segments() {
        for address in ["127.0.0.1:0", "[::1]:0"] {
            if address.starts_with('[') && TcpListener::bind(address).is_err() {
                // This system has no IPv6.
                continue;
            }
            let (dialled, accepted) = used_connection(address);
            for stream in [&dialled, &accepted] {
                let info =
                    query(&addresses(stream)).expect("the kernel answers").expect("the connection is open");
                let statistics = parse_tcp_info(&info);
                let trip = statistics.round_trip.expect("data was acknowledged");
                assert!(trip.smoothed > Span::ZERO && trip.smoothed < Span::from_millis(1_000), "{trip:?}");
                assert!(trip.min.is_some_and(|min| min <= trip.smoothed + trip.variation), "{trip:?}");
                assert!(
                    statistics.sent.retransmitted.is_some() && statistics.received.lost.is_none(),
                    "{statistics:?}"
                );
            }
            let sent = tcp_statistics(&addresses(&dialled)).sent.datagrams;
            assert!(
                sent.is_some_and(|segments| segments >= 2),
                "100 kB do not fit into one segment: {sent:?}"
            );
        }
    }

    #[test]
    fn closed_connection_has_no_statistics() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let listening_address = listener.local_addr().expect("bound");
        // No connection comes from the remote address, so the kernel finds the listening socket instead.
        let unconnected = ConnectionAddresses {
            local: listening_address,
            remote: "127.0.0.1:1".parse().expect("an address"),
        };
        assert!(query(&unconnected).expect("the kernel answers").is_none());
        drop(listener);
        assert!(query(&unconnected).expect("the kernel answers").is_none());
        assert_eq!(tcp_statistics(&unconnected), TransportStatistics::default());
    }

    #[test]
    fn fields_missing_in_kernel_have_no_value() {
        let mut info = [0_u8; 104];
        info[68..72].copy_from_slice(&1_500_u32.to_ne_bytes());
        info[72..76].copy_from_slice(&300_u32.to_ne_bytes());
        info[100..104].copy_from_slice(&9_u32.to_ne_bytes());
        let statistics = parse_tcp_info(&info);
        assert_eq!(
            (statistics.sent.retransmitted, statistics.sent.datagrams, statistics.sent.reordered),
            (Some(9), None, None)
        );
        let trip = statistics.round_trip.expect("the kernel measured it");
        assert_eq!(
            (trip.min, trip.smoothed, trip.variation),
            (None, Span::from_micros(1_500), Span::from_micros(300))
        );
        assert_eq!(parse_tcp_info(&[]), TransportStatistics::default());
    }
}
