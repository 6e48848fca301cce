//! A UDP socket that sends and receives many datagrams with one system call.

use std::io::{self, IoSliceMut};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use quinn_udp::{RecvMeta, Transmit, UdpSocketState};
use socket2::{Domain, SockRef, Socket, Type};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use crate::transport::datagram::endpoint::Route;
use crate::transport::datagram::sending::Batch;

/// Number of buffers that one system call fills.
const BUFFERS: usize = 8;

/// Size of each buffer. The kernel joins datagrams of one sender up to 64 KiB. Bytes.
const BUFFER_BYTES: usize = 64 * 1024;

/// A bound UDP socket.
pub(super) struct UdpPort {
    socket: UdpSocket,
    state: UdpSocketState,
    address: SocketAddr,
    /// Size of the kernel's receive buffer, including the kernel's overhead. Bytes.
    receive_buffer: usize,
    caveat: Option<String>,
}

/// Memory for received datagrams.
pub(super) struct ReceiveBuffers(Vec<u8>);

impl ReceiveBuffers {
    pub(super) fn new() -> Self {
        Self(vec![0; BUFFERS * BUFFER_BYTES])
    }
}

impl std::fmt::Debug for UdpPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UdpPort").field("address", &self.address).finish()
    }
}

/// Returns the address of this host from which datagrams to a peer are sent at present. Sends nothing.
///
/// # Errors
/// If there is no route to the peer.
pub(super) fn source_address(peer: SocketAddr) -> io::Result<IpAddr> {
    let socket = std::net::UdpSocket::bind((unspecified_address(peer), 0))?;
    socket.connect(peer)?;
    Ok(socket.local_addr()?.ip())
}

/// Returns the unspecified address of the peer's address family.
pub(super) const fn unspecified_address(peer: SocketAddr) -> IpAddr {
    match peer {
        SocketAddr::V4(_) => IpAddr::V4(Ipv4Addr::UNSPECIFIED),
        SocketAddr::V6(_) => IpAddr::V6(Ipv6Addr::UNSPECIFIED),
    }
}

/// Returns a warning about each buffer (receive, send) for which the system granted fewer bytes than requested. `None`
/// if both buffers have the requested size.
fn describe_capped_buffers(granted_bytes: [usize; 2], requested_bytes: usize) -> Option<String> {
    let buffers = ["net.core.rmem_max", "net.core.wmem_max"].into_iter().zip(granted_bytes);
    let (keys, sizes): (Vec<&str>, Vec<usize>) =
        buffers.filter(|(_, granted_bytes)| *granted_bytes < requested_bytes).unzip();
    let smallest = sizes.into_iter().min()?;
    let commands: Vec<String> =
        keys.into_iter().map(|key| format!("sysctl -w {key}={requested_bytes}")).collect();
    Some(format!(
        "the system caps the buffers of UDP sockets at {smallest} of {requested_bytes} bytes, which slows large samples \
         down; run `{}`, or set socket_buffer_bytes lower",
        commands.join(" && ")
    ))
}

impl UdpPort {
    /// Binds a socket to an address of this host, with buffers of `buffer_bytes` if the system allows this size.
    ///
    /// # Errors
    /// If the port is in use or the address does not belong to this host.
    pub(super) fn bind(address: SocketAddr, buffer_bytes: usize) -> io::Result<Self> {
        let socket = Socket::new(Domain::for_address(address), Type::DGRAM, None)?;
        socket.bind(&address.into())?;
        socket.set_nonblocking(true)?;
        let socket = UdpSocket::from_std(socket.into())?;
        let state = UdpSocketState::new((&socket).into())?;
        let options = SockRef::from(&socket);
        options.set_recv_buffer_size(buffer_bytes)?;
        options.set_send_buffer_size(buffer_bytes)?;
        // Linux sets twice the requested size, because Linux includes its own overhead (socket(7)).
        let receive_buffer = options.recv_buffer_size()?;
        let address = socket.local_addr()?;
        let granted_bytes = [receive_buffer / 2, options.send_buffer_size()? / 2];
        let caveat = describe_capped_buffers(granted_bytes, buffer_bytes);
        Ok(Self { socket, state, address, receive_buffer, caveat })
    }

    /// Makes the system report closed ports at destinations.
    ///
    /// # Errors
    /// If the system refuses.
    pub(super) fn report_errors(&self) -> io::Result<()> {
        self.state.enable_transport_errors((&self.socket).into())
    }

    /// Returns the bound address, with the actual port.
    pub(super) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns a warning about the system's limit on socket buffers, and what to do about it. `None` if the limit
    /// is high enough.
    pub(super) fn caveat(&self) -> Option<&str> {
        self.caveat.as_deref()
    }

    /// Returns the number of bytes that may be in flight to this socket: a quarter of the kernel's buffer, in which
    /// small datagrams take up to four times their size.
    pub(super) fn window(&self) -> u32 {
        u32::try_from(self.receive_buffer / 4).unwrap_or(u32::MAX)
    }

    /// Returns the maximum number of datagrams of equal length that one system call sends.
    pub(super) fn max_segments(&self) -> usize {
        self.state.max_gso_segments()
    }

    /// Sends the datagrams that are stored one after the other in `contents`. Never waits.
    ///
    /// # Errors
    /// `WouldBlock` if the socket accepts nothing more at present.
    pub(super) fn try_send(&self, route: Route, contents: &[u8], batch: Batch) -> io::Result<()> {
        let transmit = Transmit {
            destination: route.to,
            ecn: None,
            contents,
            segment_size: (batch.count > 1).then_some(batch.segment),
            src_ip: route.from,
        };
        self.socket.try_io(Interest::WRITABLE, || self.state.try_send((&self.socket).into(), &transmit))
    }

    /// Receives the datagrams that have arrived and calls `handle_datagram` for every one, with its source and the
    /// address of this host at which it arrived. Never waits.
    ///
    /// # Errors
    /// `WouldBlock` if no datagram has arrived. Other errors concern a datagram that was sent before.
    pub(super) fn try_receive(
        &self,
        buffers: &mut ReceiveBuffers,
        mut handle_datagram: impl FnMut(SocketAddr, Option<IpAddr>, &[u8]),
    ) -> io::Result<()> {
        let mut meta = [RecvMeta::default(); BUFFERS];
        let count = self.socket.try_io(Interest::READABLE, || {
            let mut chunks = buffers.0.chunks_exact_mut(BUFFER_BYTES);
            let mut slices: [IoSliceMut<'_>; BUFFERS] =
                std::array::from_fn(|_| IoSliceMut::new(chunks.next().unwrap_or_default()));
            self.state.recv((&self.socket).into(), &mut slices, &mut meta)
        })?;
        for (meta, buffer) in meta.iter().zip(buffers.0.chunks_exact(BUFFER_BYTES)).take(count) {
            // An empty datagram has no chunk below, but counts as an invalid packet.
            if meta.len == 0 {
                handle_datagram(meta.addr, meta.dst_ip, &[]);
            }
            // The kernel joins datagrams of one sender, all but the last of equal length.
            for datagram in buffer[..meta.len].chunks(meta.stride.max(1)) {
                handle_datagram(meta.addr, meta.dst_ip, datagram);
            }
        }
        Ok(())
    }

    /// Waits until a datagram may have arrived.
    ///
    /// # Errors
    /// If the system reports a closed port at a destination.
    pub(super) async fn readable(&self) -> io::Result<()> {
        let ready = self.socket.ready(Interest::READABLE | Interest::ERROR).await?;
        if !ready.is_error() {
            return Ok(());
        }
        let mut refusal = None;
        // All errors are read, because the socket reports an error until no error is left.
        let drained: io::Result<()> = self.socket.try_io(Interest::ERROR, || {
            while let Some(reported) = self.state.recv_transport_error((&self.socket).into())? {
                let error = io::Error::from_raw_os_error(reported.raw_errno);
                // Missing routes are ignored, because they may come back. A closed port does not open by itself.
                refusal =
                    refusal.take().or((error.kind() == io::ErrorKind::ConnectionRefused).then_some(error));
            }
            // With this error, `ready` waits for the next report.
            Err(io::ErrorKind::WouldBlock.into())
        });
        match (refusal, drained) {
            (Some(error), _) => Err(error),
            (None, Err(error)) if error.kind() != io::ErrorKind::WouldBlock => Err(error),
            _ => Ok(()),
        }
    }

    /// Waits until something can be sent.
    pub(super) async fn writable(&self) -> io::Result<()> {
        self.socket.writable().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warning_names_capped_buffer_with_its_size() {
        assert_eq!(describe_capped_buffers([4_096, 4_096], 4_096), None);
        let text = describe_capped_buffers([4_096, 512], 4_096).expect("the send buffer is capped");
        assert!(text.contains("at 512 of 4096 bytes"), "{text}");
        assert!(text.contains("run `sysctl -w net.core.wmem_max=4096`,"), "{text}");
        let text = describe_capped_buffers([256, 512], 4_096).expect("both buffers are capped");
        assert!(text.contains("at 256 of 4096 bytes") && text.contains("rmem_max=4096 && sysctl"), "{text}");
    }
}
