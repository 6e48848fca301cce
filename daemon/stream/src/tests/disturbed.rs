//! Both ends with thousands of generated sequences of faults.

use proptest::prelude::*;
use proptest::strategy::Union;
use proptest_state_machine::{ReferenceStateMachine, StateMachineTest, prop_state_machine};

use super::simulation::Simulation;
use super::*;

/// Returns a configuration with small limits, so that a few events reach all of them: three events per batch, three
/// batches in flight, and space for about forty events.
pub(super) fn config() -> SendingConfig {
    SendingConfig {
        batch_nodes: 3,
        batch_bytes: 1_024,
        window: 3,
        spool_bytes: 1_200,
        memory: Usage { events: 20, bytes: 600 },
        reserve_events: 2,
        ..SendingConfig::default()
    }
}

/// Maximum number of tasks in the queue of the aggregator's writer.
const CAPACITY: usize = 5;

/// Maximum number of machines with the same host id.
const MAX_MACHINES: u8 = 3;

/// A step of the simulation: an action of one end, a fault, or the passage of time.
#[derive(Clone, Debug)]
enum Step {
    /// A number of events is offered.
    Offer(u8),
    /// A number of milliseconds passes.
    Pass(u16),
    /// The `nth` frame in flight to the aggregator arrives; with `keep`, a copy stays in flight.
    Up {
        nth: u8,
        keep: bool,
    },
    /// A frame in flight to the aggregator is lost.
    LoseUp(u8),
    /// A bit of a batch in flight changes.
    Damage {
        nth: u8,
        bit: u16,
    },
    /// The `nth` message in flight to the agent arrives; with `keep`, a copy stays in flight.
    Down {
        nth: u8,
        keep: bool,
    },
    /// A message in flight to the agent is lost.
    LoseDown(u8),
    /// The spool's disk completes an action.
    CompleteJob,
    /// The spool's disk begins to fail, or works again.
    SetDiskBroken(bool),
    /// The aggregator's writer commits a number of tasks.
    Commit(u8),
    /// A commit fails.
    FailToCommit,
    /// A commit is written to the disk, and the aggregator is killed before it reports the commit.
    CommitAndKill,
    KillAggregator,
    /// The agent is killed. The disk has performed `done` further actions whose completion the agent did not learn of.
    KillAgent {
        done: u8,
    },
    /// The connection ends, and the agent connects again.
    Disconnect,
    /// The database is copied.
    BackUp,
    /// The database is replaced by its older copy.
    Restore,
    /// The spool of the running machine is copied to a new machine.
    Copy,
    /// The running machine is killed, and the next machine is started.
    Move {
        done: u8,
    },
    DeleteSpool,
}

/// State that the choice of the next step depends on. `HUMAN_FAULTS` adds faults that people cause: old backups,
/// copies, deletions.
#[derive(Clone, Debug)]
struct Plan<const HUMAN_FAULTS: bool> {
    is_disk_broken: bool,
    has_backup: bool,
    machines: u8,
}

impl<const HUMAN_FAULTS: bool> ReferenceStateMachine for Plan<HUMAN_FAULTS> {
    type State = Self;
    type Transition = Step;

    fn init_state() -> BoxedStrategy<Self> {
        Just(Self { is_disk_broken: false, has_backup: false, machines: 1 }).boxed()
    }

    fn transitions(state: &Self) -> BoxedStrategy<Step> {
        // Frames are usually delivered in order.
        let nth = || prop_oneof![3 => Just(0_u8), 1 => any::<u8>()];
        let keep = || prop::bool::weighted(0.15);
        let mut steps = vec![
            (8, (1_u8..6).prop_map(Step::Offer).boxed()),
            (6, (1_u16..400).prop_map(Step::Pass).boxed()),
            (1, (400_u16..12_000).prop_map(Step::Pass).boxed()),
            (16, (nth(), keep()).prop_map(|(nth, keep)| Step::Up { nth, keep }).boxed()),
            (2, any::<u8>().prop_map(Step::LoseUp).boxed()),
            (2, (any::<u8>(), any::<u16>()).prop_map(|(nth, bit)| Step::Damage { nth, bit }).boxed()),
            (16, (nth(), keep()).prop_map(|(nth, keep)| Step::Down { nth, keep }).boxed()),
            (2, any::<u8>().prop_map(Step::LoseDown).boxed()),
            (12, Just(Step::CompleteJob).boxed()),
            (
                if state.is_disk_broken { 3 } else { 1 },
                Just(Step::SetDiskBroken(!state.is_disk_broken)).boxed(),
            ),
            (10, (1_u8..4).prop_map(Step::Commit).boxed()),
            (1, Just(Step::FailToCommit).boxed()),
            (1, Just(Step::CommitAndKill).boxed()),
            (1, Just(Step::KillAggregator).boxed()),
            (2, (0_u8..3).prop_map(|done| Step::KillAgent { done }).boxed()),
            (1, Just(Step::Disconnect).boxed()),
        ];
        if HUMAN_FAULTS {
            steps.push((1, Just(if state.has_backup { Step::Restore } else { Step::BackUp }).boxed()));
            steps.push((1, Just(Step::DeleteSpool).boxed()));
            if state.machines < MAX_MACHINES {
                steps.push((1, Just(Step::Copy).boxed()));
            }
            if state.machines > 1 {
                steps.push((2, (0_u8..3).prop_map(|done| Step::Move { done }).boxed()));
            }
        }
        Union::new_weighted(steps).boxed()
    }

    fn preconditions(state: &Self, step: &Step) -> bool {
        match step {
            Step::SetDiskBroken(is_disk_broken) => *is_disk_broken != state.is_disk_broken,
            Step::Restore => state.has_backup,
            Step::Move { .. } => state.machines > 1,
            Step::Copy => state.machines < MAX_MACHINES,
            _ => true,
        }
    }

    fn apply(mut state: Self, step: &Step) -> Self {
        match step {
            Step::SetDiskBroken(is_disk_broken) => state.is_disk_broken = *is_disk_broken,
            Step::BackUp => state.has_backup = true,
            Step::Restore => state.has_backup = false,
            Step::Copy => state.machines += 1,
            _ => {}
        }
        state
    }
}

impl<const HUMAN_FAULTS: bool> StateMachineTest for Plan<HUMAN_FAULTS> {
    type SystemUnderTest = Simulation;
    type Reference = Self;

    fn init_test(_: &Self) -> Simulation {
        Simulation::new(config(), CAPACITY)
    }

    fn apply(mut simulation: Simulation, _: &Self, step: Step) -> Simulation {
        match step {
            Step::Offer(count) => (0..count).for_each(|_| simulation.offer()),
            Step::Pass(millis) => simulation.pass_time(i64::from(millis)),
            Step::Up { nth, keep } => simulation.deliver_up(nth.into(), keep),
            Step::LoseUp(nth) => simulation.lose_up(nth.into()),
            Step::Damage { nth, bit } => simulation.damage(nth.into(), bit.into()),
            Step::Down { nth, keep } => simulation.deliver_down(nth.into(), keep),
            Step::LoseDown(nth) => simulation.lose_down(nth.into()),
            Step::CompleteJob => simulation.complete_job(),
            Step::SetDiskBroken(is_disk_broken) => simulation.is_disk_broken = is_disk_broken,
            Step::Commit(count) => simulation.commit(count.into()),
            Step::FailToCommit => simulation.fail_commit(),
            Step::CommitAndKill => simulation.commit_and_kill(usize::MAX),
            Step::KillAggregator => simulation.aggregator.kill(),
            Step::KillAgent { done } => simulation.start_agent(simulation.machine, done.into()),
            Step::Disconnect => simulation.disconnect(),
            Step::BackUp => simulation.back_up(),
            Step::Restore => simulation.restore(),
            Step::Copy => simulation.copy(),
            Step::Move { done } => simulation.start_next_machine(done.into()),
            Step::DeleteSpool => simulation.delete_spool(),
        }
        simulation
    }

    fn check_invariants(simulation: &Simulation, _: &Self) {
        simulation.check();
    }

    fn teardown(mut simulation: Simulation, _: Self) {
        simulation.settle();
        simulation.check_settled();
    }
}

prop_state_machine! {
    #![proptest_config(ProptestConfig { cases: 2_000, max_shrink_iters: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn every_spooled_event_is_stored_once_and_in_order(sequential 1..120 => Plan<false>);
}

prop_state_machine! {
    #![proptest_config(ProptestConfig { cases: 2_000, max_shrink_iters: 20_000, ..ProptestConfig::default() })]

    #[test]
    fn old_backups_copies_and_deletions_are_reported_and_lose_no_other_event(sequential 1..150 => Plan<true>);
}
