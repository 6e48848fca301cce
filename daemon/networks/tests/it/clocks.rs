//! Tests of the clock states that hosts exchange, and of the stamps that relate their clocks.

use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_clock::{
    Clock, ClockClaim, ClockFaultStep, ClockFaults, ClockIdentity, DelaySource, Interval, MonoTime, RawTime,
    RelatedClocks, Span, Stamp, SteppedClock, SystemClock, WallTime,
};
use peernet_logger::{Measure, NodeId, Transit};
use peernet_networks::{AwaitedEvent, CompletedRequest, PeerClock, RawClock, RequestError};
use peernet_stream::VersionRange;

use crate::hostile::plain_session;
use crate::support::{Cloud, TIME_LIMIT, accepted, echo, recorder, request, sample, settings, within};
use crate::wire::Header;

/// Versions of a peer that speaks only version 4 of the protocol, as releases before 0.3.0 do.
const VERSION_4: VersionRange = VersionRange::single(4);
const DAY: Span = Span::from_seconds(86_400);
const HOUR: Span = Span::from_seconds(3_600);

/// The system's clocks with offsets that tests set.
#[derive(Debug)]
struct AdjustableClocks {
    system: SystemClock,
    wall: ClockOffset,
    raw: ClockOffset,
    /// The clock that steps by −30 µs after the next stamp.
    clock_to_step: Mutex<Option<ClockToStep>>,
}

/// Offset of a clock, and the number of its noticed steps.
#[derive(Debug, Default)]
struct ClockOffset {
    nanos: AtomicI64,
    epoch: AtomicU32,
}

/// One of the two clocks that tests step.
#[derive(Clone, Copy, Debug)]
enum ClockToStep {
    Wall,
    Raw,
}

impl ClockOffset {
    fn span(&self) -> Span {
        Span::from_nanos(self.nanos.load(Ordering::SeqCst))
    }

    /// Steps the clock without a new epoch.
    fn step_unnoticed(&self, by: Span) {
        self.nanos.fetch_add(by.nanos(), Ordering::SeqCst);
    }

    /// Steps the clock, which starts a new epoch.
    fn step(&self, by: Span) {
        self.step_unnoticed(by);
        self.epoch.fetch_add(1, Ordering::SeqCst);
    }
}

impl AdjustableClocks {
    /// Creates clocks with these offsets of the wall clock and the free-running clock.
    fn new(wall: Span, raw: Span) -> Arc<Self> {
        let system = SystemClock::new(ClockIdentity::new("boot", "set"));
        let clocks = Self {
            system,
            wall: ClockOffset::default(),
            raw: ClockOffset::default(),
            clock_to_step: Mutex::default(),
        };
        clocks.wall.step_unnoticed(wall);
        clocks.raw.step_unnoticed(raw);
        Arc::new(clocks)
    }

    fn step_after_next_stamp(&self, clock: ClockToStep) {
        *self.clock_to_step.lock().expect("no panic") = Some(clock);
    }
}

impl Clock for AdjustableClocks {
    fn wall(&self) -> WallTime {
        self.system.wall() + self.wall.span()
    }

    fn mono(&self) -> MonoTime {
        self.system.mono()
    }

    fn raw(&self) -> RawTime {
        self.system.raw() + self.raw.span()
    }

    fn identity(&self) -> &ClockIdentity {
        self.system.identity()
    }

    fn stamp(&self) -> Stamp {
        let stamp = self.system.stamp();
        let stamp = Stamp { wall: stamp.wall + self.wall.span(), raw: stamp.raw + self.raw.span(), ..stamp };
        match self.clock_to_step.lock().expect("no panic").take() {
            Some(ClockToStep::Wall) => self.wall.step(Span::from_micros(-30)),
            Some(ClockToStep::Raw) => self.raw.step(Span::from_micros(-30)),
            None => {}
        }
        stamp
    }

    fn epoch(&self) -> u32 {
        self.raw.epoch.load(Ordering::SeqCst)
    }

    fn wall_epoch(&self) -> u32 {
        self.wall.epoch.load(Ordering::SeqCst)
    }
}

fn transits(completed: &CompletedRequest) -> (Transit, Transit) {
    let transit = |node: Option<NodeId>| match &completed
        .recorder
        .tree()
        .get(node.expect("the request was answered"))
        .expect("in the tree")
        .measure
    {
        Measure::Transit(transit) => (**transit).clone(),
        other => panic!("{other:?}"),
    };
    (transit(completed.upload), transit(completed.download))
}

#[tokio::test]
async fn exchange_carries_raw_stamps_beside_wall_stamps() {
    let mut cloud = Cloud::start_with_clock(AdjustableClocks::new(DAY, HOUR)).await;
    let (session, _) = cloud.session(settings()).await;
    assert_eq!(session.clocks(), RelatedClocks::Raw);
    let completed = echo(&mut cloud, &session, "four stamps").await;
    let (upload, download) = transits(&completed);
    let observation = completed.observation.expect("answered");
    let stamps = observation.exchange;
    let raw = |transit: &Transit| transit.raw_stamps.map(|stamps| (stamps.sent, stamps.received));
    assert_eq!(raw(&upload), Some((stamps.sent, stamps.received)));
    assert_eq!(raw(&download), Some((stamps.replied, stamps.returned)));
    assert!(stamps.sent + HOUR <= stamps.received && stamps.received <= stamps.replied);
    assert!(stamps.replied <= stamps.returned + HOUR);
    assert!(stamps.lower() <= HOUR && HOUR <= stamps.upper(), "{:?}", stamps.bounds());
    assert!(stamps.uncertainty > Span::ZERO && stamps.uncertainty < Span::from_micros(1));

    let (upload_span, download_span) = (
        upload.received.expect("arrived") - upload.sent,
        download.received.expect("arrived") - download.sent,
    );
    assert!(
        upload_span >= DAY && download_span <= Span::ZERO - DAY + Span::from_seconds(60),
        "{upload_span} {download_span}"
    );
    assert_eq!((observation.edge_epoch, observation.cloud_epoch), (0, Some(0)));
    assert_eq!(observation.cloud_elapsed, None, "the raw stamps give the time at the cloud");
}

#[tokio::test]
async fn session_of_version_four_has_wall_stamps_of_cloud() {
    let cloud_clock = AdjustableClocks::new(DAY, HOUR);
    let mut cloud = Cloud::start_with_clock(cloud_clock.clone()).await;
    let session = cloud.session_with_clock(AdjustableClocks::new(Span::ZERO, Span::ZERO), VERSION_4).await;
    assert_eq!(session.clocks(), RelatedClocks::RawToWall);
    let completed = echo(&mut cloud, &session, "four stamps").await;
    let (upload, download) = transits(&completed);
    let observation = completed.observation.expect("answered");
    let stamps = observation.exchange;
    let raw = |transit: &Transit| transit.raw_stamps.map(|stamps| (stamps.sent, stamps.received));
    assert_eq!(raw(&upload), Some((stamps.sent, stamps.received)));
    assert_eq!(raw(&download), Some((stamps.replied, stamps.returned)));
    assert_eq!(Some(stamps.received), upload.received.map(RawTime::from_wall));
    assert_eq!(stamps.replied, RawTime::from_wall(download.sent));
    // The clocks of the edge have no offset. The cloud's wall clock is therefore ahead of the edge's free-running clock
    // by `wall_ahead` and a day.
    let offset = cloud_clock.system.wall_ahead();
    let tolerance = Span::from_millis(1);
    let offset = Interval { lo: offset.lo + DAY - tolerance, hi: offset.hi + DAY + tolerance };
    assert!(offset.intersection(stamps.bounds()).is_some(), "{:?} {offset:?}", stamps.bounds());
    let time_at_cloud = observation.cloud_elapsed.expect("version 4 needs the time at the cloud");
    assert!(Span::ZERO <= time_at_cloud && time_at_cloud <= stamps.returned - stamps.sent, "{time_at_cloud}");

    let mut state_with_raw_step = PeerClock { epoch: 1, ..clock_state_with_raw() };
    let raw_step = ClockFaultStep { clock: SteppedClock::Raw, ..ClockFaultStep::wall_step(HOUR, HOUR) };
    state_with_raw_step.faults.as_mut().expect("it has faults").steps.push(raw_step);
    cloud.listener.announcer().announce(state_with_raw_step);
    let mut peer_clock = session.peer_clock();
    let peer_clock =
        within(peer_clock.wait_for(|clock| clock.epoch == 1)).await.expect("the session is open");
    assert_eq!(
        *peer_clock,
        PeerClock { epoch: 1, ..clock_state() },
        "version 4 has no fields for free-running clocks"
    );
}

#[tokio::test]
async fn time_at_cloud_is_measured_despite_clock_steps() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    // A session that is dropped ends, and the cloud would report the end instead of the next request.
    let mut open_sessions = Vec::new();
    for version in [4, 5] {
        let edge_clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge_clock, VersionRange::single(version)).await;
        open_sessions.push(session.clone());
        let pending = request(&session, "stepped", TIME_LIMIT);
        let incoming = cloud.next_request().await;
        // The cloud does not notice this step, so its epoch stays the same. Only a comparison of two clocks of the
        // cloud shows the step.
        clock.wall.step_unnoticed(Span::from_seconds(3));
        incoming.reply.send(incoming.recorder, Ok(incoming.sample));
        let completed = within(pending).await.expect("no panic");
        let observation = completed.observation.expect("answered");
        let time_at_cloud = observation.exchange.replied - observation.exchange.received;
        let round_trip = observation.exchange.returned - observation.exchange.sent;
        if version == 4 {
            let mono_elapsed = observation.cloud_elapsed.expect("version 4 needs the time at the cloud");
            assert!(
                time_at_cloud >= Span::from_seconds(3) + mono_elapsed - Span::from_seconds(1),
                "{time_at_cloud} {mono_elapsed}"
            );
            assert!(mono_elapsed < round_trip);
        } else {
            assert!(
                Span::ZERO <= time_at_cloud && time_at_cloud < round_trip,
                "{time_at_cloud} of {round_trip}"
            );
        }
    }
}

#[tokio::test]
async fn stepped_cloud_clock_yields_no_observation() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    // A session that is dropped ends, and the cloud would report the end instead of the next request.
    let mut open_sessions = Vec::new();
    for (version, stamped_clock, other_clock) in [(4, &clock.wall, &clock.raw), (5, &clock.raw, &clock.wall)]
    {
        let edge_clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge_clock, VersionRange::single(version)).await;
        open_sessions.push(session.clone());
        for (stepped_clock, prevents_observation) in [(stamped_clock, true), (other_clock, false)] {
            let pending = request(&session, "stepped at the cloud", TIME_LIMIT);
            let incoming = cloud.next_request().await;
            stepped_clock.step(Span::from_seconds(3));
            incoming.reply.send(incoming.recorder, Ok(incoming.sample));
            let completed = within(pending).await.expect("no panic");
            assert!(completed.result.is_ok() && completed.download.is_some());
            assert_eq!(
                completed.observation.is_none(),
                prevents_observation,
                "version {version}: {:?}",
                completed.observation
            );
        }
        let completed = echo(&mut cloud, &session, "after").await;
        let epoch = stamped_clock.epoch.load(Ordering::SeqCst);
        assert_eq!(completed.observation.expect("answered").cloud_epoch, Some(epoch));
    }
}

#[tokio::test]
async fn stepped_raw_clock_of_edge_yields_no_observation() {
    let mut cloud = Cloud::start().await;
    // A session that is dropped ends, and the cloud would report the end instead of the next request.
    let mut open_sessions = Vec::new();
    for version in [4, 5] {
        let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(clock.clone(), VersionRange::single(version)).await;
        open_sessions.push(session.clone());
        for (stepped_clock, prevents_observation) in [(&clock.raw, true), (&clock.wall, false)] {
            let pending = request(&session, "stepped at the edge", TIME_LIMIT);
            let incoming = cloud.next_request().await;
            stepped_clock.step(Span::from_seconds(3));
            incoming.reply.send(incoming.recorder, Ok(incoming.sample));
            let completed = within(pending).await.expect("no panic");
            assert!(completed.result.is_ok());
            let epoch = completed.observation.map(|observation| observation.edge_epoch);
            assert_eq!(epoch, (!prevents_observation).then_some(1), "version {version}");
        }
    }
}

#[tokio::test]
async fn clock_stepped_after_first_stamp_yields_no_observation() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    // A session that is dropped ends, and the cloud would report the end instead of the next request.
    let mut open_sessions = Vec::new();
    for (version, clock_to_step) in [(4, ClockToStep::Wall), (5, ClockToStep::Raw)] {
        let edge_clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge_clock.clone(), VersionRange::single(version)).await;
        open_sessions.push(session.clone());
        clock.step_after_next_stamp(clock_to_step);
        let completed = echo(&mut cloud, &session, "stepped at the cloud").await;
        assert_eq!(completed.observation, None);
        let completed = echo(&mut cloud, &session, "after").await;
        assert_eq!(completed.observation.expect("answered").cloud_epoch, Some(1));
        edge_clock.step_after_next_stamp(ClockToStep::Raw);
        let completed = echo(&mut cloud, &session, "stepped at the edge").await;
        assert_eq!((completed.observation, edge_clock.epoch()), (None, 1));
        let completed = echo(&mut cloud, &session, "after").await;
        assert_eq!(completed.observation.expect("answered").edge_epoch, 1);
    }
}

#[tokio::test]
async fn request_without_model_answer_yields_no_observation() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "forgotten", TIME_LIMIT);
    drop(cloud.next_request().await);
    let completed = within(pending).await.expect("no panic");
    assert!(completed.arrived_at.is_some());
    assert_eq!(completed.observation, None);
    let completed = within(session.request(recorder(), &sample("x"), Duration::ZERO)).await;
    assert_eq!(
        (completed.result, completed.observation),
        (Err(RequestError::Timeout(AwaitedEvent::Answer)), None)
    );
}

fn clock_state() -> PeerClock {
    let error = Interval { lo: Span::from_micros(-20), hi: Span::from_micros(30) };
    let step = ClockFaultStep::wall_step(Span::from_seconds(5), Span::from_seconds(3));
    PeerClock {
        epoch: 2,
        claim: Some(ClockClaim { source: DelaySource::Chrony, error }),
        text: "chrony, 3 sources".into(),
        faults: Some(ClockFaults {
            offset: Span::from_millis(-1_000),
            drift_ppm: 49.5,
            steps: vec![step],
            since: WallTime::from_unix_nanos(7),
        }),
        raw: None,
    }
}

fn clock_state_with_raw() -> PeerClock {
    let wall_ahead = Interval { lo: Span::from_seconds(9), hi: Span::from_nanos(9_000_000_080) };
    PeerClock { raw: Some(RawClock { epoch: 4, wall_ahead, clocksource: "tsc".into() }), ..clock_state() }
}

#[tokio::test]
async fn clock_announcement_reaches_all_open_and_later_sessions() {
    let mut cloud = Cloud::start().await;
    let announcer = cloud.listener.announcer();
    let (session, _) = cloud.session(settings()).await;
    let mut clock = session.peer_clock();
    assert_eq!(*clock.borrow_and_update(), accepted(cloud.host).host_clock);

    let announced_state = clock_state_with_raw();
    announcer.clone().announce(announced_state.clone());
    within(clock.changed()).await.expect("the session is open");
    assert_eq!(*clock.borrow_and_update(), announced_state);

    // The session was accepted with the state before the announcement.
    let (later_session, _) = cloud.session(settings()).await;
    assert_eq!(*later_session.peer_clock().borrow(), announced_state);
    assert_eq!(later_session.accepted().host_clock, announced_state);

    within(session.close()).await;
    cloud.next_closed().await;
    announcer.announce(PeerClock::default());
    echo(&mut cloud, &later_session, "still open").await;
    assert_eq!(*later_session.peer_clock().borrow(), PeerClock::default());
    drop(cloud);
    // An announcement after the end of the listener has no effect.
    announcer.announce(announced_state);
}

#[tokio::test]
async fn plain_zeromq_socket_reads_announcement() {
    let mut cloud = Cloud::start().await;
    let (plain_socket, session) = plain_session(&mut cloud).await;
    cloud.listener.announcer().announce(clock_state());
    let (Header::Clock { session: announced_session, clock }, _) = plain_socket.receive_message().await
    else {
        panic!("no announcement")
    };
    assert_eq!((announced_session, clock.epoch, clock.text.as_str()), (session, 2, "chrony, 3 sources"));
    let claim = clock.claim.expect("announced");
    assert_eq!((claim.source.as_str(), claim.error.lo, claim.error.hi), ("chrony", -20_000, 30_000));
    let faults = clock.faults.expect("announced");
    assert_eq!((faults.offset, faults.drift_ppm, faults.since), (-1_000_000_000, 49.5, 7));
    let steps: Vec<_> = faults.steps.iter().map(|step| (step.at, step.by)).collect();
    assert_eq!(steps, [(5_000_000_000, 3_000_000_000)]);
}
