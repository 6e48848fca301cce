mod histories;
mod sources;
mod stepped;
mod truth;
mod verdicts;
mod violations;
mod widths;
mod wrong_stamps;

use super::*;
use crate::simulation::{HostClocks, Path, RandomSource, SimulatedClock, Trip};
use crate::{DelaySource, Interval, OneWayDelay, Verdict};

/// Creates a relation of wall clocks that trusts the claims of time daemons.
fn relation() -> Relation {
    let settings = RelationSettings {
        clocks: RelatedClocks::Wall,
        trust_time_daemons: true,
        ..RelationSettings::default()
    };
    Relation::new(settings)
}

fn host_clocks(offset: Span) -> HostClocks {
    HostClocks {
        edge: SimulatedClock::drifting(Span::ZERO, 0.0),
        cloud: SimulatedClock::drifting(offset, 10.0),
    }
}

/// Creates a relation that has learnt ten exchanges per second until the tenth second.
fn relation_with_history(host_clocks: &HostClocks) -> Relation {
    let mut relation = relation();
    for trip in Path::VETH.trips(host_clocks, (0.0, 10.0), 10.0, &mut RandomSource::new(1)) {
        assert_eq!(relation.learn(&trip.observation()), LearnResult::Accepted);
    }
    relation
}

fn at(seconds: i64) -> RawTime {
    RawTime::from_nanos(seconds * 1_000_000_000)
}

fn contains(delay: &OneWayDelay, truth: Span) -> bool {
    delay.bounds.is_some_and(|bounds| bounds.contains(truth))
}

/// Returns the intervals of the band at all seconds of a test.
fn all_intervals(relation: &Relation) -> Vec<Option<Interval>> {
    (0..40).map(|second| relation.bands.interval(at(second)).map(|offset| offset.interval)).collect()
}
