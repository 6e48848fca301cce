//! Exhaustive exploration of a small model: one batch with two faults, and two batches without a fault.
//!
//! The model consists of the real state machines of both ends, a spool file and a database, from the moment at which
//! the batches are cut. In each state every move is tried: a message in flight arrives (so that messages overtake one
//! another in every order), the disk completes an action, the writer commits one work. While faults are left, every
//! fault is tried as well: a message is lost, or arrives and stays in flight; a commit fails; the aggregator is killed,
//! before a commit or between a commit and its acknowledgement; the agent is killed, before or after the disk performed
//! its actions; the connection is reopened; time passes until the next deadline. States that were reached before are
//! not explored again: messages in flight count as a set, and a state is identified by a hash of 64 bits.
//!
//! Checks: in each state those of [`World::check`]; at each deletion in the spool that all deleted batches are stored;
//! at each commit that it continues its stream; and from each state without a move but faults, that both ends settle in
//! bounded time with each spooled event in the database exactly once and in order.

use std::collections::{HashSet, VecDeque};
use std::fmt::{self, Write as _};
use std::hash::{DefaultHasher, Hash, Hasher};

use super::world::World;
use super::*;

#[derive(Clone, Copy, Debug)]
enum Move {
    Up(usize),
    Down(usize),
    Work,
    Commit,
    RepeatUp(usize),
    RepeatDown(usize),
    LoseUp(usize),
    LoseDown(usize),
    Break,
    FailToCommit,
    CommitAndKill,
    KillAggregator,
    KillAgent(usize),
    Disconnect,
    Pass,
}

/// Returns the moves that are no faults.
fn moves(world: &World) -> Vec<Move> {
    let mut moves: Vec<Move> = (0..world.up.len()).map(Move::Up).collect();
    moves.extend((0..world.down.len()).map(Move::Down));
    moves.extend((!world.jobs.is_empty()).then_some(Move::Work));
    moves.extend((!world.aggregator.is_idle()).then_some(Move::Commit));
    moves
}

fn faults(world: &World) -> Vec<Move> {
    let mut faults = vec![Move::KillAggregator, Move::KillAgent(0), Move::Disconnect, Move::Pass];
    for n in 0..world.up.len() {
        faults.extend([Move::RepeatUp(n), Move::LoseUp(n)]);
    }
    for n in 0..world.down.len() {
        faults.extend([Move::RepeatDown(n), Move::LoseDown(n)]);
    }
    if !world.aggregator.is_idle() {
        faults.extend([Move::FailToCommit, Move::CommitAndKill]);
    }
    if !world.jobs.is_empty() {
        faults.extend([Move::KillAgent(1), Move::Break]);
    }
    faults
}

fn apply(world: &mut World, step: Move) {
    match step {
        Move::Up(n) => world.deliver_up(n, false),
        Move::Down(n) => world.deliver_down(n, false),
        Move::Work => world.work(),
        Move::Commit => world.commit(1, true),
        Move::RepeatUp(n) => world.deliver_up(n, true),
        Move::RepeatDown(n) => world.deliver_down(n, true),
        Move::LoseUp(n) => world.lose_up(n),
        Move::LoseDown(n) => world.lose_down(n),
        Move::Break => {
            world.broken = true;
            world.work();
            world.broken = false;
        }
        Move::FailToCommit => world.fail_commit(),
        Move::CommitAndKill => world.commit(1, false),
        Move::KillAggregator => world.aggregator.kill(),
        Move::KillAgent(done) => world.start_agent(world.site, done),
        Move::Disconnect => world.disconnect(),
        Move::Pass => world.pass_to_deadline(),
    }
}

/// Hasher of formatted text.
struct Digest(DefaultHasher);

impl fmt::Write for Digest {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

fn hash_of(value: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// Returns the identifier of a state. Messages in flight count as a set.
fn key(world: &World, faults: u32) -> u64 {
    let mut up: Vec<u64> = world.up.iter().map(hash_of).collect();
    let down = world.down.iter().map(|(connection, message)| hash_of((connection, codec::encode(message))));
    let mut down: Vec<u64> = down.collect();
    up.sort_unstable();
    down.sort_unstable();
    let mut digest = Digest(DefaultHasher::new());
    let World { now, sending, jobs, aggregator, .. } = world;
    write!(digest, "{now}{sending:?}{jobs:?}{:?}{aggregator:?}{up:?}{down:?}{faults}", world.file())
        .expect("a hash takes everything");
    digest.0.finish()
}

/// Explores all states. Returns the numbers of states, of transitions between them, and of states from which both ends
/// were settled.
fn explore(start: World, most_faults: u32) -> (usize, usize, usize) {
    let mut known = HashSet::from([key(&start, most_faults)]);
    let mut waiting = VecDeque::from([(start, most_faults)]);
    let (mut transitions, mut rests) = (0, 0);
    while let Some((world, left)) = waiting.pop_front() {
        let mut steps: Vec<(Move, u32)> = moves(&world).into_iter().map(|step| (step, left)).collect();
        if steps.is_empty() {
            rests += 1;
            let mut world = world.clone();
            world.settle();
            world.check_settled();
        }
        if left > 0 {
            steps.extend(faults(&world).into_iter().map(|step| (step, left - 1)));
        }
        for (step, left) in steps {
            let mut next = world.clone();
            apply(&mut next, step);
            next.check();
            transitions += 1;
            if known.insert(key(&next, left)) {
                waiting.push_back((next, left));
            }
        }
    }
    (known.len(), transitions, rests)
}

/// Returns a world in which batches of one event each are about to be spooled.
fn world(batches: usize) -> World {
    let config = SendingConfig { batch_nodes: 1, batch_bytes: 1_024, window: 2, ..SendingConfig::default() };
    let mut world = World::new(config, 2);
    // Proofs are left out: they precede everything that is explored here, and each further message multiplies the
    // states.
    world.aggregator.asks_for_proofs = false;
    (0..batches).for_each(|_| world.offer());
    world.agent(|sending, now| sending.flush(now.wall));
    world
}

#[test]
fn one_batch_from_the_first_hello_with_two_faults() {
    let (states, transitions, rests) = explore(world(1), 2);
    println!("{states} states, {transitions} transitions, {rests} brought to rest");
    assert!(states > 20_000, "{states} states");
}

#[test]
fn two_batches_in_every_order_without_a_fault() {
    let (states, transitions, rests) = explore(world(2), 0);
    println!("{states} states, {transitions} transitions, {rests} brought to rest");
    assert!(states > 100, "{states} states");
}
