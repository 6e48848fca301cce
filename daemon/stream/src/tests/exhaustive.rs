//! Exhaustive exploration of a small model: one batch with two faults, and two batches without a fault.
//!
//! The model consists of the real state machines of both ends, a spool file and a database, from the moment at which
//! the batches are closed. In each state every move is tried: a message in flight arrives (so that messages overtake
//! one another in every order), the disk completes an action, the writer commits one task. While faults are left, every
//! fault is tried as well: a message is lost, or arrives and stays in flight; a commit fails; the aggregator is killed,
//! before a commit or between a commit and its acknowledgement; the agent is killed, before or after the disk performed
//! its actions; the connection is reopened; time passes until the next deadline. States that were reached before are
//! not explored again: messages in flight count as a set, and a state is identified by a hash of 64 bits.
//!
//! Checks: in each state the checks of [`Simulation::check`]; at each deletion in the spool, that all deleted batches
//! are stored; at each commit, that the batch follows the last stored batch of its stream; and from each state in which
//! only faults are possible, that both ends settle in bounded time with each spooled event in the database exactly once
//! and in order.

use std::collections::{HashSet, VecDeque};
use std::fmt::{self, Write as _};
use std::hash::{DefaultHasher, Hash, Hasher};

use super::simulation::Simulation;
use super::*;

/// A transition of the model. The numbers are positions among the frames or messages in flight; with `KillAgent`, the
/// number of actions that the disk has performed before the kill.
#[derive(Clone, Copy, Debug)]
enum Move {
    Up(usize),
    Down(usize),
    CompleteJob,
    Commit,
    RepeatUp(usize),
    RepeatDown(usize),
    LoseUp(usize),
    LoseDown(usize),
    FailJob,
    FailToCommit,
    CommitAndKill,
    KillAggregator,
    KillAgent(usize),
    Disconnect,
    Pass,
}

/// Returns the moves that are no faults.
fn regular_moves(simulation: &Simulation) -> Vec<Move> {
    let mut regular_moves: Vec<Move> = (0..simulation.up.len()).map(Move::Up).collect();
    regular_moves.extend((0..simulation.down.len()).map(Move::Down));
    regular_moves.extend((!simulation.jobs.is_empty()).then_some(Move::CompleteJob));
    regular_moves.extend((!simulation.aggregator.is_idle()).then_some(Move::Commit));
    regular_moves
}

fn faults(simulation: &Simulation) -> Vec<Move> {
    let mut faults = vec![Move::KillAggregator, Move::KillAgent(0), Move::Disconnect, Move::Pass];
    for n in 0..simulation.up.len() {
        faults.extend([Move::RepeatUp(n), Move::LoseUp(n)]);
    }
    for n in 0..simulation.down.len() {
        faults.extend([Move::RepeatDown(n), Move::LoseDown(n)]);
    }
    if !simulation.aggregator.is_idle() {
        faults.extend([Move::FailToCommit, Move::CommitAndKill]);
    }
    if !simulation.jobs.is_empty() {
        faults.extend([Move::KillAgent(1), Move::FailJob]);
    }
    faults
}

fn apply(simulation: &mut Simulation, step: Move) {
    match step {
        Move::Up(n) => simulation.deliver_up(n, false),
        Move::Down(n) => simulation.deliver_down(n, false),
        Move::CompleteJob => simulation.complete_job(),
        Move::Commit => simulation.commit(1),
        Move::RepeatUp(n) => simulation.deliver_up(n, true),
        Move::RepeatDown(n) => simulation.deliver_down(n, true),
        Move::LoseUp(n) => simulation.lose_up(n),
        Move::LoseDown(n) => simulation.lose_down(n),
        Move::FailJob => {
            simulation.is_disk_broken = true;
            simulation.complete_job();
            simulation.is_disk_broken = false;
        }
        Move::FailToCommit => simulation.fail_commit(),
        Move::CommitAndKill => simulation.commit_and_kill(1),
        Move::KillAggregator => simulation.aggregator.kill(),
        Move::KillAgent(done) => simulation.start_agent(simulation.machine, done),
        Move::Disconnect => simulation.disconnect(),
        Move::Pass => simulation.pass_to_deadline(),
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
fn key(simulation: &Simulation, faults: u32) -> u64 {
    let mut up: Vec<u64> = simulation.up.iter().map(hash_of).collect();
    let down =
        simulation.down.iter().map(|(connection, message)| hash_of((connection, codec::encode(message))));
    let mut down: Vec<u64> = down.collect();
    up.sort_unstable();
    down.sort_unstable();
    let mut digest = Digest(DefaultHasher::new());
    let Simulation { now, sending, jobs, aggregator, .. } = simulation;
    write!(digest, "{now}{sending:?}{jobs:?}{:?}{aggregator:?}{up:?}{down:?}{faults}", simulation.file())
        .expect("writing to a hasher does not fail");
    digest.0.finish()
}

/// Explores all states. Returns the numbers of states, of transitions between them, and of states from which both ends
/// were settled.
fn explore(start: Simulation, max_faults: u32) -> (usize, usize, usize) {
    let mut reached = HashSet::from([key(&start, max_faults)]);
    let mut unexplored = VecDeque::from([(start, max_faults)]);
    let (mut transitions, mut settled) = (0, 0);
    while let Some((simulation, remaining_faults)) = unexplored.pop_front() {
        let mut steps: Vec<(Move, u32)> =
            regular_moves(&simulation).into_iter().map(|step| (step, remaining_faults)).collect();
        if steps.is_empty() {
            settled += 1;
            let mut simulation = simulation.clone();
            simulation.settle();
            simulation.check_settled();
        }
        if remaining_faults > 0 {
            steps.extend(faults(&simulation).into_iter().map(|step| (step, remaining_faults - 1)));
        }
        for (step, remaining_faults) in steps {
            let mut next = simulation.clone();
            apply(&mut next, step);
            next.check();
            transitions += 1;
            if reached.insert(key(&next, remaining_faults)) {
                unexplored.push_back((next, remaining_faults));
            }
        }
    }
    (reached.len(), transitions, settled)
}

/// Returns a simulation in which batches of one event each are about to be spooled.
fn simulation(batches: usize) -> Simulation {
    let config = SendingConfig { batch_nodes: 1, batch_bytes: 1_024, window: 2, ..SendingConfig::default() };
    let capacity = 2;
    let mut simulation = Simulation::new(config, capacity);
    // The hosts prove nothing: proofs precede everything that is explored, and each further message multiplies the
    // number of states.
    simulation.aggregator.asks_for_proofs = false;
    (0..batches).for_each(|_| simulation.offer());
    simulation.agent(|sending, now| sending.flush(now.wall));
    simulation
}

#[test]
fn one_batch_is_stored_once_despite_any_two_faults() {
    let (states, transitions, settled) = explore(simulation(1), 2);
    println!("{states} states, {transitions} transitions, {settled} settled");
    assert!(states > 20_000, "{states} states");
}

#[test]
fn two_batches_are_stored_once_in_any_order() {
    let (states, transitions, settled) = explore(simulation(2), 0);
    println!("{states} states, {transitions} transitions, {settled} settled");
    assert!(states > 100, "{states} states");
}
