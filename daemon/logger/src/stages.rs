//! What the stages of an iteration add up to.

use peernet_clock::{Span, WallTime};

use crate::{HostIndex, Measure, Name, Node, NodeId, Tree, stage};

/// How many stages there are.
const STAGES: usize = 11;
static ORDER: [Name; STAGES] = stage::ORDER;

/// How long each standard stage of a finished tree took, and their sum.
///
/// `upload` and `download` cross hosts, so each is known only as well as the offset between two wall clocks; their
/// *sum* needs no offset. With θ what the cloud's clock is ahead of the edge's, the raw differences are
/// `upload + θ` and `download − θ`: added up, θ cancels. Put differently, the sum is the round trip on the edge's clock
/// minus the time on the cloud's clock between receipt and reply, and each of the two differences is taken on one
/// clock alone. So the sum of all stages is exact even when its split between the two directions is unknown; what is
/// left is the drift of one clock against the other during the stay (50 ppm of 100 ms are 5 µs).
///
/// A clock that is set while the sample is on the cloud does not get in: the cloud's part is taken from its
/// monotonic clock. One that is set on the edge between sending and receipt cannot be told from a delay here.
#[derive(Clone, Debug, PartialEq)]
pub struct Stages {
    durations: [Option<Span>; STAGES],
    transport: Option<Span>,
    round_trip: Option<Span>,
    total: Option<Span>,
    stages_total: Option<Span>,
}

impl Tree {
    /// The durations of the standard stages, from the children of the root.
    pub fn stages(&self) -> Stages {
        Stages::of(self)
    }
}

/// What is known of one stage's nodes: none there, all known, or one unknown.
#[derive(Clone, Copy, Default)]
struct Stage {
    present: bool,
    known: Span,
    unknown: bool,
}

impl Stage {
    fn add(&mut self, value: Option<Span>) {
        self.present = true;
        match value {
            Some(span) => self.known += span,
            None => self.unknown = true,
        }
    }

    const fn duration(self) -> Option<Span> {
        if self.present && !self.unknown { Some(self.known) } else { None }
    }
}

/// The two directions' raw differences, whose sum is exact when there are as many of one as of the other.
#[derive(Default)]
struct Transport {
    ups: usize,
    downs: usize,
    sum: Span,
    unfinished: bool,
    left: Option<WallTime>,
    back: Option<WallTime>,
}

impl Transport {
    fn add(&mut self, tree: &Tree, node: &Node) {
        let Measure::Transit(transit) = &node.measure else { return };
        let up = node.name == stage::UPLOAD;
        if up {
            self.ups += 1;
            self.left.get_or_insert(transit.sent);
        } else {
            self.downs += 1;
            self.back = transit.received;
        }
        // Away from the edge the anchor is the receipt of the upload, and the start of the download lies on the
        // same monotonic clock.
        let steady = tree.wall_start(node).filter(|_| node.host != HostIndex::EDGE);
        match transit.received {
            Some(received) => self.sum += received - steady.unwrap_or(transit.sent),
            None => self.unfinished = true,
        }
    }

    fn sum(&self) -> Option<Span> {
        let paired = self.ups > 0 && self.ups == self.downs && !self.unfinished;
        Some(self.sum).filter(|sum| paired && !sum.is_negative())
    }

    fn round_trip(&self) -> Option<Span> {
        let span = self.back? - self.left?;
        (self.ups == 1 && self.downs == 1 && !span.is_negative()).then_some(span)
    }
}

impl Stages {
    fn of(tree: &Tree) -> Self {
        let mut stages = [Stage::default(); STAGES];
        let mut transport = Transport::default();
        let mut total = Stage::default();
        for (_, node) in tree.children(NodeId::ROOT) {
            let span = match &node.measure {
                Measure::Timer(span) => *span,
                Measure::Transit(transit) => transit.delay.and_then(|delay| delay.value),
                _ => continue,
            };
            if node.name == stage::TOTAL {
                total.add(span);
            } else if let Some(at) = ORDER.iter().position(|name| *name == node.name) {
                stages[at].add(span);
                transport.add(tree, node);
            }
        }
        let transit = |at: usize| ORDER[at] == stage::UPLOAD || ORDER[at] == stage::DOWNLOAD;
        let exact = transport.sum();
        let mut stages_total = Some(exact.unwrap_or(Span::ZERO));
        for (at, stage) in stages.iter().enumerate() {
            if stage.present && !(transit(at) && exact.is_some()) {
                stages_total = stages_total.and_then(|sum| Some(sum + stage.duration()?));
            }
        }
        Self {
            durations: stages.map(Stage::duration),
            transport: exact,
            round_trip: transport.round_trip(),
            total: total.duration(),
            stages_total,
        }
    }

    /// Every stage of [`stage::ORDER`] with its duration; `None` where the stage is absent, unfinished, or its
    /// delay unknown.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Name, Option<Span>)> {
        ORDER.iter().zip(self.durations)
    }

    /// The duration of one stage by its name.
    pub fn get(&self, name: &str) -> Option<Span> {
        let at = ORDER.iter().position(|stage| stage == name)?;
        self.durations[at]
    }

    /// `upload` and `download` together, free of any offset; `None` unless the answer is back.
    pub const fn transport(&self) -> Option<Span> {
        self.transport
    }

    /// From handing the sample to the network to having the whole answer, on the edge's clock; `None` unless
    /// there was exactly one such trip and its answer is back.
    pub const fn round_trip(&self) -> Option<Span> {
        self.round_trip
    }

    /// From the intended start to the end, on the edge's monotonic clock.
    pub const fn total(&self) -> Option<Span> {
        self.total
    }

    /// The sum of all stages that are there; `None` when one of them is unfinished, or a direction's delay is
    /// unknown and the other direction is missing.
    pub const fn stages_total(&self) -> Option<Span> {
        self.stages_total
    }

    /// What the total holds beyond the sum of the stages; negative when stages overlapped.
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

    fn pass(clocks: [&Arc<ManualClock>; 2], nanos: i64) {
        clocks.iter().for_each(|clock| clock.advance(Span::from_nanos(nanos)));
    }

    /// One offloaded iteration: 10 sensing, `up`, 20 inference, `down`, 5 actuation, 3 unattributed; the cloud's
    /// clock is `offset` ahead and steps by `step` while the sample is there.
    fn offloaded(offset: i64, up: i64, down: i64, step: i64) -> Tree {
        let (edge, cloud) = (clock(1_000_000), clock(1_000_000 + offset));
        let both = [&edge, &cloud];
        let mut log = Recorder::begin(Arc::<ManualClock>::clone(&edge), HostId::random());
        let begun = log.clock().mono();
        {
            let _sensing = log.time(stage::SENSING);
            pass(both, 10);
        }
        let sent = log.clock().stamp();
        let upload = log.depart(stage::UPLOAD, sent);
        pass(both, up);
        let (tree, arrival) = (log.tree().clone(), cloud_stamp(&cloud));
        let there = Arc::<ManualClock>::clone(&cloud);
        let mut remote = Recorder::resume(there, HostId::random(), tree, upload, arrival).expect("under way");
        {
            let _inference = remote.time(stage::INFERENCE);
            pass(both, 20);
        }
        cloud.step_wall(Span::from_nanos(step));
        let download = remote.depart(stage::DOWNLOAD, cloud_stamp(&cloud));
        let growth = remote.into_growth().expect("resumed");
        pass(both, down);
        log.tree_mut().absorb(growth).expect("fits");
        let back = log.clock().wall();
        log.arrive(download, back);
        {
            let _actuation = log.time(stage::ACTUATION);
            pass(both, 5);
        }
        pass(both, 3);
        let now = log.clock().mono();
        log.timed(stage::TOTAL, begun, now);
        log.finish()
    }

    fn cloud_stamp(clock: &Arc<ManualClock>) -> peernet_clock::Stamp {
        peernet_clock::Clock::stamp(clock.as_ref())
    }

    proptest! {
        #[test]
        fn the_sum_is_exact_whatever_the_offset(
            offset in -1_i64 << 60..1 << 60, up in 0_i64..1 << 40, down in 0_i64..1 << 40, step in -1_i64 << 50..1 << 50,
        ) {
            let stages = offloaded(offset, up, down, step).stages();
            prop_assert_eq!((stages.get("upload"), stages.get("download")), (None, None));
            prop_assert_eq!(stages.transport(), Some(Span::from_nanos(up + down)));
            prop_assert_eq!(stages.round_trip(), Some(Span::from_nanos(up + 20 + down)));
            prop_assert_eq!(stages.stages_total(), Some(Span::from_nanos(10 + up + 20 + down + 5)));
            prop_assert_eq!(stages.unattributed(), Some(Span::from_nanos(3)));
        }
    }

    #[test]
    fn stages_that_are_absent_have_no_duration_and_add_nothing() {
        let clock = clock(0);
        let mut log = Recorder::begin(Arc::<ManualClock>::clone(&clock), HostId::random());
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
    fn an_answer_that_never_came_leaves_the_sum_open() {
        let clock = clock(0);
        let mut log = Recorder::begin(Arc::<ManualClock>::clone(&clock), HostId::random());
        let sent = log.clock().stamp();
        let upload = log.depart(stage::UPLOAD, sent);
        let mut tree = log.finish();
        assert_eq!(tree.stages().stages_total(), None);
        // One direction alone counts once its delay is known.
        if let Some(Measure::Transit(transit)) = tree.measure_mut(upload) {
            transit.delay = Some(OneWayDelay::same_clock(Span::from_nanos(9)));
        }
        assert_eq!(tree.stages().stages_total(), Some(Span::from_nanos(9)));
        assert_eq!((tree.stages().transport(), tree.stages().round_trip()), (None, None));
    }

    #[test]
    fn only_children_of_the_root_are_stages() {
        let mut tree = offloaded(0, 1, 1, 0);
        let sensing = tree.find(&["sensing"]).expect("recorded").0;
        tree.add(sensing, stage::INFERENCE, Span::ZERO, Measure::Timer(Some(Span::from_seconds(1))));
        tree.add(NodeId::ROOT, Name::from("extra"), Span::ZERO, Measure::Timer(Some(Span::from_seconds(1))));
        assert_eq!(tree.stages().stages_total(), Some(Span::from_nanos(37)));
    }
}
