//! Tests of foreign reflectors that the configuration names: their answers are used for the relation with the
//! reflector's clock only.

use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use peernet_clock::{RelatedClocks, Span, Verdict};
use peernet_stream::{LiveUpdate, Probing, ReflectorLive};
use tokio::net::UdpSocket;

use super::{CLOUD, pipeline};
use crate::harness::{TestAgent, config};

/// A process that is killed at the end of the test.
struct ForeignReflector(Child);

impl Drop for ForeignReflector {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the reflector of stamp-suite at an address. The reflector reads this machine's clock.
fn start_stamp_suite(address: SocketAddr) -> ForeignReflector {
    let program = std::env::var_os("PEERNET_STAMP_SUITE").unwrap_or_else(|| "stamp-suite".into());
    let mut command = Command::new(&program);
    command
        .args(["--is-reflector", "--local-addr", &address.ip().to_string()])
        .args(["--local-port", &address.port().to_string()])
        .env_remove("STAMP_HMAC_KEY")
        .env("RUST_LOG", "warn")
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    let child = command.spawn();
    ForeignReflector(child.unwrap_or_else(|error| {
        panic!("{} does not run: {error}; deploy/install-tools.sh test installs it", program.display())
    }))
}

/// Starts a cloud, and an edge that names a reflector for it.
async fn start_with_reflector(reflector: SocketAddr) -> (TestAgent, TestAgent) {
    let cloud = TestAgent::start_with_clock_name("cloud", None, config(CLOUD), "cloud").await;
    let load = "load = { mode = 'rate', hz = 20.0 }\nlimit = { iterations = 100000 }";
    let tables = format!(
        "[probes]\nreflectors = {{ cloud = 'udp://{reflector}' }}\n{}",
        pipeline("line", &cloud, load)
    );
    let edge = TestAgent::start_with_clock_name("edge", None, config(&tables), "edge").await;
    (edge, cloud)
}

fn any_reflector(condition: impl Fn(&ReflectorLive) -> bool) -> impl Fn(&LiveUpdate) -> bool {
    move |live| live.links.iter().any(|link| link.reflector.as_ref().is_some_and(&condition))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn named_foreign_reflector_gets_relation_of_its_own() {
    // The port is outside the range of ephemeral ports. Only this test uses the address.
    let address: SocketAddr = "127.86.21.1:18620".parse().expect("an address");
    let _foreign = start_stamp_suite(address);
    let (edge, cloud) = start_with_reflector(address).await;
    let is_known = |reflector: &ReflectorLive| {
        let offset = reflector.offset.as_ref();
        reflector.probes.answered >= 10 && offset.is_some_and(|offset| offset.verdict == Verdict::Ok)
    };
    let live = edge.until(any_reflector(is_known)).await;
    let link = &live.links[0];
    let reflector = link.reflector.as_ref().expect("the configuration names a reflector");
    assert_eq!(reflector.address, format!("udp://{address}"));
    assert!(
        matches!(&reflector.probing, Probing::On { address: to, .. } if *to == reflector.address),
        "{reflector:?}"
    );
    // The reflector reads the same wall clock as the edge.
    let offset = reflector.offset.as_ref().expect("known");
    assert!(offset.bounds.contains(Span::ZERO), "{offset:?}");
    assert!(offset.bounds.width() < Span::from_millis(100), "{offset:?}");
    assert!(reflector.round_trip.is_some_and(|trip| trip.min > Span::ZERO), "{reflector:?}");
    assert_eq!(reflector.probes.refused, 0, "{reflector:?}");
    // The relation of edge and cloud is separate, and relates the free-running clocks of these two hosts.
    assert_eq!(link.latest_sample.clocks(), RelatedClocks::Raw);
    assert!(matches!(&link.probing, Probing::On { address: to, .. } if *to != reflector.address), "{link:?}");
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn garbage_from_configured_reflector_gives_no_offset() {
    let socket = UdpSocket::bind("127.0.0.1:0").await.expect("a port");
    let address = socket.local_addr().expect("bound");
    let garbage = tokio::spawn(async move {
        let mut buffer = [0; 2048];
        while let Ok((length, from)) = socket.recv_from(&mut buffer).await {
            // The answers are: too few bytes, the request itself, and noise as long as a reply.
            for answer in [&buffer[..3], &buffer[..length], &[0x5A; 200][..]] {
                socket.send_to(answer, from).await.expect("loopback takes it");
            }
        }
    });
    let (edge, cloud) = start_with_reflector(address).await;
    let is_unanswered = |reflector: &ReflectorLive| matches!(&reflector.probing, Probing::Unanswered { reason: Some(reason), .. } if reason.contains("refused"));
    let live = edge.until(any_reflector(is_unanswered)).await;
    let link = &live.links[0];
    let reflector = link.reflector.as_ref().expect("the configuration names a reflector");
    assert!(reflector.probes.refused > 0 && reflector.probes.lost > 0, "{reflector:?}");
    assert_eq!((reflector.probes.answered, &reflector.offset), (0, &None));
    // The cloud's own reflector is still probed.
    assert!(link.latest_sample.offset.is_some() && matches!(link.probing, Probing::On { .. }), "{link:?}");
    assert_eq!(link.latest_sample.probes.refused, 0);
    edge.stop().await.expect("stops well");
    cloud.stop().await.expect("stops well");
    garbage.abort();
}
