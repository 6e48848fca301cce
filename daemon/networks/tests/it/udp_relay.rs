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

/// A relay for one edge. It ends when it is dropped.
pub(crate) struct UdpRelay {
    pub(crate) address: Address,
    loss: Arc<AtomicU64>,
    dropped: Arc<AtomicU64>,
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
        let (front, back) = (socket().await, socket().await);
        let address = format!("udp://{}", front.local_addr().expect("bound"));
        back.connect(cloud.authority()).await.expect("an address");
        let loss = Arc::new(AtomicU64::new(impairment.loss));
        let dropped = Arc::new(AtomicU64::new(0));
        let alterations = Arc::new(AtomicU64::new(0));
        let counts = (Arc::clone(&loss), Arc::clone(&dropped), Arc::clone(&alterations));
        let task = tokio::spawn(relay_datagrams(front, back, impairment, counts, seed | 1));
        Self { address: address.parse().expect("an address"), loss, dropped, alterations, task }
    }

    /// Stops all datagrams, as if a cable were pulled.
    pub(crate) fn cut(&self) {
        self.loss.store(100, Ordering::Relaxed);
    }

    /// Waits until a datagram was dropped.
    pub(crate) async fn dropped(&self) {
        while self.dropped.load(Ordering::Relaxed) == 0 {
            tokio::task::yield_now().await;
        }
    }

    /// Alters the next heartbeat of the edge, as a faulty link would: it claims that 2^20 more messages were sent.
    /// Waits until it has passed.
    pub(crate) async fn alter_heartbeat(&self) {
        self.alterations.store(1, Ordering::Relaxed);
        while self.alterations.load(Ordering::Relaxed) > 0 {
            tokio::task::yield_now().await;
        }
    }

    /// Lets all datagrams pass again.
    pub(crate) fn restore(&self) {
        self.loss.store(0, Ordering::Relaxed);
    }
}

async fn relay_datagrams(
    front: Arc<UdpSocket>,
    back: Arc<UdpSocket>,
    impairment: PathImpairment,
    (loss, dropped, alterations): (Arc<AtomicU64>, Arc<AtomicU64>, Arc<AtomicU64>),
    mut random: u64,
) {
    let mut edge: Option<SocketAddr> = None;
    let (mut up, mut down) = (vec![0; 65_536], vec![0; 65_536]);
    loop {
        let (datagram, to) = tokio::select! {
            Ok((length, from)) = front.recv_from(&mut up) => {
                edge = Some(from);
                if alterations.load(Ordering::Relaxed) > 0 && alter(&mut up[..length]) {
                    alterations.store(0, Ordering::Relaxed);
                }
                (&up[..length], None)
            }
            Ok(length) = back.recv(&mut down) => {
                let Some(edge) = edge else { continue };
                (&down[..length], Some(edge))
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
            let (front, back, datagram) = (Arc::clone(&front), Arc::clone(&back), datagram.to_vec());
            let pass = async move {
                // Datagrams that the sockets do not accept are lost, as on a real path.
                let _ = match to {
                    Some(edge) => front.send_to(&datagram, edge).await,
                    None => back.send(&datagram).await,
                };
            };
            if is_delayed {
                tokio::spawn(async move {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                    pass.await;
                });
            } else {
                pass.await;
            }
        }
    }
}

/// Sets bit 20 of the next message number in a ping of an edge. Returns whether the datagram is such a ping.
fn alter(datagram: &mut [u8]) -> bool {
    // Group, kind, connection, time.
    const NEXT: usize = 8 + 1 + 8 + 8;
    let is_ping = datagram.get(8) == Some(&9) && datagram.len() > NEXT + 8;
    if is_ping {
        datagram[NEXT + 5] |= 1 << 4;
    }
    is_ping
}
