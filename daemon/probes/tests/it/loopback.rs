//! Tests of the prober and the reflector over real sockets.

use std::time::Duration;

use peernet_clock::{
    Clock, ClockFaultStep, ClockFaults, ClockIdentity, ExchangeObservation, FaultyClock, Interval, MonoTime,
    RawTime, RelatedClocks, SharedClock, Span, SystemClock, WallTime,
};
use peernet_probes::{
    BindError, Key, ProbeResult, Prober, Reflector, ReflectorConfig, Refusal, TimestampSource,
};
use tokio::net::UdpSocket;
use tokio_util::sync::CancellationToken;

use crate::support::{
    INSTANCE, RunningProber, RunningReflector, key, loopback, prober_config, reflector_config, system_clock,
    wall_minus_raw,
};

fn answered(result: &ProbeResult) -> Option<ExchangeObservation> {
    if let ProbeResult::Answered(observation) = result { Some(*observation) } else { None }
}

fn refined(result: &ProbeResult) -> Option<ExchangeObservation> {
    if let ProbeResult::Refined(observation) = result { Some(*observation) } else { None }
}

/// Returns whether the bounds of an exchange on one clock contain the true offset of zero.
fn contains_zero(observation: &ExchangeObservation) -> bool {
    let Interval { lo, hi } = observation.exchange.bounds();
    lo <= Span::ZERO && Span::ZERO <= hi
}

async fn collect_results(
    reflector: ReflectorConfig,
    stamps: TimestampSource,
    key: Option<Key>,
) -> Vec<ProbeResult> {
    let running = RunningReflector::start(reflector, system_clock("cloud"));
    let mut config = prober_config(running.address);
    (config.stamps, config.key) = (stamps, key);
    let mut probing = RunningProber::start(config, 500.0, system_clock("edge"));
    let mut results = Vec::new();
    while results.iter().filter_map(answered).count() < 100 {
        results.push(probing.next().await);
    }
    results.extend(probing.stop().await);
    let answers = results.iter().filter_map(answered).count() as u64;
    assert!(running.counters.read().answered >= answers);
    assert_eq!(running.counters.read().refused.iter().map(|(_, count)| count).sum::<u64>(), 0);
    running.stop().await;
    results
}

#[tokio::test]
async fn exchanges_on_one_clock_contain_zero_offset() {
    for (stamps, with_key, stateful) in [
        (TimestampSource::Kernel, false, true),
        (TimestampSource::Kernel, true, true),
        (TimestampSource::Program, false, false),
        (TimestampSource::Program, true, true),
    ] {
        let key = with_key.then(|| key(7));
        let config = ReflectorConfig { stamps, stateful, key: key.clone(), ..reflector_config() };
        let results = collect_results(config, stamps, key).await;
        for result in &results {
            match result {
                ProbeResult::Answered(observation) | ProbeResult::Refined(observation) => {
                    assert!(contains_zero(observation), "{stamps:?}: {observation:?}");
                    assert_eq!((observation.edge_epoch, observation.cloud_epoch), (0, Some(0)));
                    assert!(observation.exchange.round_trip() >= Span::ZERO, "{observation:?}");
                }
                ProbeResult::Sent => {}
                other => panic!("{other:?}"),
            }
        }
        let sent = results.iter().filter(|result| **result == ProbeResult::Sent).count();
        assert!(sent >= results.iter().filter_map(answered).count());
    }
}

#[tokio::test]
async fn kernel_stamps_are_used_and_refine_reply_time() {
    let running = RunningReflector::start(reflector_config(), system_clock("cloud"));
    let prober = Prober::open(prober_config(running.address), system_clock("edge")).expect("a socket");
    assert_eq!(prober.stamp_source_name(), "kernel, send and receive");
    drop(prober);
    for (stateful, expected_name) in [(true, "kernel, send and receive"), (false, "kernel, receive only")] {
        let config = ReflectorConfig { stateful, ..reflector_config() };
        let reflector = Reflector::bind(config, system_clock("cloud")).expect("a free port");
        assert_eq!(reflector.stamp_source_name(), expected_name);
    }
    let mut probing = RunningProber::start(prober_config(running.address), 200.0, system_clock("edge"));
    let mut observations = Vec::new();
    for _ in 0..20 {
        let (refined_observation, earlier_results) = probing.until(refined).await;
        observations.extend(earlier_results.iter().filter_map(answered));
        let first = observations
            .iter()
            .find(|observation| observation.exchange.sent == refined_observation.exchange.sent)
            .expect("answered before it was refined");
        assert!(refined_observation.exchange.replied > first.exchange.replied);
        let unrefined_observation = ExchangeObservation {
            exchange: peernet_clock::Exchange {
                replied: first.exchange.replied,
                ..refined_observation.exchange
            },
            ..refined_observation
        };
        assert_eq!(&unrefined_observation, first, "nothing else is different");
        assert!(contains_zero(&refined_observation), "{refined_observation:?}");
    }
    probing.stop().await;
    running.stop().await;
}

#[tokio::test]
async fn reflector_without_sessions_or_kernel_stamps_refines_nothing() {
    for config in [
        ReflectorConfig { stateful: false, ..reflector_config() },
        ReflectorConfig { stamps: TimestampSource::Program, ..reflector_config() },
    ] {
        let results = collect_results(config, TimestampSource::Kernel, None).await;
        assert_eq!(results.iter().filter_map(refined).count(), 0);
    }
}

#[tokio::test]
async fn bounds_contain_offset_of_shifted_clock() {
    let truth = system_clock("edge");
    let ahead = Span::from_millis(1370);
    let description = ClockFaults { offset: ahead, drift_ppm: 0.0, steps: Vec::new(), since: truth.wall() };
    let cloud: SharedClock = std::sync::Arc::new(FaultyClock::new(
        system_clock("cloud"),
        ClockIdentity::new("test", "faulty"),
        description,
    ));
    let running = RunningReflector::start(reflector_config(), cloud);
    let mut probing = RunningProber::start(prober_config(running.address), 200.0, truth);
    for _ in 0..50 {
        let (observation, _) = probing.until(answered).await;
        let Interval { lo, hi } = observation.exchange.bounds();
        assert!(lo <= ahead && ahead <= hi, "{observation:?}");
    }
    probing.stop().await;
    running.stop().await;
}

/// Returns a wall clock that is set a thousand times, by large steps and by steps as small as the time between the
/// stamps of the program and of the kernel.
fn repeatedly_set_clock(name: &str, interval: Span, step_sizes: [Span; 2]) -> SharedClock {
    let truth = system_clock(name);
    let step_time = |number: i64| Span::from_nanos(interval.nanos() * number);
    let steps = (1..=1000)
        .map(|number| ClockFaultStep::wall_step(step_time(number), step_sizes[number as usize % 2]));
    let description =
        ClockFaults { offset: Span::ZERO, drift_ppm: 0.0, steps: steps.collect(), since: truth.wall() };
    std::sync::Arc::new(FaultyClock::new(truth, ClockIdentity::new("test", name), description))
}

#[tokio::test]
async fn setting_wall_clocks_changes_no_exchange() {
    let (large_step, small_step) = (Span::from_millis(20), Span::from_micros(15));
    for direction in [1, -1] {
        let step_sizes = [large_step, small_step].map(|size| Span::from_nanos(direction * size.nanos()));
        let cloud = repeatedly_set_clock("cloud", Span::from_millis(7), step_sizes);
        let edge = repeatedly_set_clock("edge", Span::from_millis(5), step_sizes);
        let running = RunningReflector::start(reflector_config(), cloud.clone());
        let mut probing = RunningProber::start(prober_config(running.address), 500.0, edge.clone());
        let (mut answers, mut refinements) = (0, 0);
        while answers < 300 {
            match probing.next().await {
                ProbeResult::Answered(observation) => {
                    assert!(contains_zero(&observation), "{observation:?}");
                    answers += 1;
                }
                ProbeResult::Refined(observation) => {
                    assert!(contains_zero(&observation), "{observation:?}");
                    refinements += 1;
                }
                ProbeResult::Sent => {}
                other => panic!("{other:?}"),
            }
        }
        assert!(refinements > 0, "the kernel's stamps are still used between the steps");
        assert!(
            edge.wall_epoch() > 50 && cloud.wall_epoch() > 50,
            "both wall clocks were set during the test"
        );
        probing.stop().await;
        running.stop().await;
    }
}

#[tokio::test]
async fn padded_probes_over_ipv6_and_ipv4_are_answered() {
    let listen = "[::]:0".parse().expect("an address");
    let running =
        RunningReflector::start(ReflectorConfig { listen, ..reflector_config() }, system_clock("cloud"));
    for host in ["::1", "127.0.0.1"] {
        let target = std::net::SocketAddr::new(host.parse().expect("an address"), running.address.port());
        let mut config = prober_config(target);
        config.padding_bytes = 1000;
        let mut probing = RunningProber::start(config, 100.0, system_clock("edge"));
        let (observation, _) = probing.until(answered).await;
        assert!(contains_zero(&observation), "{host}: {observation:?}");
        probing.stop().await;
    }
    running.stop().await;
}

#[tokio::test]
async fn prober_without_the_key_gets_no_reply() {
    let config = ReflectorConfig { key: Some(key(7)), ..reflector_config() };
    let running = RunningReflector::start(config, system_clock("cloud"));
    for other_key in [Some(key(8)), None] {
        let mut config = prober_config(running.address);
        // Without the TLV for raw stamps, an unauthenticated request is shorter than the base packet of an
        // authenticated request.
        (config.key, config.clocks) = (other_key, RelatedClocks::RawToWall);
        config.timeout = Duration::from_millis(50);
        let mut probing = RunningProber::start(config, 100.0, system_clock("edge"));
        let (_, earlier_results) = probing.until(|result| (*result == ProbeResult::Lost).then_some(())).await;
        assert!(earlier_results.iter().all(|result| *result == ProbeResult::Sent), "{earlier_results:?}");
        probing.stop().await;
    }
    let counts = running.counters.read();
    assert_eq!(counts.answered, 0);
    assert!(counts.refused(Refusal::Unauthenticated) > 0 && counts.refused(Refusal::Short) > 0, "{counts:?}");
    running.stop().await;
}

#[tokio::test]
async fn source_above_its_rate_is_answered_at_limit() {
    let config = ReflectorConfig { max_per_source_hz: 5, ..reflector_config() };
    let running = RunningReflector::start(config, system_clock("cloud"));
    let socket = UdpSocket::bind(loopback()).await.expect("a socket");
    let request = [0; 44];
    // 200 requests at once. The limit would allow more of them if they were sent over a longer time.
    let clock = system_clock("edge");
    let started_at = clock.mono();
    for _ in 0..200 {
        socket.send_to(&request, running.address).await.expect("sent");
    }
    let counters = running.counters.clone();
    let all_requests_are_counted = async {
        loop {
            let counts = counters.read();
            if counts.answered + counts.refused(Refusal::TooOften) == 200 {
                return counts;
            }
            tokio::task::yield_now().await;
        }
    };
    let counts = tokio::time::timeout(crate::support::MAX_WAIT, all_requests_are_counted)
        .await
        .expect("all requests are read");
    let max_answers = 5.0 + 5.0 * (clock.mono() - started_at).seconds();
    assert!(
        counts.answered >= 5 && counts.answered as f64 <= max_answers + 1.0,
        "{counts:?}, at most {max_answers}"
    );
    running.stop().await;
}

#[tokio::test]
async fn rate_can_be_changed_and_zero_pauses() {
    let running = RunningReflector::start(reflector_config(), system_clock("cloud"));
    let mut probing = RunningProber::start(prober_config(running.address), 0.0, system_clock("edge"));
    let result = tokio::time::timeout(Duration::from_millis(200), probing.results.recv()).await;
    assert!(result.is_err(), "nothing is sent while paused: {result:?}");
    // The first probe after a pause is sent within 0.1 s. At this rate, the second probe would be sent a quarter of an
    // hour later: the test only ends in time if the next rate applies at once.
    probing.rate_hz.send(0.001).expect("the prober listens");
    probing.until(answered).await;
    probing.rate_hz.send(100.0).expect("the prober listens");
    for _ in 0..10 {
        probing.until(answered).await;
    }
    probing.rate_hz.send(0.0).expect("the prober listens");
    // Results of probes in flight may still arrive, but nothing afterwards.
    while tokio::time::timeout(Duration::from_millis(300), probing.results.recv()).await.is_ok() {}
    probing.stop().await;
    running.stop().await;
}

#[tokio::test]
async fn prober_without_reflector_loses_probes_and_continues() {
    let silent_socket = UdpSocket::bind(loopback()).await.expect("a socket");
    let mut config = prober_config(silent_socket.local_addr().expect("bound"));
    config.timeout = Duration::from_millis(20);
    let mut probing = RunningProber::start(config.clone(), 100.0, system_clock("edge"));
    for _ in 0..3 {
        probing.until(|result| (*result == ProbeResult::Lost).then_some(())).await;
    }
    // No program has the port now, and the system reports that.
    drop(silent_socket);
    for _ in 0..3 {
        probing.until(|result| (*result == ProbeResult::Lost).then_some(())).await;
    }
    // A reflector starts on the port.
    let running = RunningReflector::start(
        ReflectorConfig { listen: config.target, ..reflector_config() },
        system_clock("cloud"),
    );
    probing.until(answered).await;
    probing.stop().await;
    running.stop().await;
}

/// The system's clock as a program under libfaketime sees it: the program is shown a false time, and the kernel does
/// not know of the shift.
#[derive(Debug)]
struct ShiftedClock {
    system: SystemClock,
    ahead: Span,
}

impl Clock for ShiftedClock {
    fn wall(&self) -> WallTime {
        self.system.wall() + self.ahead
    }

    fn mono(&self) -> MonoTime {
        self.system.mono()
    }

    fn raw(&self) -> RawTime {
        self.system.raw()
    }

    fn identity(&self) -> &ClockIdentity {
        self.system.identity()
    }
}

fn shifted_clock(ahead: Span) -> SharedClock {
    std::sync::Arc::new(ShiftedClock { system: SystemClock::new(ClockIdentity::new("test", "shown")), ahead })
}

#[tokio::test]
async fn bounds_hold_with_shifted_program_clock() {
    // With the small shift, the kernel's departure stamps look plausible. With the large shift they do not.
    let (small_shift, large_shift) = (Span::from_millis(900), Span::from_seconds(3600));
    for (edge, cloud) in [
        (-small_shift, Span::ZERO),
        (large_shift, Span::ZERO),
        (Span::ZERO, -small_shift),
        (Span::ZERO, large_shift),
        (-small_shift, large_shift),
    ] {
        for clocks in [RelatedClocks::Raw, RelatedClocks::RawToWall] {
            let running = RunningReflector::start(reflector_config(), shifted_clock(cloud));
            let mut config = prober_config(running.address);
            (config.instance, config.clocks) = (Some(INSTANCE), clocks);
            let mut probing = RunningProber::start(config, 200.0, shifted_clock(edge));
            let assert_bounds_hold = |observation: &ExchangeObservation| {
                let bounds = observation.exchange.bounds();
                let offset = match clocks {
                    RelatedClocks::Raw => Interval::exactly(Span::ZERO),
                    _ => wall_minus_raw(cloud),
                };
                assert!(bounds.intersection(offset).is_some(), "{clocks}: {offset:?} and {bounds:?}");
            };
            for _ in 0..30 {
                assert_bounds_hold(&probing.until(answered).await.0);
            }
            for result in probing.stop().await {
                if let ProbeResult::Refined(observation) = result {
                    assert_bounds_hold(&observation);
                }
            }
            running.stop().await;
        }
    }
}

#[tokio::test]
async fn stamp_source_is_known_before_first_probe() {
    let target = loopback();
    for (ahead, expected_name) in
        [(Span::ZERO, "kernel, send and receive"), (Span::from_millis(50), "program")]
    {
        let mut prober = Prober::open(prober_config(target), shifted_clock(ahead)).expect("a socket");
        prober.check_stamps().await;
        assert_eq!(prober.stamp_source_name(), expected_name, "{ahead}");
    }
}

#[tokio::test]
async fn reply_of_unexpected_process_is_refused() {
    let running = RunningReflector::start(reflector_config(), system_clock("cloud"));
    let config = peernet_probes::ProberConfig { instance: Some(7), ..prober_config(running.address) };
    let mut probing = RunningProber::start(config, 100.0, system_clock("edge"));
    let refusal =
        |result: &ProbeResult| if let ProbeResult::Refused(reason) = result { Some(*reason) } else { None };
    let (reason, earlier_results) = probing.until(refusal).await;
    assert_eq!(reason, "the probes are answered by another process than the one that serves the data");
    assert!(earlier_results.iter().all(|result| *result == ProbeResult::Sent), "{earlier_results:?}");
    probing.stop().await;
    running.stop().await;
}

#[tokio::test]
async fn reply_from_another_address_is_refused() {
    let target = UdpSocket::bind(loopback()).await.expect("a socket");
    let other_socket = UdpSocket::bind(loopback()).await.expect("a socket");
    let mut probing =
        RunningProber::start(prober_config(target.local_addr().expect("bound")), 1.0, system_clock("edge"));
    let mut packet = [0; 2048];
    let (bytes, prober) = target.recv_from(&mut packet).await.expect("a probe");
    other_socket.send_to(&packet[..bytes], prober).await.expect("sent");
    let refusal =
        |result: &ProbeResult| if let ProbeResult::Refused(reason) = result { Some(*reason) } else { None };
    assert_eq!(probing.until(refusal).await.0, "not from the target");
    target.send_to(&packet[..bytes], prober).await.expect("sent");
    assert_eq!(probing.until(refusal).await.0, "without the stamps of the reflector's free-running clock");
    target.send_to(&packet[..10], prober).await.expect("sent");
    assert_eq!(probing.until(refusal).await.0, "shorter than a reply");
    probing.stop().await;
}

#[tokio::test]
async fn prober_ends_when_receiver_is_dropped() {
    let silent_socket = UdpSocket::bind(loopback()).await.expect("a socket");
    let config = prober_config(silent_socket.local_addr().expect("bound"));
    let prober = Prober::open(config, system_clock("edge")).expect("a socket");
    // The rate stays at zero, so the prober has no result whose sending would fail.
    let (_rate, rate_hz) = tokio::sync::watch::channel(0.0);
    let (result_sender, results) = tokio::sync::mpsc::channel(1);
    let task = tokio::spawn(prober.run(rate_hz, result_sender, CancellationToken::new()));
    drop(results);
    tokio::time::timeout(crate::support::MAX_WAIT, task).await.expect("the prober ends").expect("no panic");
}

#[tokio::test]
async fn bind_errors_contain_advice() {
    let first_reflector = Reflector::bind(reflector_config(), system_clock("cloud")).expect("a free port");
    let same_port = ReflectorConfig { listen: first_reflector.address(), ..reflector_config() };
    let error = Reflector::bind(same_port, system_clock("cloud")).expect_err("taken");
    assert!(matches!(error, BindError::InUse(_)) && error.to_string().contains("another port"), "{error}");

    let foreign_address = "192.0.2.1:8620".parse().expect("an address");
    let error = Reflector::bind(
        ReflectorConfig { listen: foreign_address, ..reflector_config() },
        system_clock("cloud"),
    )
    .expect_err("no machine has an address for documentation");
    assert!(matches!(error, BindError::NoSuchAddress(_)), "{error}");

    let privileged_address = "127.0.0.1:862".parse().expect("an address");
    let error = BindError::NotPermitted(privileged_address).to_string();
    assert!(error.contains("grant CAP_NET_BIND_SERVICE or use port 8620"), "{error}");
}
