//! Tests of the clock states that hosts exchange, and of the stamps that relate their clocks.

use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use peernet_clock::{
    Clock, ClockFaultStep, ClockFaults, ClockIdentity, DelaySource, Discipline, Interval, MonoTime, RawTime,
    RelatedClocks, Span, Stamp, SteppedClock, SystemClock, WallTime,
};
use peernet_logger::{Measure, NodeId, Transit};
use peernet_networks::{Awaited, Exchange, PeerClock, RawClock, RequestError};
use peernet_stream::VersionRange;

use crate::hostile::plain_session;
use crate::support::{Cloud, TIME_LIMIT, accepted, echo, recorder, request, sample, settings, within};
use crate::wire::Header;

/// Only version 4 of the protocol, as in releases before 0.3.0.
const VERSION_4: VersionRange = VersionRange::single(4);
const DAY: Span = Span::from_seconds(86_400);
const HOUR: Span = Span::from_seconds(3_600);

/// The system's clocks with offsets that tests set. Every change is a new epoch.
#[derive(Debug)]
struct AdjustableClocks {
    system: SystemClock,
    wall: ClockOffset,
    raw: ClockOffset,
    /// The clock that is moved slightly right after the next stamp.
    slipping: Mutex<Option<SlippingClock>>,
}

/// Offset of a clock, and the number of its changes.
#[derive(Debug, Default)]
struct ClockOffset {
    by: AtomicI64,
    epoch: AtomicU32,
}

#[derive(Clone, Copy, Debug)]
enum SlippingClock {
    Wall,
    Raw,
}

impl ClockOffset {
    fn by(&self) -> Span {
        Span::from_nanos(self.by.load(Ordering::SeqCst))
    }

    fn step_unnoticed(&self, by: Span) {
        self.by.fetch_add(by.nanos(), Ordering::SeqCst);
    }

    fn forward(&self, by: Span) {
        self.step_unnoticed(by);
        self.epoch.fetch_add(1, Ordering::SeqCst);
    }
}

impl AdjustableClocks {
    /// Creates clocks with these offsets of the wall clock and the free-running clock.
    fn new(wall: Span, raw: Span) -> Arc<Self> {
        let system = SystemClock::new(ClockIdentity::new("boot", "set"));
        let set = Self {
            system,
            wall: ClockOffset::default(),
            raw: ClockOffset::default(),
            slipping: Mutex::default(),
        };
        set.wall.step_unnoticed(wall);
        set.raw.step_unnoticed(raw);
        Arc::new(set)
    }

    fn shift_after_next_stamp(&self, slipping: SlippingClock) {
        *self.slipping.lock().expect("no panic") = Some(slipping);
    }
}

impl Clock for AdjustableClocks {
    fn wall(&self) -> WallTime {
        self.system.wall() + self.wall.by()
    }

    fn mono(&self) -> MonoTime {
        self.system.mono()
    }

    fn raw(&self) -> RawTime {
        self.system.raw() + self.raw.by()
    }

    fn identity(&self) -> &ClockIdentity {
        self.system.identity()
    }

    fn stamp(&self) -> Stamp {
        let stamp = self.system.stamp();
        let stamp = Stamp { wall: stamp.wall + self.wall.by(), raw: stamp.raw + self.raw.by(), ..stamp };
        match self.slipping.lock().expect("no panic").take() {
            Some(SlippingClock::Wall) => self.wall.forward(Span::from_micros(-30)),
            Some(SlippingClock::Raw) => self.raw.forward(Span::from_micros(-30)),
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

fn transits(exchange: &Exchange) -> (Transit, Transit) {
    let transit = |node: Option<NodeId>| match &exchange
        .recorder
        .tree()
        .get(node.expect("on its way"))
        .expect("in the tree")
        .measure
    {
        Measure::Transit(transit) => (**transit).clone(),
        other => panic!("{other:?}"),
    };
    (transit(exchange.upload), transit(exchange.download))
}

#[tokio::test]
async fn exchange_carries_raw_stamps_beside_wall_stamps() {
    let mut cloud = Cloud::start_with_clock(AdjustableClocks::new(DAY, HOUR)).await;
    let (session, _) = cloud.session(settings()).await;
    assert_eq!(session.clocks(), RelatedClocks::Raw);
    let exchange = echo(&mut cloud, &session, "four stamps").await;
    let (up, down) = transits(&exchange);
    let observation = exchange.observation.expect("answered");
    let stamps = observation.exchange;
    let raw = |transit: &Transit| transit.raw_stamps.map(|stamps| (stamps.sent, stamps.received));
    assert_eq!(raw(&up), Some((stamps.sent, stamps.received)));
    assert_eq!(raw(&down), Some((stamps.replied, stamps.returned)));
    assert!(stamps.sent + HOUR <= stamps.received && stamps.received <= stamps.replied);
    assert!(stamps.replied <= stamps.returned + HOUR);
    assert!(stamps.lower() <= HOUR && HOUR <= stamps.upper(), "{:?}", stamps.bounds());
    assert!(stamps.uncertainty > Span::ZERO && stamps.uncertainty < Span::from_micros(1));

    let (there, back) =
        (up.received.expect("arrived") - up.sent, down.received.expect("arrived") - down.sent);
    assert!(there >= DAY && back <= Span::ZERO - DAY + Span::from_seconds(60), "{there} {back}");
    assert_eq!((observation.edge_epoch, observation.cloud_epoch), (0, Some(0)));
    assert_eq!(observation.cloud_elapsed, None, "nothing to compare");
}

#[tokio::test]
async fn session_of_version_four_has_wall_stamps_of_cloud() {
    let cloud_clock = AdjustableClocks::new(DAY, HOUR);
    let mut cloud = Cloud::start_with_clock(cloud_clock.clone()).await;
    let session = cloud.session_with_clock(AdjustableClocks::new(Span::ZERO, Span::ZERO), VERSION_4).await;
    assert_eq!(session.clocks(), RelatedClocks::RawToWall);
    let exchange = echo(&mut cloud, &session, "four stamps").await;
    let (up, down) = transits(&exchange);
    let observation = exchange.observation.expect("answered");
    let stamps = observation.exchange;
    let raw = |transit: &Transit| transit.raw_stamps.map(|stamps| (stamps.sent, stamps.received));
    assert_eq!(raw(&up), Some((stamps.sent, stamps.received)));
    assert_eq!(raw(&down), Some((stamps.replied, stamps.returned)));
    assert_eq!(Some(stamps.received), up.received.map(RawTime::from_wall));
    assert_eq!(stamps.replied, RawTime::from_wall(down.sent));
    let offset = cloud_clock.system.wall_ahead();
    let tolerance = Span::from_millis(1);
    let offset = Interval { lo: offset.lo + DAY - tolerance, hi: offset.hi + DAY + tolerance };
    assert!(offset.intersection(stamps.bounds()).is_some(), "{:?} {offset:?}", stamps.bounds());
    let there = observation.cloud_elapsed.expect("read");
    assert!(Span::ZERO <= there && there <= stamps.returned - stamps.sent, "{there}");

    let mut now = PeerClock { epoch: 1, ..raw_news() };
    let raw_step = ClockFaultStep { clock: SteppedClock::Raw, ..ClockFaultStep::wall_step(HOUR, HOUR) };
    now.faults.as_mut().expect("it has faults").steps.push(raw_step);
    cloud.listener.announcer().announce(now);
    let mut told = session.peer_clock();
    let told = within(told.wait_for(|clock| clock.epoch == 1)).await.expect("the session is open");
    assert_eq!(*told, PeerClock { epoch: 1, ..news() }, "version 4 has no fields for free-running clocks");
}

#[tokio::test]
async fn time_at_cloud_is_measured_despite_clock_steps() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    let mut open = Vec::new();
    for version in [4, 5] {
        let edge = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge, VersionRange::single(version)).await;
        open.push(session.clone());
        let pending = request(&session, "stepped", TIME_LIMIT);
        let incoming = cloud.next_request().await;
        // Not a step that the clock notices by itself, so that only two clocks of the cloud can show it.
        clock.wall.step_unnoticed(Span::from_seconds(3));
        incoming.reply.send(incoming.recorder, Ok(incoming.sample));
        let exchange = within(pending).await.expect("no panic");
        let observation = exchange.observation.expect("answered");
        let there = observation.exchange.replied - observation.exchange.received;
        let waited = observation.exchange.returned - observation.exchange.sent;
        if version == 4 {
            let by_mono = observation.cloud_elapsed.expect("read");
            assert!(there >= Span::from_seconds(3) + by_mono - Span::from_seconds(1), "{there} {by_mono}");
            assert!(by_mono < waited);
        } else {
            assert!(Span::ZERO <= there && there < waited, "{there} of {waited}");
        }
    }
}

#[tokio::test]
async fn moved_cloud_clock_yields_no_observation() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    let mut open = Vec::new();
    for (version, moved, untouched) in [(4, &clock.wall, &clock.raw), (5, &clock.raw, &clock.wall)] {
        let edge = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge, VersionRange::single(version)).await;
        open.push(session.clone());
        for (clock, voids) in [(moved, true), (untouched, false)] {
            let pending = request(&session, "moved at the cloud", TIME_LIMIT);
            let incoming = cloud.next_request().await;
            clock.forward(Span::from_seconds(3));
            incoming.reply.send(incoming.recorder, Ok(incoming.sample));
            let exchange = within(pending).await.expect("no panic");
            assert!(exchange.result.is_ok() && exchange.download.is_some());
            assert_eq!(
                exchange.observation.is_none(),
                voids,
                "version {version}: {:?}",
                exchange.observation
            );
        }
        let exchange = echo(&mut cloud, &session, "after").await;
        let epoch = moved.epoch.load(Ordering::SeqCst);
        assert_eq!(exchange.observation.expect("answered").cloud_epoch, Some(epoch));
    }
}

#[tokio::test]
async fn interrupted_raw_clock_of_edge_yields_no_observation() {
    let mut cloud = Cloud::start().await;
    let mut open = Vec::new();
    for version in [4, 5] {
        let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(clock.clone(), VersionRange::single(version)).await;
        open.push(session.clone());
        for (moved, voids) in [(&clock.raw, true), (&clock.wall, false)] {
            let pending = request(&session, "moved at the edge", TIME_LIMIT);
            let incoming = cloud.next_request().await;
            moved.forward(Span::from_seconds(3));
            incoming.reply.send(incoming.recorder, Ok(incoming.sample));
            let exchange = within(pending).await.expect("no panic");
            assert!(exchange.result.is_ok());
            let epoch = exchange.observation.map(|observation| observation.edge_epoch);
            assert_eq!(epoch, (!voids).then_some(1), "version {version}");
        }
    }
}

#[tokio::test]
async fn clock_moved_after_first_stamp_yields_no_observation() {
    let clock = AdjustableClocks::new(Span::ZERO, Span::ZERO);
    let mut cloud = Cloud::start_with_clock(clock.clone()).await;
    let mut open = Vec::new();
    for (version, slipping) in [(4, SlippingClock::Wall), (5, SlippingClock::Raw)] {
        let edge = AdjustableClocks::new(Span::ZERO, Span::ZERO);
        let session = cloud.session_with_clock(edge.clone(), VersionRange::single(version)).await;
        open.push(session.clone());
        clock.shift_after_next_stamp(slipping);
        let exchange = echo(&mut cloud, &session, "moved at the cloud").await;
        assert_eq!(exchange.observation, None);
        let exchange = echo(&mut cloud, &session, "after").await;
        assert_eq!(exchange.observation.expect("answered").cloud_epoch, Some(1));
        edge.shift_after_next_stamp(SlippingClock::Raw);
        let exchange = echo(&mut cloud, &session, "moved at the edge").await;
        assert_eq!((exchange.observation, edge.epoch()), (None, 1));
        let exchange = echo(&mut cloud, &session, "after").await;
        assert_eq!(exchange.observation.expect("answered").edge_epoch, 1);
    }
}

#[tokio::test]
async fn request_without_model_answer_yields_no_observation() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "forgotten", TIME_LIMIT);
    drop(cloud.next_request().await);
    let exchange = within(pending).await.expect("no panic");
    assert!(exchange.arrived_at.is_some());
    assert_eq!(exchange.observation, None);
    let exchange = within(session.request(recorder(), &sample("x"), Duration::ZERO)).await;
    assert_eq!((exchange.result, exchange.observation), (Err(RequestError::Timeout(Awaited::Answer)), None));
}

fn news() -> PeerClock {
    let error = Interval { lo: Span::from_micros(-20), hi: Span::from_micros(30) };
    let step = ClockFaultStep::wall_step(Span::from_seconds(5), Span::from_seconds(3));
    PeerClock {
        epoch: 2,
        discipline: Some(Discipline { source: DelaySource::Chrony, error }),
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

fn raw_news() -> PeerClock {
    let wall_ahead = Interval { lo: Span::from_seconds(9), hi: Span::from_nanos(9_000_000_080) };
    PeerClock { raw: Some(RawClock { epoch: 4, wall_ahead, clocksource: "tsc".into() }), ..news() }
}

#[tokio::test]
async fn announcement_reaches_all_open_and_later_sessions() {
    let mut cloud = Cloud::start().await;
    let announcer = cloud.listener.announcer();
    let (session, _) = cloud.session(settings()).await;
    let mut clock = session.peer_clock();
    assert_eq!(*clock.borrow_and_update(), accepted(cloud.host).host_clock);

    let news = raw_news();
    announcer.clone().announce(news.clone());
    within(clock.changed()).await.expect("the session is open");
    assert_eq!(*clock.borrow_and_update(), news);

    // The session was accepted with the state before the announcement.
    let (later, _) = cloud.session(settings()).await;
    assert_eq!(*later.peer_clock().borrow(), news);
    assert_eq!(later.accepted().host_clock, news);

    within(session.close()).await;
    cloud.next_closed().await;
    announcer.announce(PeerClock::default());
    echo(&mut cloud, &later, "still open").await;
    assert_eq!(*later.peer_clock().borrow(), PeerClock::default());
    drop(cloud);
    announcer.announce(news);
}

#[tokio::test]
async fn plain_zeromq_socket_reads_announcement() {
    let mut cloud = Cloud::start().await;
    let (plain, session) = plain_session(&mut cloud).await;
    cloud.listener.announcer().announce(news());
    let (Header::Clock { session: of, clock }, _) = plain.receive_message().await else {
        panic!("no announcement")
    };
    assert_eq!((of, clock.epoch, clock.text.as_str()), (session, 2, "chrony, 3 sources"));
    let discipline = clock.discipline.expect("announced");
    assert_eq!(
        (discipline.source.as_str(), discipline.error.lo, discipline.error.hi),
        ("chrony", -20_000, 30_000)
    );
    let faults = clock.faults.expect("announced");
    assert_eq!((faults.offset, faults.drift_ppm, faults.since), (-1_000_000_000, 49.5, 7));
    let steps: Vec<_> = faults.steps.iter().map(|step| (step.at, step.by)).collect();
    assert_eq!(steps, [(5_000_000_000, 3_000_000_000)]);
}
