//! Registrations that the master should have, and the calls of the master that are needed. No I/O.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// Interval at which the master is asked whether it still knows the node.
pub(super) const CHECK_INTERVAL: Duration = Duration::from_secs(2);

/// Delay before the next attempt to reach the master.
pub(super) const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Role of a node in a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Publisher,
    Subscriber,
}

/// A publisher or subscriber of a topic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Registration {
    pub(super) role: Role,
    pub(super) topic: Arc<str>,
    /// Name of the type.
    pub(super) kind: Arc<str>,
}

/// A call of the master that adds, removes or checks registrations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum MasterCall {
    Register(Registration),
    Unregister(Registration),
    /// Ask which node has this node's name.
    LookUpNode,
}

/// Outcome of a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum CallOutcome {
    Success,
    /// The master does not know the node: it was restarted, or it knows a node that has ended.
    NodeUnknown,
    /// Another node has the name now.
    NodeReplaced {
        uri: String,
    },
    Refused {
        reason: String,
    },
    Unreachable {
        reason: String,
    },
}

/// Change that the owner of the registrations has to log or handle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Notice {
    MasterUnreachable { reason: String },
    MasterReachable,
    RegistrationsLost,
    Refused { reason: String },
    NodeReplaced { uri: String },
}

/// Status of a registration at the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RegistrationStatus {
    /// The master has the registration.
    Registered,
    /// The master does not have the registration; it is to be registered again.
    Missing,
    /// The master refused the registration. It becomes missing again after the next check.
    Refused,
    /// The registration is to be removed.
    Unregistering,
}

/// The registrations of a node.
#[derive(Debug, Default)]
pub(super) struct Registrations {
    entries: BTreeMap<Registration, RegistrationStatus>,
    /// Registrations that the master refused at their last attempt, and whose refusal was reported.
    reported_refusals: BTreeSet<Registration>,
    /// `true` after a call that did not reach the master, or a check that the master refused. Calls are then repeated
    /// at the retry interval.
    is_retrying: bool,
    /// `true` if the master is to be asked whether it still knows the node.
    is_check_due: bool,
}

impl Registrations {
    /// Adds a registration that the master has.
    pub(super) fn add(&mut self, registration: Registration) {
        self.reported_refusals.remove(&registration);
        self.entries.insert(registration, RegistrationStatus::Registered);
    }

    /// Marks a registration for removal. The call that unregisters it is due next.
    pub(super) fn remove(&mut self, registration: Registration) {
        self.reported_refusals.remove(&registration);
        self.entries.insert(registration, RegistrationStatus::Unregistering);
    }

    /// Makes it due to ask the master whether it still knows the node.
    pub(super) fn request_check(&mut self) {
        self.is_check_due = true;
    }

    /// Returns the time to wait while no call is due.
    pub(super) fn wait_interval(&self) -> Duration {
        if self.is_retrying { RETRY_INTERVAL } else { CHECK_INTERVAL }
    }

    /// Returns the call that is due now.
    pub(super) fn next_call(&self) -> Option<MasterCall> {
        let find_with_status =
            |status| self.entries.iter().find(|(_, entry_status)| **entry_status == status);
        // After the master was unreachable, another master may run, so the check comes first.
        if self.is_check_due && !self.entries.is_empty() {
            return Some(MasterCall::LookUpNode);
        }
        if self.is_retrying {
            return None;
        }
        if let Some((registration, _)) = find_with_status(RegistrationStatus::Unregistering) {
            return Some(MasterCall::Unregister(registration.clone()));
        }
        find_with_status(RegistrationStatus::Missing)
            .map(|(registration, _)| MasterCall::Register(registration.clone()))
    }

    /// Handles the outcome of a call. Returns the change that the owner has to log or handle, if any.
    pub(super) fn handle_outcome(&mut self, call: &MasterCall, outcome: CallOutcome) -> Option<Notice> {
        if *call == MasterCall::LookUpNode {
            self.is_check_due = false;
        }
        if let CallOutcome::Unreachable { reason } = outcome {
            let was_retrying = std::mem::replace(&mut self.is_retrying, true);
            return (!was_retrying).then_some(Notice::MasterUnreachable { reason });
        }
        let was_retrying = std::mem::take(&mut self.is_retrying);
        match (call, outcome) {
            (_, CallOutcome::NodeUnknown) => {
                let had_registered = self.mark_all_missing();
                return had_registered.then_some(Notice::RegistrationsLost);
            }
            (_, CallOutcome::NodeReplaced { uri }) => return Some(Notice::NodeReplaced { uri }),
            (MasterCall::Register(registration), CallOutcome::Success) => {
                self.reported_refusals.remove(registration);
                if let Some(status) = self.entries.get_mut(registration)
                    && *status == RegistrationStatus::Missing
                {
                    *status = RegistrationStatus::Registered;
                }
            }
            (MasterCall::Unregister(registration), CallOutcome::Success) => {
                self.finish_unregistering(registration);
            }
            (MasterCall::Unregister(registration), CallOutcome::Refused { reason }) => {
                self.finish_unregistering(registration);
                return Some(Notice::Refused { reason });
            }
            (MasterCall::Register(registration), CallOutcome::Refused { reason }) => {
                // The topic may have been removed during the call.
                let status = self.entries.get_mut(registration)?;
                if *status != RegistrationStatus::Missing {
                    return None;
                }
                // The call is repeated after the next check, and reported once. The other registrations do not wait
                // for it.
                *status = RegistrationStatus::Refused;
                let is_new = self.reported_refusals.insert(registration.clone());
                return is_new.then_some(Notice::Refused { reason });
            }
            (MasterCall::LookUpNode, CallOutcome::Refused { reason }) => {
                // The call is repeated after the retry interval, and reported once.
                self.is_retrying = true;
                return (!was_retrying).then_some(Notice::Refused { reason });
            }
            (MasterCall::LookUpNode, CallOutcome::Success) => {
                let refused_entries =
                    self.entries.values_mut().filter(|status| **status == RegistrationStatus::Refused);
                refused_entries.for_each(|status| *status = RegistrationStatus::Missing);
            }
            (_, CallOutcome::Unreachable { .. }) => {}
        }
        was_retrying.then_some(Notice::MasterReachable)
    }

    /// Returns whether the master should know a registration of the node.
    pub(super) fn has_registered(&self) -> bool {
        self.entries.values().any(|status| *status == RegistrationStatus::Registered)
    }

    /// Drops the registrations that are to be removed, and marks all others as missing. Returns whether any was
    /// registered.
    fn mark_all_missing(&mut self) -> bool {
        let had_registered = self.has_registered();
        // The master has no registration of the node, so no call is needed to remove one.
        self.entries.retain(|_, status| *status != RegistrationStatus::Unregistering);
        self.entries.values_mut().for_each(|status| *status = RegistrationStatus::Missing);
        had_registered
    }

    /// Removes a registration that the master has removed.
    fn finish_unregistering(&mut self, registration: &Registration) {
        match self.entries.get_mut(registration) {
            Some(RegistrationStatus::Unregistering) => {
                self.entries.remove(registration);
            }
            // The topic was added again during the call, which has removed the new registration.
            Some(status) => *status = RegistrationStatus::Missing,
            None => {}
        }
    }

    /// Removes and returns all registrations that the master may know.
    pub(super) fn take_all(&mut self) -> Vec<Registration> {
        std::mem::take(&mut self.entries).into_keys().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registration(topic: &str) -> Registration {
        Registration { role: Role::Publisher, topic: topic.into(), kind: "std_msgs/String".into() }
    }

    fn unreachable() -> CallOutcome {
        CallOutcome::Unreachable { reason: "refused".into() }
    }

    #[test]
    fn restarted_master_gets_all_registrations_again() {
        let mut state = Registrations::default();
        state.add(registration("/a"));
        state.add(registration("/b"));
        assert_eq!(state.next_call(), None);
        assert_eq!(state.wait_interval(), CHECK_INTERVAL);

        state.request_check();
        let check = state.next_call().unwrap();
        assert_eq!(check, MasterCall::LookUpNode);
        let notice = Notice::MasterUnreachable { reason: "refused".into() };
        assert_eq!(state.handle_outcome(&check, unreachable()), Some(notice));
        assert_eq!(state.next_call(), None);
        assert_eq!(state.wait_interval(), RETRY_INTERVAL);
        state.request_check();
        assert_eq!(state.handle_outcome(&check, unreachable()), None);

        state.request_check();
        assert_eq!(state.handle_outcome(&check, CallOutcome::NodeUnknown), Some(Notice::RegistrationsLost));
        for topic in ["/a", "/b"] {
            let call = MasterCall::Register(registration(topic));
            assert_eq!(state.next_call(), Some(call.clone()));
            assert_eq!(state.handle_outcome(&call, CallOutcome::Success), None);
        }
        assert_eq!(state.next_call(), None);
    }

    #[test]
    fn refused_registration_is_reported_once_without_delaying_others() {
        let mut state = Registrations::default();
        for topic in ["/a", "/b"] {
            state.add(registration(topic));
        }
        state.handle_outcome(&MasterCall::LookUpNode, CallOutcome::NodeUnknown);
        let refused = || CallOutcome::Refused { reason: "no".into() };
        let refused_call = MasterCall::Register(registration("/a"));
        assert_eq!(state.next_call(), Some(refused_call.clone()));
        let notice = Notice::Refused { reason: "no".into() };
        assert_eq!(state.handle_outcome(&refused_call, refused()), Some(notice));
        let other_call = MasterCall::Register(registration("/b"));
        assert_eq!(state.next_call(), Some(other_call.clone()));
        assert_eq!(state.handle_outcome(&other_call, CallOutcome::Success), None);
        for outcome in [refused(), refused(), CallOutcome::Success] {
            assert_eq!(state.next_call(), None, "the call waits for the next check");
            state.request_check();
            assert_eq!(state.next_call(), Some(MasterCall::LookUpNode));
            assert_eq!(state.handle_outcome(&MasterCall::LookUpNode, CallOutcome::Success), None);
            assert_eq!(state.next_call(), Some(refused_call.clone()));
            assert_eq!(state.handle_outcome(&refused_call, outcome), None);
        }
        state.request_check();
        state.handle_outcome(&MasterCall::LookUpNode, CallOutcome::Success);
        assert_eq!(state.next_call(), None);
    }

    #[test]
    fn reachable_master_that_knows_node_gets_no_calls() {
        let mut state = Registrations::default();
        state.add(registration("/a"));
        state.handle_outcome(&MasterCall::LookUpNode, unreachable());
        let notice = state.handle_outcome(&MasterCall::LookUpNode, CallOutcome::Success);
        assert_eq!(notice, Some(Notice::MasterReachable));
        assert_eq!(state.next_call(), None);
    }

    #[test]
    fn unregistration_waits_for_the_master() {
        let mut state = Registrations::default();
        state.add(registration("/a"));
        state.remove(registration("/a"));
        let call = state.next_call().unwrap();
        assert_eq!(call, MasterCall::Unregister(registration("/a")));
        state.handle_outcome(&call, unreachable());
        assert_eq!(state.next_call(), None);
        state.request_check();
        state.handle_outcome(&MasterCall::LookUpNode, CallOutcome::Success);
        assert_eq!(state.next_call(), Some(call.clone()));
        state.handle_outcome(&call, CallOutcome::Success);
        state.request_check();
        assert_eq!(state.next_call(), None);
    }

    #[test]
    fn topic_added_during_its_unregistration_is_registered_again() {
        let mut state = Registrations::default();
        state.remove(registration("/a"));
        let call = state.next_call().unwrap();
        state.add(registration("/a"));
        state.handle_outcome(&call, CallOutcome::Success);
        assert_eq!(state.next_call(), Some(MasterCall::Register(registration("/a"))));
    }

    #[test]
    fn node_with_same_name_is_reported() {
        let mut state = Registrations::default();
        state.add(registration("/a"));
        let outcome = CallOutcome::NodeReplaced { uri: "http://other:1/".into() };
        let notice = state.handle_outcome(&MasterCall::LookUpNode, outcome);
        assert_eq!(notice, Some(Notice::NodeReplaced { uri: "http://other:1/".into() }));
    }
}
