//! The UDP socket of the prober and of the reflector, with the kernel's packet stamps if available.

use std::fmt;
use std::future::{pending, poll_fn};
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Once;
use std::task::Poll;
use std::time::Duration;

use peernet_clock::{SharedClock, WallTime};
use timestamped_socket::socket::{
    GeneralTimestampMode, Open, SendTimestampToken, Socket, Timestamp, TimestampData, open_ip,
};

use crate::stamp::uncertainty::ORDER_TOLERANCE;

/// Time limit of the loopback packet that checks the kernel's stamps.
const LOOPBACK_TIMEOUT: Duration = Duration::from_millis(200);

/// Maximum number of loopback packets for one check.
// A packet gives no result if the clock is set in the meantime.
const MAX_LOOPBACK_ATTEMPTS: u32 = 3;

/// Argument of [`open_ip`]: `false`, so that no other socket can be bound to the same address and port.
const REUSE_ADDRESS: bool = false;

/// Source of the timestamps of packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimestampSource {
    /// The kernel stamps packets. If the kernel does not support this, the program stamps them.
    #[default]
    Kernel,
    /// The program stamps packets around its system calls. Required if the program reads another clock than the kernel.
    Program,
}

/// Identifies a sent packet when the kernel's stamp of its departure arrives.
pub(crate) type Token = SendTimestampToken;

/// A packet that was received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceivedPacket {
    /// Length of the packet. Bytes.
    pub(crate) bytes: usize,
    pub(crate) source: SocketAddr,
    /// Address of this machine to which the packet was sent; unspecified if the system did not report it.
    pub(crate) local: SocketAddr,
    /// Kernel's stamp of the arrival, converted to the program's clock; `None` if the packet has no stamp, or if
    /// stamps are ignored.
    pub(crate) kernel_stamp: Option<WallTime>,
}

/// A UDP socket for probes or their answers.
pub(crate) struct ProbeSocket {
    inner: Socket<SocketAddr, Open>,
    mode: GeneralTimestampMode,
    clock: SharedClock,
    /// `true` if the kernel's stamps are ignored, because the kernel and the program read different clocks.
    kernel_stamps_disabled: bool,
}

impl fmt::Debug for ProbeSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ProbeSocket({}, {})", self.address(), self.stamp_source_name())
    }
}

impl ProbeSocket {
    /// Binds a socket to `address`, with the best of the wanted stamps that the kernel supports. `with_departures`
    /// also asks for stamps of departures, each of which costs a system call.
    pub(crate) fn bind(
        address: SocketAddr,
        stamps: TimestampSource,
        with_departures: bool,
        clock: SharedClock,
    ) -> io::Result<Self> {
        let modes: &[GeneralTimestampMode] = match stamps {
            TimestampSource::Kernel if with_departures => {
                &[GeneralTimestampMode::SoftwareAll, GeneralTimestampMode::SoftwareRecv]
            }
            TimestampSource::Kernel => &[GeneralTimestampMode::SoftwareRecv],
            TimestampSource::Program => &[],
        };
        for &mode in modes {
            match open_ip(address, mode, REUSE_ADDRESS) {
                Ok(inner) => return Ok(Self { inner, mode, clock, kernel_stamps_disabled: false }),
                // The kernel does not support the option, as some sandboxes and old kernels do not.
                Err(error) if is_unsupported_option(&error) => {
                    tracing::debug!(%address, ?mode, %error, "the kernel does not support this mode of packet stamps");
                }
                Err(error) => return Err(error),
            }
        }
        // A socket without kernel stamps is used if the kernel supports none of the wanted modes.
        let mode = GeneralTimestampMode::None;
        Ok(Self { inner: open_ip(address, mode, REUSE_ADDRESS)?, mode, clock, kernel_stamps_disabled: false })
    }

    /// Opens a socket for sending to `target`. The socket is bound to any address and port of the same family,
    /// so that it follows changes of the route.
    pub(crate) fn open_for_target(
        target: SocketAddr,
        stamps: TimestampSource,
        clock: SharedClock,
    ) -> io::Result<Self> {
        let unspecified = match target {
            SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
        };
        let with_departures = true;
        Self::bind(unspecified, stamps, with_departures, clock)
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.inner.local_addr()
    }

    pub(crate) fn stamp_source_name(&self) -> &'static str {
        match self.mode {
            _ if self.kernel_stamps_disabled => "program",
            GeneralTimestampMode::SoftwareAll => "kernel, send and receive",
            GeneralTimestampMode::SoftwareRecv => "kernel, receive only",
            GeneralTimestampMode::None => "program",
        }
    }

    /// Returns whether the kernel stamps departures.
    pub(crate) fn stamps_departures(&self) -> bool {
        self.mode == GeneralTimestampMode::SoftwareAll
    }

    /// Checks with a loopback packet that the kernel stamps by the clock that the program reads.
    /// `libfaketime`, for example, shows a false time to the program alone. If the clocks differ, only the program's
    /// stamps are used from now on.
    pub(crate) async fn check_kernel_stamps(&mut self) {
        if self.mode == GeneralTimestampMode::None || self.kernel_stamps_disabled {
            return;
        }
        for _ in 0..MAX_LOOPBACK_ATTEMPTS {
            let result = tokio::time::timeout(LOOPBACK_TIMEOUT, check_kernel_clock(&self.clock)).await;
            match result.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())) {
                Ok(Some(true)) => return,
                Ok(Some(false)) => return self.disable_kernel_stamps(),
                // The clock was set meanwhile, or the packet has no stamp. Another packet is tried.
                Ok(None) => {}
                // If the check cannot be done, the kernel's stamps are used. If these stamps are of another clock,
                // `SenderState::receive` still notices this, because they violate the order of events.
                Err(error) => {
                    tracing::debug!(%error, "failed to compare the kernel's stamps with the clock");
                    return;
                }
            }
        }
    }

    /// Returns whether the kernel's stamps are ignored.
    pub(crate) const fn are_kernel_stamps_disabled(&self) -> bool {
        self.kernel_stamps_disabled
    }

    /// Uses only the program's stamps from now on.
    pub(crate) fn disable_kernel_stamps(&mut self) {
        // One warning for the process, because each link has a socket.
        static LOGGED: Once = Once::new();
        LOGGED.call_once(|| {
            tracing::warn!(
                "the kernel stamps packets by another clock than this program reads, as under libfaketime; the kernel's \
                 stamps are ignored; set timestamps = \"user\" in [clock] to stop this check"
            );
        });
        self.kernel_stamps_disabled = true;
    }

    /// Waits for the next packet. Cancel safe.
    pub(crate) async fn receive(&self, buffer: &mut [u8]) -> io::Result<ReceivedPacket> {
        let received = self.inner.recv(buffer).await?;
        Ok(ReceivedPacket {
            bytes: received.bytes_read,
            source: received.remote_addr,
            local: received.local_addr,
            kernel_stamp: self.accepted_stamp(received.timestamp_data),
        })
    }

    /// Sends a packet within `timeout`. With a timeout of zero, sends at once or fails. Returns the token of the packet
    /// if the kernel stamps departures.
    // The time is limited, because the stamp in the packet becomes old.
    pub(crate) async fn send(
        &self,
        packet: &[u8],
        from: Option<SocketAddr>,
        to: SocketAddr,
        timeout: Duration,
    ) -> io::Result<Option<Token>> {
        let sending = poll_fn(|cx| {
            let polled = match from {
                Some(from) => self.inner.poll_send_from_to(packet, from, to, cx),
                None => self.inner.poll_send_to(packet, to, cx),
            };
            match polled {
                Poll::Pending if timeout.is_zero() => Poll::Ready(Err(io::ErrorKind::WouldBlock.into())),
                polled => polled,
            }
        });
        if timeout.is_zero() {
            return sending.await;
        }
        tokio::time::timeout(timeout, sending).await.unwrap_or_else(|_| Err(io::ErrorKind::WouldBlock.into()))
    }

    /// Waits for the kernel's next stamp of a departure. Returns the token of the packet, and the stamp unless stamps
    /// are ignored. Waits forever if the kernel does not stamp departures. Cancel safe.
    pub(crate) async fn departure(&self) -> io::Result<(Token, Option<WallTime>)> {
        if !self.stamps_departures() {
            return pending().await;
        }
        let (token, stamps) = self.inner.get_send_timestamp().await?;
        Ok((token, self.accepted_stamp(stamps)))
    }

    fn accepted_stamp(&self, stamps: TimestampData) -> Option<WallTime> {
        if self.kernel_stamps_disabled { None } else { to_program_time(&self.clock, stamps) }
    }
}

/// Returns the kernel's stamp as a time of the program's clock. `None` if the packet has no stamp.
fn to_program_time(clock: &SharedClock, stamps: TimestampData) -> Option<WallTime> {
    let Timestamp { seconds, nanos } = stamps.selected_timestamp()?;
    let system_nanos = seconds.saturating_mul(1_000_000_000).saturating_add(i64::from(nanos));
    // The kernel stamps by the system's clock, from which a clock with injected faults differs.
    Some(clock.apply_faults(WallTime::from_unix_nanos(system_nanos)))
}

/// Sends a packet to this host. Returns whether the kernel's stamp of its arrival lies between two readings of the
/// clock: one before the packet was sent, one after it was received. `None` if the clock was set in between, or the
/// packet has no stamp.
async fn check_kernel_clock(clock: &SharedClock) -> io::Result<Option<bool>> {
    let loopback = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let socket = open_ip(loopback, GeneralTimestampMode::SoftwareRecv, REUSE_ADDRESS)?;
    let local = socket.local_addr();
    let epoch = clock.wall_epoch();
    let time_before = clock.wall();
    poll_fn(|cx| socket.poll_send_to(&[0], local, cx)).await?;
    let received = socket.recv(&mut [0; 1]).await?;
    let time_after = clock.wall();
    let stamp = to_program_time(clock, received.timestamp_data);
    // A step of the wall clock in between makes the comparison meaningless.
    let is_steady = clock.wall_epoch() == epoch;
    Ok(stamp
        .filter(|_| is_steady)
        .map(|stamp| time_before - ORDER_TOLERANCE <= stamp && stamp <= time_after + ORDER_TOLERANCE))
}

fn is_unsupported_option(error: &io::Error) -> bool {
    // Error numbers of Linux.
    const ENOPROTOOPT: i32 = 92;
    const EOPNOTSUPP: i32 = 95;
    error.kind() == io::ErrorKind::InvalidInput
        || error.kind() == io::ErrorKind::Unsupported
        || matches!(error.raw_os_error(), Some(ENOPROTOOPT | EOPNOTSUPP))
}
