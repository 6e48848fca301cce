//! What two hosts tell each other of their clocks, and the stamps that relate them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, Ordering};
use std::time::Duration;

use peernet_clock::{
    Clock, ClockIdentity, DelaySource, Discipline, Interval, MonoTime, RawTime, RehearsalDescription,
    RehearsedStep, Span, Stamp, SystemClock, WallTime,
};
use peernet_logger::{Measure, NodeId, Transit};
use peernet_networks::{Exchange, PeerClock, RequestError};

use crate::hostile::plain_session;
use crate::support::{Cloud, PATIENCE, accepted, echo, log, request, sample, settings, within};
use crate::wire::Header;

/// The system's clocks, set forward by hand; every setting is a new epoch.
#[derive(Debug)]
struct Set {
    system: SystemClock,
    ahead: AtomicI64,
    epoch: AtomicU32,
    /// It is set right after the next stamp, by little.
    slips: AtomicBool,
}

impl Set {
    fn new(ahead: Span) -> Arc<Self> {
        let system = SystemClock::new(ClockIdentity::new("boot", "set"));
        Arc::new(Self {
            system,
            ahead: AtomicI64::new(ahead.nanos()),
            epoch: AtomicU32::new(0),
            slips: AtomicBool::new(false),
        })
    }

    fn forward(&self, by: Span) {
        self.ahead.fetch_add(by.nanos(), Ordering::SeqCst);
        self.epoch.fetch_add(1, Ordering::SeqCst);
    }
}

impl Clock for Set {
    fn wall(&self) -> WallTime {
        self.system.wall() + Span::from_nanos(self.ahead.load(Ordering::SeqCst))
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

    fn stamp(&self) -> Stamp {
        let stamp = Stamp { wall: self.wall(), ..self.system.stamp() };
        if self.slips.swap(false, Ordering::SeqCst) {
            self.forward(Span::from_micros(-30));
        }
        stamp
    }

    fn wall_epoch(&self) -> u32 {
        self.epoch.load(Ordering::SeqCst)
    }
}

fn transits(exchange: &Exchange) -> (Transit, Transit) {
    let transit = |node: Option<NodeId>| match &exchange
        .log
        .tree()
        .get(node.expect("on its way"))
        .expect("in the tree")
        .measure
    {
        Measure::Transit(transit) => (**transit).clone(),
        other => panic!("{other:?}"),
    };
    (transit(exchange.up), transit(exchange.down))
}

#[tokio::test]
async fn an_exchange_carries_the_four_stamps_of_its_tree() {
    let day = Span::from_seconds(86_400);
    let mut cloud = Cloud::start_by(Set::new(day)).await;
    let (session, _) = cloud.session(settings()).await;
    let exchange = echo(&mut cloud, &session, "four stamps").await;
    let (up, down) = transits(&exchange);
    let witnessed = exchange.witnessed.expect("answered");
    let stamps = witnessed.exchange;
    let of_transit =
        |transit: &Transit| (RawTime::of_wall(transit.sent), transit.received.map(RawTime::of_wall));
    assert_eq!((stamps.sent, Some(stamps.received)), of_transit(&up));
    assert_eq!((stamps.replied, Some(stamps.returned)), of_transit(&down));

    assert!(stamps.sent + day <= stamps.received && stamps.received <= stamps.replied);
    assert!(stamps.replied <= stamps.returned + day);
    assert!(stamps.lower() <= day && day <= stamps.upper(), "{:?}", stamps.bounds());
    assert!(stamps.uncertainty > Span::ZERO && stamps.uncertainty < Span::from_micros(1));
    assert_eq!((witnessed.edge_epoch, witnessed.cloud_epoch), (0, Some(0)));
    let (edge, there) = (witnessed.edge_elapsed.expect("read"), witnessed.cloud_elapsed.expect("read"));
    assert!(Span::ZERO <= there && there <= edge, "{there} of {edge}");
}

#[tokio::test]
async fn the_time_that_the_cloud_took_is_measured_whatever_its_wall_clock_does() {
    let clock = Set::new(Span::ZERO);
    let mut cloud = Cloud::start_by(clock.clone()).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "stepped", PATIENCE);
    let incoming = cloud.next_request().await;
    // Not a step that the clock notices by itself, so that only the two clocks of the cloud can show it.
    clock.ahead.fetch_add(Span::from_seconds(3).nanos(), Ordering::SeqCst);
    incoming.reply.send(incoming.log, Ok(incoming.sample));
    let exchange = within(pending).await.expect("no panic");
    let witnessed = exchange.witnessed.expect("answered");
    let by_wall = witnessed.exchange.replied - witnessed.exchange.received;
    let by_mono = witnessed.cloud_elapsed.expect("read");
    assert!(by_wall >= Span::from_seconds(3) + by_mono - Span::from_seconds(1), "{by_wall} {by_mono}");
    assert!(by_mono < witnessed.edge_elapsed.expect("read"));
}

#[tokio::test]
async fn a_clock_stepped_meanwhile_leaves_nothing_to_learn_from() {
    let clock = Set::new(Span::ZERO);
    let mut cloud = Cloud::start_by(clock.clone()).await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "stepped at the cloud", PATIENCE);
    let incoming = cloud.next_request().await;
    clock.forward(Span::from_seconds(3));
    incoming.reply.send(incoming.log, Ok(incoming.sample));
    let exchange = within(pending).await.expect("no panic");
    assert!(exchange.result.is_ok() && exchange.down.is_some());
    assert_eq!(exchange.witnessed, None);
    let exchange = echo(&mut cloud, &session, "after").await;
    assert_eq!(exchange.witnessed.expect("answered").cloud_epoch, Some(1));

    let clock = Set::new(Span::ZERO);
    let session = cloud.session_by(clock.clone()).await;
    for stepped in [true, false] {
        let pending = request(&session, "stepped at the edge", PATIENCE);
        let incoming = cloud.next_request().await;
        if stepped {
            clock.forward(Span::from_seconds(-3));
        }
        incoming.reply.send(incoming.log, Ok(incoming.sample));
        let exchange = within(pending).await.expect("no panic");
        assert!(exchange.result.is_ok());
        assert_eq!(exchange.witnessed.map(|witnessed| witnessed.edge_epoch), (!stepped).then_some(1));
    }
}

#[tokio::test]
async fn a_clock_stepped_right_after_the_first_stamp_at_a_host_leaves_nothing_to_learn_from_either() {
    let clock = Set::new(Span::ZERO);
    let mut cloud = Cloud::start_by(clock.clone()).await;
    let (session, _) = cloud.session(settings()).await;
    clock.slips.store(true, Ordering::SeqCst);
    let exchange = echo(&mut cloud, &session, "stepped at the cloud").await;
    assert_eq!((exchange.witnessed, clock.wall_epoch()), (None, 1));
    let exchange = echo(&mut cloud, &session, "after").await;
    assert_eq!(exchange.witnessed.expect("answered").cloud_epoch, Some(1));

    let clock = Set::new(Span::ZERO);
    let session = cloud.session_by(clock.clone()).await;
    clock.slips.store(true, Ordering::SeqCst);
    let exchange = echo(&mut cloud, &session, "stepped at the edge").await;
    assert_eq!((exchange.witnessed, clock.wall_epoch()), (None, 1));
    let exchange = echo(&mut cloud, &session, "after").await;
    assert_eq!(exchange.witnessed.expect("answered").edge_epoch, 1);
}

#[tokio::test]
async fn what_no_model_answered_is_no_exchange() {
    let mut cloud = Cloud::start().await;
    let (session, _) = cloud.session(settings()).await;
    let pending = request(&session, "forgotten", PATIENCE);
    drop(cloud.next_request().await);
    let exchange = within(pending).await.expect("no panic");
    assert!(exchange.arrived.is_some());
    assert_eq!(exchange.witnessed, None);
    let exchange = within(session.request(log(), &sample("x"), Duration::ZERO)).await;
    assert_eq!((exchange.result, exchange.witnessed), (Err(RequestError::Timeout), None));
}

fn news() -> PeerClock {
    let error = Interval { lo: Span::from_micros(-20), hi: Span::from_micros(30) };
    let step = RehearsedStep::of_wall(Span::from_seconds(5), Span::from_seconds(3));
    PeerClock {
        epoch: 2,
        discipline: Some(Discipline { source: DelaySource::Chrony, error }),
        text: "chrony, 3 sources".into(),
        rehearsal: Some(RehearsalDescription {
            offset: Span::from_millis(-1_000),
            drift_ppm: 49.5,
            steps: vec![step],
            since: WallTime::from_unix_nanos(7),
        }),
    }
}

#[tokio::test]
async fn an_announcement_reaches_open_sessions_and_those_to_come() {
    let mut cloud = Cloud::start().await;
    let announcer = cloud.listener.announcer();
    let (session, _) = cloud.session(settings()).await;
    let mut clock = session.peer_clock();
    assert_eq!(*clock.borrow_and_update(), accepted(cloud.host).host_clock);

    let news = news();
    announcer.clone().announce(news.clone());
    within(clock.changed()).await.expect("the session is open");
    assert_eq!(*clock.borrow_and_update(), news);

    // It was accepted with what was true before the announcement.
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
async fn any_zeromq_program_can_read_an_announcement() {
    let mut cloud = Cloud::start().await;
    let (plain, session) = plain_session(&mut cloud).await;
    cloud.listener.announcer().announce(news());
    let (Header::Clock { session: of, clock }, _) = plain.hear().await else { panic!("no announcement") };
    assert_eq!((of, clock.epoch, clock.text.as_str()), (session, 2, "chrony, 3 sources"));
    let discipline = clock.discipline.expect("announced");
    assert_eq!(
        (discipline.source.as_str(), discipline.error.lo, discipline.error.hi),
        ("chrony", -20_000, 30_000)
    );
    let rehearsal = clock.rehearsal.expect("announced");
    assert_eq!((rehearsal.offset, rehearsal.drift_ppm, rehearsal.since), (-1_000_000_000, 49.5, 7));
    let steps: Vec<_> = rehearsal.steps.iter().map(|step| (step.at, step.by)).collect();
    assert_eq!(steps, [(5_000_000_000, 3_000_000_000)]);
}
