//! The agent's end with a correct aggregator, while processes are killed, the power fails, the disk fails and
//! connections end. Every event that survives in the file must be stored exactly once.

use std::collections::{BTreeSet, HashMap, VecDeque};

use proptest::prelude::*;

use super::*;

/// A correct aggregator.
#[derive(Default)]
struct Store {
    /// For each stream, the number, the chain hash and the process of the last stored batch.
    marks: HashMap<StreamId, (u64, ChainHash, Option<u64>)>,
    /// Stream of the last hello on the current connection.
    hello_stream: Option<StreamId>,
    /// Numbers of the stored events.
    event_numbers: Vec<u64>,
}

impl Store {
    fn handle_frame(&mut self, frame: Bytes) -> Option<ToAgent> {
        let Some(head) = codec::decode_batch_head(&frame) else {
            let hello = match codec::decode(&frame) {
                Ok(ToAggregator::Hello(hello)) => hello,
                Ok(ToAggregator::Echo { bytes, .. }) => return Some(ToAgent::Echo { bytes }),
                other => panic!("{other:?} was sent"),
            };
            let stream = hello.stream;
            self.hello_stream = Some(stream);
            let mark = self.marks.get(&stream).copied();
            let (stored, chain, process) = mark
                .map_or((hello.first - 1, None, None), |(stored, chain, process)| {
                    (stored, Some(chain), process)
                });
            assert!(hello.oldest <= stored + 1, "no batch is missing");
            if mark.is_none() {
                self.marks.insert(stream, (stored, hello.chain_before_oldest, None));
            }
            let aggregator = "base".parse().expect("a name");
            return Some(ToAgent::Welcome {
                aggregator,
                stream,
                stored,
                chain: chain.filter(|_| stored >= hello.first),
                process,
                window: 4,
            });
        };
        if self.hello_stream != Some(head.stream) {
            return Some(ToAgent::Unknown);
        }
        let (stored, chain, process) = self.marks.get_mut(&head.stream)?;
        if head.number == *stored + 1 {
            if head.previous_chain != *chain {
                return Some(ToAgent::Unknown);
            }
            (*stored, *chain, *process) = (head.number, head.chain, Some(head.process));
            let body = codec::decode_batch_body(frame).expect("the sent batch is intact");
            self.event_numbers.extend(event_numbers(&body, head.events));
        } else if head.number > *stored {
            return Some(ToAgent::Resend { stream: head.stream, from: *stored + 1 });
        }
        Some(ToAgent::Ack { stream: head.stream, through: *stored, window: 4 })
    }
}

/// Returns the numbers of the events in a body. Gap events have no number.
fn event_numbers(body: &[u8], count: u32) -> Vec<u64> {
    let event_number = |event: Event| match event {
        Event::Incident(incident) => incident.text.parse().ok(),
        _ => None,
    };
    let events = codec::decode_events(body, count).expect("the events are readable");
    events.into_iter().filter_map(event_number).collect()
}

struct Simulation {
    agent: Agent,
    /// Actions for the disk, in order.
    jobs: VecDeque<Action>,
    /// Frames in flight to the aggregator.
    up: VecDeque<Bytes>,
    /// Messages in flight to the agent.
    down: VecDeque<ToAgent>,
    store: Store,
    /// Number of offered events.
    offered: u64,
    /// State of the file before each action that a power failure may undo.
    unsynced: Vec<File>,
    /// Numbers of the events that were in the file when a process started, or at the end.
    surviving_events: BTreeSet<u64>,
}

impl Simulation {
    fn new() -> Self {
        let mut config = SendingConfig { batch_nodes: 2, batch_bytes: 100, spool_bytes: 2_000, ..config() };
        config.memory = Usage { events: 12, bytes: 400 };
        let (jobs, up, down, store, unsynced, surviving_events) = Default::default();
        let mut simulation =
            Self { agent: Agent::new(config), jobs, up, down, store, offered: 0, unsynced, surviving_events };
        simulation.reconnect();
        simulation
    }

    fn run(&mut self) {
        while let Some(action) = self.agent.sending.next(self.agent.now().mono) {
            match action {
                Action::Send(frame) => self.up.push_back(frame.into()),
                job => self.jobs.push_back(job),
            }
        }
        // `accounting` asserts that the numbers of events add up.
        self.agent.accounting();
    }

    fn offer(&mut self) {
        self.offered += 1;
        self.agent.sending.offer(&incident(&self.offered.to_string()), self.agent.now());
        self.run();
    }

    fn advance_ms(&mut self, millis: i64) {
        self.agent.millis += millis;
        self.agent.sending.tick(self.agent.now());
        self.run();
    }

    /// Completes the next action of the disk, or lets it fail.
    fn complete_job(&mut self) {
        let Some(job) = self.jobs.pop_front() else { return };
        // An append without batches records which batches may be sent. Such an append is synced at once.
        let is_synced = matches!(&job, Action::Append { batches, .. } if batches.is_empty())
            && !self.agent.spool_is_broken;
        let previous_file = self.agent.file.clone();
        self.agent.perform(job);
        match is_synced {
            true => self.unsynced.clear(),
            false => self.unsynced.push(previous_file),
        }
        self.run();
    }

    /// Delivers the next frame to the aggregator.
    fn deliver(&mut self) {
        if let Some(frame) = self.up.pop_front() {
            self.down.extend(self.store.handle_frame(frame));
        }
    }

    /// Delivers the aggregator's next message to the agent.
    fn answer(&mut self) {
        if let Some(message) = self.down.pop_front() {
            let _ = self.agent.sending.on_message(&message, self.agent.now());
            self.run();
        }
    }

    fn reconnect(&mut self) {
        self.agent.sending.on_disconnected();
        self.up.clear();
        self.down.clear();
        self.store.hello_stream = None;
        self.agent.sending.on_connected(self.agent.now().mono);
        self.run();
    }

    /// Starts a new process with the file that is left after a kill or a power failure. The requested actions are lost.
    /// The new process connects if `connect` is `true`.
    fn start(&mut self, file: File, connect: bool) {
        self.up.clear();
        self.down.clear();
        self.jobs.clear();
        self.unsynced.clear();
        self.store.hello_stream = None;
        let (config, host, millis, broken) =
            (self.agent.config, self.agent.host, self.agent.millis, self.agent.spool_is_broken);
        self.agent = Agent::open(config, host, file);
        (self.agent.millis, self.agent.spool_is_broken) = (millis, broken);
        self.record_surviving_events();
        if connect {
            self.reconnect();
        }
    }

    fn record_surviving_events(&mut self) {
        let batches = self.agent.file.batches.values();
        self.surviving_events.extend(batches.flat_map(|batch| event_numbers(&batch.body, batch.events)));
    }

    fn settle(&mut self) {
        self.agent.spool_is_broken = false;
        self.reconnect();
        for _ in 0..2_000 {
            if self.agent.sending.is_idle() {
                break;
            }
            while !(self.jobs.is_empty() && self.up.is_empty() && self.down.is_empty()) {
                self.complete_job();
                self.deliver();
                self.answer();
            }
            self.advance_ms(1_000);
        }
        assert!(self.agent.sending.is_idle(), "events still wait: {:?}", self.agent.sending);
        self.record_surviving_events();
        let stored: BTreeSet<u64> = self.store.event_numbers.iter().copied().collect();
        assert_eq!(
            stored.len(),
            self.store.event_numbers.len(),
            "each event is stored once: {:?}",
            self.store.event_numbers
        );
        let lost: Vec<_> = self.surviving_events.difference(&stored).collect();
        assert!(lost.is_empty(), "events in the file were not stored: {lost:?}");
    }
}

/// A step of the simulation. A number is the number of events, milliseconds, actions or messages.
#[derive(Clone, Debug)]
enum Step {
    Offer(u8),
    Pass(u16),
    CompleteJobs(u8),
    Deliver(u8),
    Answer(u8),
    Reconnect,
    SetSpoolBroken(bool),
    Kill {
        connect: bool,
    },
    /// A power failure undoes the last `undone` actions on the file that were not synced.
    PowerFailure {
        undone: u8,
        connect: bool,
    },
    /// The system writes everything to the medium.
    Sync,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => (1_u8..6).prop_map(Step::Offer),
        4 => (1_u16..1_500).prop_map(Step::Pass),
        10 => (1_u8..5).prop_map(Step::CompleteJobs),
        10 => (1_u8..5).prop_map(Step::Deliver),
        10 => (1_u8..5).prop_map(Step::Answer),
        1 => Just(Step::Reconnect),
        2 => any::<bool>().prop_map(Step::SetSpoolBroken),
        2 => any::<bool>().prop_map(|connect| Step::Kill { connect }),
        2 => (any::<u8>(), any::<bool>()).prop_map(|(undone, connect)| Step::PowerFailure { undone, connect }),
        1 => Just(Step::Sync),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn events_in_file_are_stored_once(steps in prop::collection::vec(step(), 1..80)) {
        let mut simulation = Simulation::new();
        for step in steps {
            match step {
                Step::Offer(count) => (0..count).for_each(|_| simulation.offer()),
                Step::Pass(millis) => simulation.advance_ms(millis.into()),
                Step::CompleteJobs(count) => (0..count).for_each(|_| simulation.complete_job()),
                Step::Deliver(count) => (0..count).for_each(|_| simulation.deliver()),
                Step::Answer(count) => (0..count).for_each(|_| simulation.answer()),
                Step::Reconnect => simulation.reconnect(),
                Step::SetSpoolBroken(is_broken) => {
                    // A failing disk does not lose what was written before.
                    simulation.unsynced.clear();
                    simulation.agent.spool_is_broken = is_broken;
                }
                Step::Kill { connect } => simulation.start(simulation.agent.file.clone(), connect),
                Step::PowerFailure { undone, connect } => {
                    let index = simulation.unsynced.len().saturating_sub(usize::from(undone) % 8);
                    let file = simulation.unsynced.get(index).unwrap_or(&simulation.agent.file).clone();
                    simulation.start(file, connect);
                }
                Step::Sync => simulation.unsynced.clear(),
            }
        }
        simulation.settle();
    }
}
