use super::*;
use crate::ClockClaim;

fn millis(lo: i64, hi: i64) -> Interval {
    Interval { lo: Span::from_millis(lo), hi: Span::from_millis(hi) }
}

fn claim(source: DelaySource, lo: i64, hi: i64) -> Option<ClockClaim> {
    Some(ClockClaim { source, error: millis(lo, hi) })
}

/// Creates a relation whose band is about [-15, 35] ms, with an estimate of 10 ms. A message takes 30 ms up and 20 ms
/// down, and the cloud's clock is 5 ms ahead.
fn relation_over_asymmetric_path() -> Relation {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::from_millis(5), 0.0),
    };
    let path = Path { up: 30e6, down: 20e6, jitter: 1e3, loss: 0.0, burst: 0.0 };
    let mut relation = relation();
    for trip in path.trips(&host_clocks, (0.0, 10.0), 10.0, &mut RandomSource::new(1)) {
        relation.learn(&trip.observation());
    }
    relation
}

/// Returns the source, the bounds and the estimate in milliseconds, and the verdict.
fn combined_offset(relation: &Relation) -> (DelaySource, (i64, i64), i64, Verdict) {
    let offset = relation.offset(at(10), WallTime::default()).expect("known");
    let millis = |span: Span| (span.seconds() * 1e3).round() as i64;
    (
        offset.source,
        (millis(offset.bounds.lo), millis(offset.bounds.hi)),
        millis(offset.estimate),
        offset.verdict,
    )
}

#[test]
fn two_claims_alone_relate_two_clocks() {
    let mut relation = relation();
    relation.set_claims(claim(DelaySource::Kernel, -1, 2), claim(DelaySource::Kernel, 3, 8), at(10));
    assert_eq!(combined_offset(&relation), (DelaySource::Kernel, (1, 9), 5, Verdict::Ok));
    assert_eq!(relation.offset(at(0), WallTime::default()).and_then(|offset| offset.age), None);
    let delay = relation.delay(Direction::Up, at(1), at(1) + Span::from_millis(105));
    assert_eq!((delay.value, delay.verdict), (Some(Span::from_millis(100)), Verdict::Ok));
    relation.set_claims(claim(DelaySource::Kernel, -1, 2), None, at(10));
    assert_eq!(relation.offset(at(10), WallTime::default()), None);
}

#[test]
fn claims_that_are_not_trusted_change_nothing() {
    let host_clocks = host_clocks(Span::from_millis(5));
    let settings = RelationSettings::default();
    let mut relation = Relation::new(settings);
    let wrong = [claim(DelaySource::Chrony, 9, 10), claim(DelaySource::Chrony, 0, 1)];
    relation.set_claims(wrong[0], wrong[1], at(10));
    assert_eq!(relation.offset(at(10), WallTime::default()), None);
    for trip in Path::VETH.trips(&host_clocks, (0.0, 10.0), 10.0, &mut RandomSource::new(1)) {
        relation.learn(&trip.observation());
    }
    let actual = relation.offset(at(10), WallTime::default()).expect("exchanges");
    assert_eq!((actual.source, actual.verdict, actual.sources.len()), (DelaySource::InBand, Verdict::Ok, 1));
    // The drift is 10 ppm for ten seconds.
    assert!(actual.bounds.contains(Span::from_micros(5_100)));
}

#[test]
fn source_of_offset_is_claim_band_or_intersection() {
    let mut relation = relation_over_asymmetric_path();
    assert_eq!(combined_offset(&relation), (DelaySource::InBand, (-15, 35), 10, Verdict::Ok));
    let exact = claim(DelaySource::Kernel, 0, 0);
    relation.set_claims(exact, claim(DelaySource::Chrony, 4, 6), at(10));
    // The claim reveals an asymmetry by which the estimate is wrong.
    assert_eq!(combined_offset(&relation), (DelaySource::Chrony, (4, 6), 5, Verdict::Ok));
    relation.set_claims(exact, claim(DelaySource::Kernel, 4, 12), at(10));
    assert_eq!(combined_offset(&relation), (DelaySource::Kernel, (4, 12), 10, Verdict::Ok));
    relation.set_claims(exact, claim(DelaySource::Kernel, -100, 100), at(10));
    assert_eq!(combined_offset(&relation), (DelaySource::InBand, (-15, 35), 10, Verdict::Ok));
    relation.set_claims(exact, claim(DelaySource::Kernel, 0, 100), at(10));
    assert_eq!(combined_offset(&relation), (DelaySource::Intersection, (0, 35), 10, Verdict::Ok));
    relation.set_claims(exact, claim(DelaySource::Kernel, 50, 100), at(10));
    assert_eq!(combined_offset(&relation), (DelaySource::InBand, (-15, 100), 10, Verdict::Inconsistent));
    let sources = relation.offset(at(10), WallTime::default()).expect("known").sources;
    assert_eq!(sources[1], (DelaySource::Kernel, millis(50, 100)));
    assert_eq!(sources[0].0, DelaySource::InBand);
}

#[test]
fn claim_holds_without_exchanges_until_step() {
    let mut relation = relation_over_asymmetric_path();
    relation.set_claims(claim(DelaySource::Kernel, 0, 0), claim(DelaySource::Chrony, 4, 6), at(10));
    let offset_without_exchanges = relation.offset(at(300), WallTime::default()).expect("known");
    assert_eq!(
        (offset_without_exchanges.source, offset_without_exchanges.verdict),
        (DelaySource::Chrony, Verdict::Ok)
    );
    relation.restart_after_edge_step(1);
    assert_eq!(relation.offset(at(300), WallTime::default()), None);
}

/// A request is judged by a claim that was made when its answer arrived, fifteen seconds later. Meanwhile the clocks have
/// drifted apart by more than the claim is wide.
#[test]
fn claim_is_wider_at_other_times() {
    let host_clocks = HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(Span::ZERO, 100.0),
    };
    let mut relation = relation();
    // At 20 s the cloud's clock is 2 ms ahead.
    let error = Interval { lo: Span::from_micros(1_900), hi: Span::from_micros(2_100) };
    relation.set_claims(
        claim(DelaySource::Kernel, 0, 0),
        Some(ClockClaim { source: DelaySource::Kernel, error }),
        at(20),
    );
    let trip = host_clocks.trip(4.8e9, 100e6, 15e9, 100e6);
    let judged = relation.judge(&trip.observation());
    for (delay, truth) in [(judged.up, trip.up), (judged.down, trip.down)] {
        assert_eq!((delay.source, delay.verdict), (DelaySource::Kernel, Verdict::Ok));
        assert!(contains(&delay, truth), "{delay:?} {truth}");
    }
}
