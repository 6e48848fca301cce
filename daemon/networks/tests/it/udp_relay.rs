//! A relay before a cloud's UDP port that drops, duplicates, delays and alters datagrams.

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

/// Alteration of a heartbeat.
const HEARTBEAT: u64 = 1;
/// Alteration of a part of a message.
const DATA: u64 = 2;

/// A relay for one edge. It ends when it is dropped.
pub(crate) struct UdpRelay {
    pub(crate) address: Address,
    /// Probability that a datagram is dropped. Percent.
    loss: Arc<AtomicU64>,
    /// Number of dropped datagrams.
    dropped: Arc<AtomicU64>,
    /// Alteration of the next datagram of the edge to which it applies; 0 for none.
    alterations: Arc<AtomicU64>,
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
        let alterations = Arc::new(AtomicU64::new(0));
        let counts = (Arc::clone(&loss), Arc::clone(&dropped), Arc::clone(&alterations));
        let task = tokio::spawn(relay_datagrams(edge_socket, cloud_socket, impairment, counts, seed | 1));
        Self { address: address.parse().expect("an address"), loss, dropped, alterations, task }
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
        self.alterations.store(HEARTBEAT, Ordering::Relaxed);
        while self.alterations.load(Ordering::Relaxed) > 0 {
            tokio::task::yield_now().await;
        }
    }

    /// Alters the next long datagram of the edge with a part of a message: its last byte.
    pub(crate) fn alter_data(&self) {
        self.alterations.store(DATA, Ordering::Relaxed);
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
    (loss, dropped, alterations): (Arc<AtomicU64>, Arc<AtomicU64>, Arc<AtomicU64>),
    mut random: u64,
) {
    let mut edge: Option<SocketAddr> = None;
    let (mut upload_buffer, mut download_buffer) = (vec![0; 65_536], vec![0; 65_536]);
    loop {
        let (datagram, to) = tokio::select! {
            Ok((length, from)) = edge_socket.recv_from(&mut upload_buffer) => {
                edge = Some(from);
                if alter(&mut upload_buffer[..length], alterations.load(Ordering::Relaxed)) {
                    alterations.store(0, Ordering::Relaxed);
                }
                (&upload_buffer[..length], None)
            }
            Ok(length) = cloud_socket.recv(&mut download_buffer) => {
                let Some(edge) = edge else { continue };
                (&download_buffer[..length], Some(edge))
            }
            // The port of a cloud that is gone reports errors.
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

/// Alters a datagram of an edge: of a ping ([`HEARTBEAT`]) bit 20 of the next message number, of a long datagram of a
/// message ([`DATA`]) the last byte. Returns whether the datagram is of this kind.
fn alter(datagram: &mut [u8], alteration: u64) -> bool {
    if alteration == DATA && datagram.get(8) == Some(&5) && datagram.len() > 1_000 {
        datagram.last_mut().into_iter().for_each(|last| *last ^= 1);
        return true;
    }
    // Group, kind, connection, time.
    const NEXT: usize = 8 + 1 + 8 + 8;
    let is_ping = alteration == HEARTBEAT && datagram.get(8) == Some(&9) && datagram.len() > NEXT + 8;
    if is_ping {
        datagram[NEXT + 5] |= 1 << 4;
    }
    is_ping
}
