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

/// Maximum number of pieces of work in the aggregator's queue.
const CAPACITY: usize = 5;

/// Maximum number of machines with the same host id.
const MAX_MACHINES: u8 = 3;

#[derive(Clone, Debug)]
enum Step {
    /// A number of events is offered.
    Offer(u8),
    /// A number of milliseconds passes.
    Pass(u16),
    /// The `nth` frame in flight arrives; with `keep`, it also stays in flight.
    Up {
        nth: u8,
        keep: bool,
    },
    LoseUp(u8),
    Damage {
        nth: u8,
        bit: u16,
    },
    Down {
        nth: u8,
        keep: bool,
    },
    LoseDown(u8),
    /// The spool's disk completes an action.
    Work,
    /// The spool's disk begins to fail, or works again.
    SetBroken(bool),
    Commit(u8),
    FailToCommit,
    /// A commit is written to the disk, and the aggregator is killed before it reports the commit.
    CommitAndKill,
    KillAggregator,
    /// The agent is killed. The disk has performed `done` further actions whose completion the agent did not learn of.
    KillAgent {
        done: u8,
    },
    Disconnect,
    BackUp,
    Restore,
    Copy,
    /// The running machine is killed, and the next machine is started.
    Move {
        done: u8,
    },
    DeleteSpool,
}

/// State that the choice of the next step depends on. `USER_FAULTS` adds faults caused by users: old backups, copies,
/// deletions.
#[derive(Clone, Debug)]
struct Plan<const USER_FAULTS: bool> {
    broken: bool,
    backed_up: bool,
    machines: u8,
}

impl<const USER_FAULTS: bool> ReferenceStateMachine for Plan<USER_FAULTS> {
    type State = Self;
    type Transition = Step;

    fn init_state() -> BoxedStrategy<Self> {
        Just(Self { broken: false, backed_up: false, machines: 1 }).boxed()
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
            (12, Just(Step::Work).boxed()),
            (if state.broken { 3 } else { 1 }, Just(Step::SetBroken(!state.broken)).boxed()),
            (10, (1_u8..4).prop_map(Step::Commit).boxed()),
            (1, Just(Step::FailToCommit).boxed()),
            (1, Just(Step::CommitAndKill).boxed()),
            (1, Just(Step::KillAggregator).boxed()),
            (2, (0_u8..3).prop_map(|done| Step::KillAgent { done }).boxed()),
            (1, Just(Step::Disconnect).boxed()),
        ];
        if USER_FAULTS {
            steps.push((1, Just(if state.backed_up { Step::Restore } else { Step::BackUp }).boxed()));
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
            Step::SetBroken(broken) => *broken != state.broken,
            Step::Restore => state.backed_up,
            Step::Move { .. } => state.machines > 1,
            Step::Copy => state.machines < MAX_MACHINES,
            _ => true,
        }
    }

    fn apply(mut state: Self, step: &Step) -> Self {
        match step {
            Step::SetBroken(broken) => state.broken = *broken,
            Step::BackUp => state.backed_up = true,
            Step::Restore => state.backed_up = false,
            Step::Copy => state.machines += 1,
            _ => {}
        }
        state
    }
}

impl<const USER_FAULTS: bool> StateMachineTest for Plan<USER_FAULTS> {
    type SystemUnderTest = Simulation;
    type Reference = Self;

    fn init_test(_: &Self) -> Simulation {
        Simulation::new(config(), CAPACITY)
    }

    fn apply(mut simulation: Simulation, _: &Self, step: Step) -> Simulation {
        match step {
            Step::Offer(count) => (0..count).for_each(|_| simulation.offer()),
            Step::Pass(millis) => simulation.pass(i64::from(millis)),
            Step::Up { nth, keep } => simulation.deliver_up(nth.into(), keep),
            Step::LoseUp(nth) => simulation.lose_up(nth.into()),
            Step::Damage { nth, bit } => simulation.damage(nth.into(), bit.into()),
            Step::Down { nth, keep } => simulation.deliver_down(nth.into(), keep),
            Step::LoseDown(nth) => simulation.lose_down(nth.into()),
            Step::Work => simulation.work(),
            Step::SetBroken(broken) => simulation.broken = broken,
            Step::Commit(count) => simulation.commit(count.into(), true),
            Step::FailToCommit => simulation.fail_commit(),
            Step::CommitAndKill => simulation.commit(usize::MAX, false),
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
