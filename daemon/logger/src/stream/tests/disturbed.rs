//! Both ends over a transport that loses, repeats and reorders, while either end is killed and started anew.

use std::collections::VecDeque;

use proptest::prelude::*;
use proptest::sample::Index;

use super::*;

#[derive(Clone, Debug)]
enum Step {
    Offer(u8),
    Pass(u16),
    DeliverUp(Index),
    RepeatUp(Index),
    LoseUp(Index),
    DeliverDown(Index),
    RepeatDown(Index),
    LoseDown(Index),
    Store,
    FailToStore,
    KillAgent,
    KillAggregator,
    Disconnect,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => (1_u8..6).prop_map(Step::Offer),
        6 => (1_u16..400).prop_map(Step::Pass),
        12 => any::<Index>().prop_map(Step::DeliverUp),
        2 => any::<Index>().prop_map(Step::RepeatUp),
        2 => any::<Index>().prop_map(Step::LoseUp),
        12 => any::<Index>().prop_map(Step::DeliverDown),
        2 => any::<Index>().prop_map(Step::RepeatDown),
        2 => any::<Index>().prop_map(Step::LoseDown),
        8 => Just(Step::Store),
        1 => Just(Step::FailToStore),
        1 => Just(Step::KillAgent),
        1 => Just(Step::KillAggregator),
        1 => Just(Step::Disconnect),
    ]
}

/// What stands in the stream: an event by its number, or a gap.
#[derive(Clone, Debug, PartialEq)]
enum Entry {
    Event(String),
    Gap,
}

struct World {
    now: i64,
    process: u64,
    offered: u64,
    id: HostId,
    sending: Sending<MemorySpool>,
    receiving: Receiving,
    up: Vec<ToAggregator>,
    down: Vec<ToAgent>,
    /// Accepted, not stored yet.
    writer: VecDeque<Batch>,
    /// What survives the aggregator: the mark and the events.
    mark: u64,
    database: Vec<Entry>,
    /// What the agent took in and did not lose with its memory, in order.
    taken: Vec<Entry>,
}

impl World {
    fn new() -> Self {
        let id = HostId::random();
        let spool = MemorySpool::new(Usage { events: 40, bytes: 1_000_000 });
        let mut world = Self {
            now: 0,
            process: 1,
            offered: 0,
            id,
            sending: Sending::new(config(), host(id, "edge"), 1, spool),
            receiving: receiving(),
            up: Vec::new(),
            down: Vec::new(),
            writer: VecDeque::new(),
            mark: 0,
            database: Vec::new(),
            taken: Vec::new(),
        };
        world.sending.connected(at(0).mono);
        world
    }

    /// Does something to the sender and notes the gaps that entered its stream on the way.
    fn agent(&mut self, act: impl FnOnce(&mut Sending<MemorySpool>, Stamp)) {
        let before = self.sending.accounting().offered;
        act(&mut self.sending, at(self.now));
        let gaps = self.sending.accounting().offered - before;
        self.taken.extend((0..gaps).map(|_| Entry::Gap));
        self.up.extend(frames(&mut self.sending, at(self.now)));
    }

    fn offer(&mut self) {
        self.offered += 1;
        let (name, before) = (self.offered.to_string(), self.sending.accounting());
        self.sending.offer(&incident(&name), at(self.now));
        let after = self.sending.accounting();
        self.taken.extend((1..after.offered - before.offered).map(|_| Entry::Gap));
        if after.dropped == before.dropped {
            self.taken.push(Entry::Event(name));
        }
        self.agent(|_, _| {});
    }

    fn aggregator(&mut self, message: ToAggregator) {
        let now = at(self.now).mono;
        match message {
            ToAggregator::Hello(hello) => match self.receiving.hello(&hello, self.mark, now) {
                Greeting::Welcome { reply, missing } => {
                    // A copy of an old hello may name batches as oldest that were acknowledged long since.
                    assert_eq!(missing, None);
                    self.down.push(reply);
                }
                Greeting::Refused { reply, .. } => self.down.push(reply),
                Greeting::Wait => {}
            },
            ToAggregator::Batch(batch) => {
                match self.receiving.batch(batch.host, batch.stream, batch.number, now) {
                    Arrival::Accept => self.writer.push_back(batch),
                    Arrival::Duplicate(reply) | Arrival::Hole(Some(reply)) | Arrival::Unknown(reply) => {
                        self.down.push(reply);
                    }
                    Arrival::Pending | Arrival::Hole(None) => {}
                }
            }
            ToAggregator::Live(_) | ToAggregator::Goodbye(_) => unreachable!("never sent here"),
        }
    }

    fn store(&mut self) {
        let Some(batch) = self.writer.pop_front() else { return };
        assert_eq!(batch.number, self.mark + 1, "stored out of order");
        self.mark = batch.number;
        self.database.extend(batch.events.into_iter().map(|event| match event {
            Event::Incident(incident) => Entry::Event(incident.text),
            _ => Entry::Gap,
        }));
        self.down.extend(self.receiving.stored(batch.stream, batch.number).map(|(_, reply)| reply));
    }

    fn kill_agent(&mut self) {
        let held_in_memory = self.sending.accounting().waiting - self.sending.spool().usage().events;
        self.taken.truncate(self.taken.len() - held_in_memory as usize);
        self.process += 1;
        let spool = MemorySpool::new(Usage::default());
        let empty = Sending::new(config(), host(self.id, "edge"), 0, spool);
        let spool = std::mem::replace(&mut self.sending, empty).into_spool();
        self.sending = Sending::new(config(), host(self.id, "edge"), self.process, spool);
        self.agent(|sending, now| sending.connected(now.mono));
    }

    fn step(&mut self, step: &Step) {
        fn pick<T>(list: &mut Vec<T>, index: &Index) -> Option<T> {
            (!list.is_empty()).then(|| list.remove(index.index(list.len())))
        }
        match step {
            Step::Offer(count) => (0..*count).for_each(|_| self.offer()),
            Step::Pass(millis) => {
                self.now += i64::from(*millis);
                self.agent(|sending, now| sending.tick(now));
            }
            Step::DeliverUp(index) => {
                if let Some(message) = pick(&mut self.up, index) {
                    self.aggregator(message);
                }
            }
            Step::RepeatUp(index) if !self.up.is_empty() => {
                let message = self.up[index.index(self.up.len())].clone();
                self.aggregator(message);
            }
            Step::LoseUp(index) => drop(pick(&mut self.up, index)),
            Step::DeliverDown(index) => {
                if let Some(message) = pick(&mut self.down, index) {
                    self.agent(|sending, now| drop(sending.received(&message, now).expect("memory")));
                }
            }
            Step::RepeatDown(index) if !self.down.is_empty() => {
                let message = self.down[index.index(self.down.len())].clone();
                self.agent(|sending, now| drop(sending.received(&message, now).expect("memory")));
            }
            Step::RepeatUp(_) | Step::RepeatDown(_) => {}
            Step::LoseDown(index) => drop(pick(&mut self.down, index)),
            Step::Store => self.store(),
            Step::FailToStore => {
                let Some(batch) = self.writer.front() else { return };
                let stream = batch.stream;
                self.writer.clear();
                self.down.extend(self.receiving.failed(stream).map(|(_, reply)| reply));
            }
            Step::KillAgent => self.kill_agent(),
            Step::KillAggregator => {
                self.writer.clear();
                self.receiving = receiving();
            }
            Step::Disconnect => {
                self.up.clear();
                self.down.clear();
                self.agent(|sending, now| {
                    sending.disconnected();
                    sending.connected(now.mono);
                });
            }
        }
        let Accounting { offered, stored, waiting, dropped, .. } = self.sending.accounting();
        assert_eq!(offered, stored + waiting + dropped);
    }

    /// A transport that works, until nothing waits.
    fn settle(&mut self) {
        for _ in 0..2_000 {
            self.now += 50;
            self.agent(|sending, now| sending.tick(now));
            std::mem::take(&mut self.up).into_iter().for_each(|message| self.aggregator(message));
            while !self.writer.is_empty() {
                self.store();
            }
            for message in std::mem::take(&mut self.down) {
                self.agent(|sending, now| drop(sending.received(&message, now).expect("memory")));
            }
            if self.sending.is_idle() && self.up.is_empty() {
                return;
            }
        }
        panic!("it never came to rest: {:?}", self.sending);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, max_shrink_iters: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn everything_spooled_is_stored_once_and_in_order(steps in prop::collection::vec(step(), 1..250)) {
        let mut world = World::new();
        steps.iter().for_each(|step| world.step(step));
        world.settle();
        prop_assert_eq!(&world.database, &world.taken);
    }
}

#[test]
fn an_aggregator_that_was_restored_from_an_old_backup_records_what_it_lost() {
    let mut world = World::new();
    (0..9).for_each(|_| world.offer());
    world.settle();
    assert_eq!(world.mark, 3);

    // The backup was made after the first batch; what came later is nowhere any more.
    (world.mark, world.receiving) = (1, receiving());
    world.offer();
    world.now += 300;
    world.agent(|sending, now| sending.tick(now));
    let batch = world.up.pop().expect("a batch is due");
    world.aggregator(batch);
    assert_eq!(world.down, [ToAgent::Unknown]);
    let unknown = world.down.remove(0);
    world.agent(|sending, now| drop(sending.received(&unknown, now).expect("memory")));
    let Some(ToAggregator::Hello(hello)) = world.up.pop() else { panic!("a hello is due") };
    let greeting = world.receiving.hello(&hello, world.mark, at(world.now).mono);
    let Greeting::Welcome { reply, missing: Some(missing) } = greeting else { panic!("{greeting:?}") };
    assert_eq!((missing.from, missing.through), (2, 3));

    // The gap and the mark are stored together; then the stream goes on.
    world.mark = missing.through;
    world.down.extend(world.receiving.stored(missing.stream, missing.through).map(|(_, ack)| ack));
    world.down.push(reply);
    world.settle();
    assert_eq!((world.mark, world.database.last()), (4, Some(&Entry::Event("10".into()))));
}
