//! Tests of a reflector that receives forged probes.

use std::net::Ipv4Addr;
use std::time::Duration;

use peernet_probes::{ProbeResult, ReflectorConfig, Refusal};
use tokio::net::UdpSocket;

use crate::support::{
    MAX_WAIT, RunningProber, RunningReflector, prober_config, reflector_config, system_clock,
};

/// Returns the number of probes that the reflector has read from its socket.
fn probes_read(running: &RunningReflector) -> u64 {
    let counts = running.counters.read();
    counts.answered + counts.refused.iter().map(|(_, count)| count).sum::<u64>()
}

/// Loopback has many addresses. The test sends from 500 of them in place of forged source addresses.
#[tokio::test]
async fn peers_are_answered_while_forged_sources_flood() {
    let config = ReflectorConfig { max_per_source_hz: 20, ..reflector_config() };
    let running = RunningReflector::start(config, system_clock("cloud"));
    running.peers.send_replace(vec![running.address.ip()]);
    let mut sockets = Vec::new();
    for number in 0..500u32 {
        let source = Ipv4Addr::from(0x7F01_0000 + number);
        sockets.push(UdpSocket::bind((source, 0)).await.expect("loopback has this address"));
    }
    let clock = system_clock("edge");
    let started_at = clock.mono();
    let mut config = prober_config(running.address);
    config.timeout = Duration::from_secs(2);
    let mut probing = RunningProber::start(config, 20.0, system_clock("edge"));
    let (mut answered, mut sent) = (0, 0);
    while answered < 40 {
        for burst in sockets.chunks(100) {
            for socket in burst {
                socket.send_to(&[0; 44], running.address).await.expect("sent");
                sent += 1;
            }
            // The socket's buffer holds about 250 packets. Further packets would be lost before the reflector reads
            // them, including the packets of the peer.
            let all_are_read = async {
                while probes_read(&running) < sent {
                    tokio::task::yield_now().await;
                }
            };
            tokio::time::timeout(MAX_WAIT, all_are_read).await.expect("all probes are read");
        }
        while let Ok(result) = probing.results.try_recv() {
            assert_ne!(result, ProbeResult::Lost, "after {answered} answers and {sent} forged probes");
            answered += u32::from(matches!(result, ProbeResult::Answered(_)));
        }
    }
    let seconds = (clock.mono() - started_at).seconds();
    let counts = running.counters.read();
    // All sources without a session share ten times the rate of one source, with a burst of one second. The peer's
    // answers come on top.
    let max_answers = 200.0 * (1.0 + seconds) + f64::from(answered) + 1.0;
    assert!((counts.answered as f64) <= max_answers, "{} in {seconds} s: {counts:?}", counts.answered);
    assert!(counts.refused(Refusal::TooMany) > 0, "{counts:?}");
    probing.stop().await;
    running.stop().await;
}
