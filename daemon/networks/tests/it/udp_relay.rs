//! A relay between an edge and a cloud's UDP port. It drops, duplicates, delays and alters datagrams.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use peernet_networks::Address;
use socket2::SockRef;
use tokio::net::UdpSocket;
use tokio::task::JoinHandle;

/// Probabilities of impairments of datagrams. Percent.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PathImpairment {
    pub(crate) loss: u64,
    pub(crate) duplication: u64,
    pub(crate) delay: u64,
}

/// Offset of the kind in a datagram: the length of the group, which is the first field.
const KIND_OFFSET: usize = 8;
/// Kind of a datagram with a fragment of a message.
const DATA_KIND: u8 = 5;
/// Kind of a datagram with a heartbeat.
const PING_KIND: u8 = 9;

/// Number that stands for the alteration of a heartbeat.
const HEARTBEAT_ALTERATION: u64 = 1;
/// Number that stands for the alteration of a fragment of a message.
const FRAGMENT_ALTERATION: u64 = 2;

/// A relay for one edge. It ends when it is dropped.
pub(crate) struct UdpRelay {
    pub(crate) address: Address,
    /// Probability that a datagram is dropped. Percent.
    loss: Arc<AtomicU64>,
    /// Number of dropped datagrams.
    dropped: Arc<AtomicU64>,
    /// Alteration that the relay applies once, to the next suitable datagram from the edge; 0 for none.
    pending_alteration: Arc<AtomicU64>,
    task: JoinHandle<()>,
}

impl Drop for UdpRelay {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn socket() -> Arc<UdpSocket> {
    let socket = UdpSocket::bind("127.0.0.1:0").await.expect("a free port");
    SockRef::from(&socket).set_recv_buffer_size(4 << 20).expect("a buffer");
    Arc::new(socket)
}

impl UdpRelay {
    pub(crate) async fn start(cloud: &Address, impairment: PathImpairment, seed: u64) -> Self {
        let (edge_socket, cloud_socket) = (socket().await, socket().await);
        let address = format!("udp://{}", edge_socket.local_addr().expect("bound"));
        cloud_socket.connect(cloud.authority()).await.expect("an address");
        let loss = Arc::new(AtomicU64::new(impairment.loss));
        let dropped = Arc::new(AtomicU64::new(0));
        let pending_alteration = Arc::new(AtomicU64::new(0));
        let shared_state = (Arc::clone(&loss), Arc::clone(&dropped), Arc::clone(&pending_alteration));
        // The generator of random numbers would return only zeros if it began with 0.
        let task =
            tokio::spawn(relay_datagrams(edge_socket, cloud_socket, impairment, shared_state, seed | 1));
        Self { address: address.parse().expect("an address"), loss, dropped, pending_alteration, task }
    }

    /// Stops all datagrams, as if a cable were pulled.
    pub(crate) fn cut(&self) {
        self.loss.store(100, Ordering::Relaxed);
    }

    /// Waits until `count` datagrams were dropped.
    pub(crate) async fn wait_for_drops(&self, count: u64) {
        while self.dropped.load(Ordering::Relaxed) < count {
            tokio::task::yield_now().await;
        }
    }

    /// Alters the next heartbeat of the edge, as a faulty link would. The altered heartbeat claims that 2^20 more
    /// messages were sent. Waits until the heartbeat has passed.
    pub(crate) async fn alter_heartbeat(&self) {
        self.pending_alteration.store(HEARTBEAT_ALTERATION, Ordering::Relaxed);
        while self.pending_alteration.load(Ordering::Relaxed) > 0 {
            tokio::task::yield_now().await;
        }
    }

    /// Alters the last byte of the next long datagram from the edge that carries a fragment of a message.
    pub(crate) fn alter_fragment(&self) {
        self.pending_alteration.store(FRAGMENT_ALTERATION, Ordering::Relaxed);
    }

    /// Lets all datagrams pass again.
    pub(crate) fn restore(&self) {
        self.loss.store(0, Ordering::Relaxed);
    }
}

async fn relay_datagrams(
    edge_socket: Arc<UdpSocket>,
    cloud_socket: Arc<UdpSocket>,
    impairment: PathImpairment,
    (loss, dropped, pending_alteration): (Arc<AtomicU64>, Arc<AtomicU64>, Arc<AtomicU64>),
    mut random: u64,
) {
    let mut edge: Option<SocketAddr> = None;
    let (mut upload_buffer, mut download_buffer) = (vec![0; 65_536], vec![0; 65_536]);
    loop {
        // `to` is the address of the edge, or `None` for the cloud.
        let (datagram, to) = tokio::select! {
            Ok((length, from)) = edge_socket.recv_from(&mut upload_buffer) => {
                edge = Some(from);
                if alter(&mut upload_buffer[..length], pending_alteration.load(Ordering::Relaxed)) {
                    pending_alteration.store(0, Ordering::Relaxed);
                }
                (&upload_buffer[..length], None)
            }
            Ok(length) = cloud_socket.recv(&mut download_buffer) => {
                let Some(edge) = edge else { continue };
                (&download_buffer[..length], Some(edge))
            }
            // Receiving fails while the cloud is gone. The relay continues, because a new cloud may come.
            else => continue,
        };
        let mut chance = |percent: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random % 100 < percent
        };
        if chance(loss.load(Ordering::Relaxed)) {
            dropped.fetch_add(1, Ordering::Relaxed);
            continue;
        }
        let copies = if chance(impairment.duplication) { 2 } else { 1 };
        let is_delayed = chance(impairment.delay);
        for _ in 0..copies {
            let (edge_socket, cloud_socket, datagram) =
                (Arc::clone(&edge_socket), Arc::clone(&cloud_socket), datagram.to_vec());
            let send_copy = async move {
                // Datagrams that the sockets do not accept are lost, as on a real path.
                let _ = match to {
                    Some(edge) => edge_socket.send_to(&datagram, edge).await,
                    None => cloud_socket.send(&datagram).await,
                };
            };
            if is_delayed {
                tokio::spawn(async move {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                    send_copy.await;
                });
            } else {
                send_copy.await;
            }
        }
    }
}

/// Applies an alteration to a datagram from an edge. [`HEARTBEAT_ALTERATION`] sets bit 20 of the next message number in
/// a ping; [`FRAGMENT_ALTERATION`] changes the last byte of a long fragment of a message. Returns whether the datagram
/// was altered.
fn alter(datagram: &mut [u8], alteration: u64) -> bool {
    let kind = datagram.get(KIND_OFFSET).copied();
    if alteration == FRAGMENT_ALTERATION && kind == Some(DATA_KIND) && datagram.len() > 1_000 {
        datagram.last_mut().into_iter().for_each(|last| *last ^= 1);
        return true;
    }
    // Lengths of the fields before the next message number: group, kind, connection, time.
    const NEXT_NUMBER_OFFSET: usize = KIND_OFFSET + 1 + 8 + 8;
    let is_altered = alteration == HEARTBEAT_ALTERATION
        && kind == Some(PING_KIND)
        && datagram.len() > NEXT_NUMBER_OFFSET + 8;
    if is_altered {
        datagram[NEXT_NUMBER_OFFSET + 5] |= 1 << 4;
    }
    is_altered
}
