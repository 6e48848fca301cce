//! Durations of the stages of an iteration, and their sum.

use peernet_clock::{Span, WallTime};

use crate::{HostIndex, Measure, Name, Node, NodeId, Tree, stage};

// A copy of the constant as a static, because `Stages::iter` returns references to the names.
static ORDER: [Name; stage::COUNT] = stage::ORDER;

/// Durations of the standard stages of a finished tree, and their sum.
///
/// `upload` and `download` cross hosts, so each contains the error of the offset between the two hosts' clocks. The
/// *sum* of the two needs no offset. With the offset θ (cloud minus edge), the raw differences are `upload + θ` and
/// `download − θ`; in the sum θ cancels. In other words, the sum is the round trip on the edge's clock minus the time
/// between receipt and reply on the cloud's clock, and each of these two times is a difference on one clock. The sum of
/// all stages is therefore exact even if it is unknown how much of it belongs to each direction. The remaining error is
/// the drift between the clocks while the sample is on the cloud (50 ppm of 100 ms are 5 µs).
///
/// A step of the cloud's wall clock while the sample is on the cloud has no effect, because the cloud's monotonic clock
/// measures the time on the cloud. A step of the edge's wall clock between sending and receipt looks like a delay.
#[derive(Clone, Debug, PartialEq)]
pub struct Stages {
    durations: [Option<Span>; stage::COUNT],
    transport: Option<Span>,
    round_trip: Option<Span>,
    total: Option<Span>,
    stages_total: Option<Span>,
}

impl Tree {
    /// Returns the durations of the standard stages, from the children of the root.
    pub fn stages(&self) -> Stages {
        Stages::from_tree(self)
    }
}

/// Sum of the durations of the nodes with one name: a stage or `total`.
#[derive(Clone, Copy, Default)]
struct DurationSum {
    /// `true` if the iteration has a node with the name.
    is_present: bool,
    /// Sum of the durations that are known.
    sum: Span,
    /// `true` if a duration is unknown.
    is_incomplete: bool,
}

impl DurationSum {
    fn add(&mut self, value: Option<Span>) {
        self.is_present = true;
        match value {
            Some(span) => self.sum += span,
            None => self.is_incomplete = true,
        }
    }

    const fn duration(self) -> Option<Span> {
        if self.is_present && !self.is_incomplete { Some(self.sum) } else { None }
    }
}

/// Sum of the raw differences of both directions. It is exact if both directions have the same number of transits.
#[derive(Default)]
struct Transport {
    uploads: usize,
    downloads: usize,
    sum: Span,
    /// `true` if a transit has no end.
    is_unfinished: bool,
    /// Time on the edge's clock at which the first upload was sent.
    first_sent: Option<WallTime>,
    /// Time on the edge's clock at which the last download was received.
    last_received: Option<WallTime>,
}

impl Transport {
    fn add(&mut self, tree: &Tree, node: &Node) {
        let Measure::Transit(transit) = &node.measure else { return };
        let is_upload = node.name == stage::UPLOAD;
        if is_upload {
            self.uploads += 1;
            self.first_sent.get_or_insert(transit.sent);
        } else {
            self.downloads += 1;
            self.last_received = transit.received;
        }
        // The cloud sends the download. The cloud's anchor is the time at which the cloud received the upload, on its
        // wall clock. The start of the download is counted from this anchor on the monotonic clock. A step of the
        // cloud's wall clock between these two times therefore has no effect.
        let cloud_sent = tree.wall_start(node).filter(|_| node.host != HostIndex::EDGE);
        match transit.received {
            Some(received) => self.sum += received - cloud_sent.unwrap_or(transit.sent),
            None => self.is_unfinished = true,
        }
    }

    fn sum(&self) -> Option<Span> {
        // The offset cancels only if each upload has a download.
        let is_paired = self.uploads > 0 && self.uploads == self.downloads && !self.is_unfinished;
        // A negative sum means that the edge's wall clock was set back during the round trip.
        Some(self.sum).filter(|sum| is_paired && !sum.is_negative())
    }

    fn round_trip(&self) -> Option<Span> {
        // Both times are of the edge's clock. A negative difference means that this clock was set back between them.
        let span = self.last_received? - self.first_sent?;
        (self.uploads == 1 && self.downloads == 1 && !span.is_negative()).then_some(span)
    }
}

impl Stages {
    fn from_tree(tree: &Tree) -> Self {
        let mut stages = [DurationSum::default(); stage::COUNT];
        let mut transport = Transport::default();
        let mut total = DurationSum::default();
        for (_, node) in tree.children(NodeId::ROOT) {
            let span = match &node.measure {
                Measure::Timer(span) => *span,
                Measure::Transit(transit) => transit.delay.and_then(|delay| delay.value),
                _ => continue,
            };
            if node.name == stage::TOTAL {
                total.add(span);
            } else if let Some(index) = ORDER.iter().position(|name| *name == node.name) {
                stages[index].add(span);
                transport.add(tree, node);
            }
        }
        let is_transit = |index: usize| ORDER[index] == stage::UPLOAD || ORDER[index] == stage::DOWNLOAD;
        // The exact sum of both directions replaces their separate delays, which depend on the offset.
        let exact_transport = transport.sum();
        let mut stages_total = Some(exact_transport.unwrap_or(Span::ZERO));
        for (index, stage) in stages.iter().enumerate() {
            if stage.is_present && !(is_transit(index) && exact_transport.is_some()) {
                // One unknown duration makes the sum unknown: a sum without it would look complete.
                stages_total = stages_total.and_then(|sum| Some(sum + stage.duration()?));
            }
        }
        Self {
            durations: stages.map(DurationSum::duration),
            transport: exact_transport,
            round_trip: transport.round_trip(),
            total: total.duration(),
            stages_total,
        }
    }

    /// Returns every stage of [`stage::ORDER`] with its duration; `None` if the stage is absent or unfinished, or its
    /// delay is unknown.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Name, Option<Span>)> {
        ORDER.iter().zip(self.durations)
    }

    /// Returns the duration of the stage with a name.
    pub fn get(&self, name: &str) -> Option<Span> {
        let index = ORDER.iter().position(|stage| stage == name)?;
        self.durations[index]
    }

    /// Returns the sum of `upload` and `download`, which needs no offset. `None` if the answer has not arrived, or if
    /// the sum is negative, because the edge's wall clock was set back during the round trip.
    pub const fn transport(&self) -> Option<Span> {
        self.transport
    }

    /// Returns the time from handing the sample to the network until the whole answer arrived, on the edge's clock;
    /// `None` unless there was exactly one such round trip and its answer arrived.
    pub const fn round_trip(&self) -> Option<Span> {
        self.round_trip
    }

    /// Returns the time from the intended start to the end on the edge's monotonic clock.
    pub const fn total(&self) -> Option<Span> {
        self.total
    }

    /// Returns the sum of all stages that the iteration has. `None` if one of them is unfinished, or if the delay of
    /// one direction is unknown and the iteration lacks the other direction.
    pub const fn stages_total(&self) -> Option<Span> {
        self.stages_total
    }

    /// Returns the part of the total that no stage accounts for; negative if stages overlapped. `None` if the total or
    /// a stage is unknown.
    pub fn unattributed(&self) -> Option<Span> {
        Some(self.total? - self.stages_total?)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use peernet_clock::{ClockIdentity, ManualClock, OneWayDelay};
    use proptest::prelude::*;

    use super::*;
    use crate::{HostId, Recorder};

    fn clock(wall: i64) -> Arc<ManualClock> {
        Arc::new(ManualClock::new(WallTime::from_unix_nanos(wall), ClockIdentity::new("b", "c")))
    }

    fn advance(clocks: [&Arc<ManualClock>; 2], nanos: i64) {
        clocks.iter().for_each(|clock| clock.advance(Span::from_nanos(nanos)));
    }

    /// Returns the tree of an offloaded iteration that lasts, in nanoseconds: 10 for sensing, `up` for the upload, 20
    /// for inference, `down` for the download, 5 for actuation, 3 unattributed. The cloud's clock is ahead by `offset`,
    /// and is stepped by `step` while the sample is on the cloud.
    fn tree_of_offloaded_iteration(offset: i64, up: i64, down: i64, step: i64) -> Tree {
        let (edge, cloud) = (clock(1_000_000), clock(1_000_000 + offset));
        let clocks = [&edge, &cloud];
        let mut log = Recorder::new(Arc::<ManualClock>::clone(&edge), HostId::random());
        let started_at = log.clock().mono();
        {
            let _sensing = log.time(stage::SENSING);
            advance(clocks, 10);
        }
        let sent = log.clock().stamp();
        let upload = log.start_transit(stage::UPLOAD, sent);
        advance(clocks, up);
        let (tree, arrival) = (log.tree().clone(), cloud_stamp(&cloud));
        let cloud_clock = Arc::<ManualClock>::clone(&cloud);
        let mut remote = Recorder::resume(cloud_clock, HostId::random(), tree, upload, arrival)
            .expect("the transit is open");
        {
            let _inference = remote.time(stage::INFERENCE);
            advance(clocks, 20);
        }
        cloud.step_wall(Span::from_nanos(step));
        let download = remote.start_transit(stage::DOWNLOAD, cloud_stamp(&cloud));
        let delta = remote.into_tree_delta().expect("the tree was resumed");
        advance(clocks, down);
        log.tree_mut().apply_delta(delta).expect("fits");
        let arrived_at = log.clock().wall();
        log.end_transit(download, arrived_at);
        {
            let _actuation = log.time(stage::ACTUATION);
            advance(clocks, 5);
        }
        advance(clocks, 3);
        let now = log.clock().mono();
        log.record_timer(stage::TOTAL, started_at, now);
        log.finish()
    }

    fn cloud_stamp(clock: &Arc<ManualClock>) -> peernet_clock::Stamp {
        peernet_clock::Clock::stamp(clock.as_ref())
    }

    proptest! {
        #[test]
        fn sum_is_exact_for_any_offset_and_step(
            offset in -1_i64 << 60..1 << 60, up in 0_i64..1 << 40, down in 0_i64..1 << 40, step in -1_i64 << 50..1 << 50,
        ) {
            let stages = tree_of_offloaded_iteration(offset, up, down, step).stages();
            // The edge has not related the two clocks, so that both delays are unknown.
            prop_assert_eq!((stages.get("upload"), stages.get("download")), (None, None));
            prop_assert_eq!(stages.transport(), Some(Span::from_nanos(up + down)));
            prop_assert_eq!(stages.round_trip(), Some(Span::from_nanos(up + 20 + down)));
            prop_assert_eq!(stages.stages_total(), Some(Span::from_nanos(10 + up + 20 + down + 5)));
            prop_assert_eq!(stages.unattributed(), Some(Span::from_nanos(3)));
        }
    }

    #[test]
    fn absent_stages_have_no_duration() {
        let clock = clock(0);
        let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
        for (name, nanos) in
            [(stage::SENSING, 4), (stage::IPC, 5), (stage::INFERENCE, 6), (stage::INFERENCE, 7)]
        {
            let _timing = log.time(name);
            clock.advance(Span::from_nanos(nanos));
        }
        let stages = log.finish().stages();
        let expected: Vec<_> = stage::ORDER
            .iter()
            .map(|name| match name.as_str() {
                "sensing" => Some(Span::from_nanos(4)),
                "ipc" => Some(Span::from_nanos(5)),
                "inference" => Some(Span::from_nanos(13)),
                _ => None,
            })
            .collect();
        assert_eq!(stages.iter().map(|(_, span)| span).collect::<Vec<_>>(), expected);
        assert_eq!(stages.stages_total(), Some(Span::from_nanos(22)));
        assert_eq!((stages.total(), stages.unattributed(), stages.transport()), (None, None, None));
    }

    #[test]
    fn missing_answer_leaves_sum_unknown() {
        let clock = clock(0);
        let mut log = Recorder::new(Arc::<ManualClock>::clone(&clock), HostId::random());
        let sent = log.clock().stamp();
        let upload = log.start_transit(stage::UPLOAD, sent);
        let mut tree = log.finish();
        assert_eq!(tree.stages().stages_total(), None);
        // The upload counts without a download as soon as its delay is known.
        if let Some(Measure::Transit(transit)) = tree.measure_mut(upload) {
            transit.delay = Some(OneWayDelay::same_clock(Span::from_nanos(9)));
        }
        assert_eq!(tree.stages().stages_total(), Some(Span::from_nanos(9)));
        assert_eq!((tree.stages().transport(), tree.stages().round_trip()), (None, None));
    }

    #[test]
    fn only_children_of_root_are_stages() {
        let mut tree = tree_of_offloaded_iteration(0, 1, 1, 0);
        let sensing = tree.find(&["sensing"]).expect("recorded").0;
        tree.add(sensing, stage::INFERENCE, Span::ZERO, Measure::Timer(Some(Span::from_seconds(1))));
        tree.add(NodeId::ROOT, Name::from("extra"), Span::ZERO, Measure::Timer(Some(Span::from_seconds(1))));
        assert_eq!(tree.stages().stages_total(), Some(Span::from_nanos(37)));
    }
}
