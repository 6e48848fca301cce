//! Test of an attacker on the path who can read and change probes, but not the session.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use peernet_clock::{Span, Verdict};
use peernet_stream::Probing;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UdpSocket};

use super::{CLOUD, DELAY_NAMES, assert_interval_contains, delay, pipeline};
use crate::harness::{Aggregator, TestAgent, config};

/// Delay of data in each direction, which determines the width of the interval from honest exchanges.
const ONE_WAY_DELAY: Duration = Duration::from_millis(20);
/// Amount added to the cloud's stamps: so little that the exchanges of data do not contradict the forged stamps.
const ADDED: Span = Span::from_millis(13);

/// Forwards the bytes of a connection with a delay.
async fn forward(mut from: impl AsyncReadExt + Unpin, mut to: impl AsyncWriteExt + Unpin) -> io::Result<()> {
    let (queue, mut queued) = tokio::sync::mpsc::channel(1024);
    let reading = async move {
        let mut buffer = vec![0; 65_536];
        loop {
            let length = from.read(&mut buffer).await?;
            let due = tokio::time::Instant::now() + ONE_WAY_DELAY;
            if length == 0 || queue.send((due, buffer[..length].to_vec())).await.is_err() {
                return io::Result::Ok(());
            }
        }
    };
    let writing = async {
        while let Some((due, bytes)) = queued.recv().await {
            tokio::time::sleep_until(due).await;
            to.write_all(&bytes).await?;
        }
        to.shutdown().await
    };
    tokio::try_join!(reading, writing).map(|_| ())
}

/// Forwards connections to `cloud`, delayed by [`ONE_WAY_DELAY`] in both directions.
async fn relay_data(listener: TcpListener, cloud: SocketAddr) {
    while let Ok((edge_side, _)) = listener.accept().await {
        let cloud_side = TcpStream::connect(cloud).await.expect("the cloud listens");
        let ((edge_read, edge_write), (cloud_read, cloud_write)) =
            (edge_side.into_split(), cloud_side.into_split());
        tokio::spawn(forward(edge_read, cloud_write));
        tokio::spawn(forward(cloud_read, edge_write));
    }
}

/// Forwards probes at once and forges each answer.
async fn relay_probes(edge_side: UdpSocket, reflector: SocketAddr, forged: Arc<AtomicUsize>) {
    let cloud_side = UdpSocket::bind("127.0.0.2:0").await.expect("a port");
    let (mut request_buffer, mut answer_buffer) = ([0; 2048], [0; 2048]);
    let mut edge = None;
    loop {
        tokio::select! {
            Ok((length, from)) = edge_side.recv_from(&mut request_buffer) => {
                edge = Some(from);
                cloud_side.send_to(&request_buffer[..length], reflector).await.expect("loopback takes it");
            }
            Ok((length, _)) = cloud_side.recv_from(&mut answer_buffer) => {
                let answer = &mut answer_buffer[..length];
                forge(answer);
                forged.fetch_add(1, Ordering::Relaxed);
                let edge = edge.expect("a probe precedes each answer");
                edge_side.send_to(answer, edge).await.expect("loopback takes it");
            }
        }
    }
}

/// Changes an answer so that the cloud's clocks seem to be ahead by [`ADDED`]. Changes the stamps of the wall clock,
/// whose positions depend on the layout of the base packet, and the stamps of the free-running clock.
fn forge(answer: &mut [u8]) {
    let ntp = (ADDED.nanos() << 32) / 1_000_000_000;
    // The authenticated layout has zeros here (RFC 8762, section 4.3.2).
    let is_unauthenticated = answer[4..12] != [0; 8];
    for index in if is_unauthenticated { [4, 16] } else { [16, 32] } {
        let stamp: [u8; 8] = answer[index..index + 8].try_into().expect("eight bytes");
        answer[index..index + 8]
            .copy_from_slice(&u64::from_be_bytes(stamp).wrapping_add_signed(ntp).to_be_bytes());
    }
    let position_of_stamps =
        answer.windows(4).position(|bytes| bytes == b"PRAW").expect("stamps of the free-running clock");
    for index in [position_of_stamps + 8, position_of_stamps + 16] {
        let stamp: [u8; 8] = answer[index..index + 8].try_into().expect("eight bytes");
        answer[index..index + 8].copy_from_slice(&(i64::from_be_bytes(stamp) + ADDED.nanos()).to_be_bytes());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn delays_do_not_depend_on_forged_probe_answers() {
    let aggregator = Aggregator::start().await;
    let edge_side = UdpSocket::bind("127.0.0.2:0").await.expect("a port");
    let port = edge_side.local_addr().expect("bound").port();
    // The edge sends its probes to the host of the data, 127.0.0.2, and to the port that the cloud announces. This port
    // on 127.0.0.2 belongs to `edge_side`; on 127.0.0.1 it belongs to the cloud's reflector.
    let tables = config(&format!("{CLOUD}[probes]\nport = {port}\n"));
    let cloud = TestAgent::start_with_clock_name("cloud", None, tables, "cloud").await;
    let address: SocketAddr = cloud.address().trim_start_matches("tcp://").parse().expect("an address");
    let data = TcpListener::bind("127.0.0.2:0").await.expect("a port");
    let relayed_address = format!("tcp://{}", data.local_addr().expect("bound"));
    let forged = Arc::new(AtomicUsize::new(0));
    let relays = [
        tokio::spawn(relay_data(data, address)),
        tokio::spawn(relay_probes(edge_side, SocketAddr::new(address.ip(), port), Arc::clone(&forged))),
    ];

    let load = "load = { mode = 'rate', hz = 50.0 }\nmax_in_flight = 16\nlimit = { iterations = 300 }";
    let table = pipeline("line", &cloud, load).replace(&cloud.address(), &relayed_address);
    let edge =
        TestAgent::start_with_clock_name("edge", Some(&aggregator.address), config(&table), "edge").await;
    let is_refused = |probing: &Probing| {
        let Probing::Unanswered { reason: Some(reason), .. } = probing else { return false };
        reason.contains("not authenticated by the key") && reason.ends_with(" refused)")
    };
    edge.until(|live| live.links.iter().any(|link| is_refused(&link.probing))).await;
    let received_events = aggregator.until(|received_events| !received_events.run_ends().is_empty()).await;
    let mut judged = 0;
    for iteration in received_events.iterations() {
        for name in DELAY_NAMES {
            let delay = delay(iteration, name);
            assert!(delay.raw > Span::from_millis(19), "{delay:?}");
            if matches!(delay.verdict, Verdict::Ok | Verdict::Limited) {
                // Both agents read one clock.
                assert_interval_contains(&delay, delay.raw);
                judged += 1;
            }
        }
    }
    assert!(judged > 500, "{judged}");
    edge.stop().await.expect("stops well");
    let received_events = aggregator.until(|received_events| !received_events.goodbyes.is_empty()).await;
    let counts = received_events.clock_samples().iter().fold((0, 0), |(answered, lost), sample| {
        (answered + sample.probes.answered, lost + sample.probes.lost)
    });
    assert!(counts.0 == 0 && counts.1 > 0, "{counts:?}");
    assert!(
        received_events.clock_samples().iter().any(|sample| sample.probes.refused > 0),
        "clock samples count the refused answers"
    );
    let probed = received_events.clock_samples().into_iter().filter(|sample| sample.probes.sent > 0);
    for sample in probed {
        assert_eq!(sample.basis.and_then(|basis| basis.probes_authenticated), Some(true));
    }
    assert!(forged.load(Ordering::Relaxed) > 20);
    relays.iter().for_each(tokio::task::JoinHandle::abort);
    cloud.stop().await.expect("stops well");
}
