//! The task that keeps the master informed.

use std::sync::Arc;

use tokio::time::sleep;

use super::environment::RpcUri;
use super::error::NodeError;
use super::node::NodeShared;
use super::registration::{CallOutcome, MasterCall, Notice, Registration, Role};
use super::rpc;

/// Returns the methods of the master's API that add and remove a registration.
pub(super) fn method_of(role: Role) -> (&'static str, &'static str) {
    match role {
        Role::Publisher => ("registerPublisher", "unregisterPublisher"),
        Role::Subscriber => ("registerSubscriber", "unregisterSubscriber"),
    }
}

/// Calls the master as the registrations ask for, until the node ends.
pub(super) async fn run(node: Arc<NodeShared>) {
    loop {
        let (call, pause) = {
            let registrations = node.registrations();
            (registrations.next_call(), registrations.pause())
        };
        if let Some(call) = call {
            let outcome = tokio::select! {
                outcome = perform(&node, &call) => outcome,
                () = node.stop.cancelled() => return,
            };
            let notice = node.registrations().handle_outcome(&call, outcome);
            if let Some(notice) = notice {
                report(&node, notice);
            }
            continue;
        }
        tokio::select! {
            () = sleep(pause) => node.registrations().request_check(),
            () = node.wake_registrar.notified() => {}
            () = node.stop.cancelled() => return,
        }
    }
}

/// Asks the master whether it still knows the node. All topics are due for registration if it does not.
pub(super) async fn check(node: &NodeShared) {
    if !node.registrations().has_registered() {
        return;
    }
    let call = MasterCall::LookUpNode;
    let outcome = perform(node, &call).await;
    let notice = node.registrations().handle_outcome(&call, outcome);
    if let Some(notice) = notice {
        report(node, notice);
    }
    node.wake_registrar.notify_one();
}

async fn perform(node: &NodeShared, call: &MasterCall) -> CallOutcome {
    let result = match call {
        MasterCall::LookUpNode => match node.master.look_up_node(&node.name).await {
            Ok(None) => return CallOutcome::NodeUnknown,
            Ok(Some(uri)) if uri != node.uri => {
                // A node that has ended did not replace this one: its registration has reached the master late.
                let is_running = is_running(node, &uri).await;
                return if is_running { CallOutcome::NodeReplaced { uri } } else { CallOutcome::NodeUnknown };
            }
            Ok(Some(_)) => Ok(()),
            Err(error) => Err(error),
        },
        MasterCall::Register(registration) => register(node, registration).await,
        MasterCall::Unregister(registration) => {
            let (_, method) = method_of(registration.role);
            node.master.unregister(method, &registration.topic, &node.uri).await
        }
    };
    match result {
        Ok(()) => CallOutcome::Success,
        Err(error @ NodeError::MasterRefused { .. }) => CallOutcome::Refused { reason: error.to_string() },
        Err(error) => CallOutcome::Unreachable { reason: error.to_string() },
    }
}

/// Tells whether a node answers at a URI.
async fn is_running(node: &NodeShared, uri: &str) -> bool {
    let Ok(uri) = RpcUri::parse(uri) else { return false };
    rpc::call(&uri, "getPid", vec![(&*node.name).into()]).await.is_ok()
}

async fn register(node: &NodeShared, registration: &Registration) -> Result<(), NodeError> {
    let Registration { role, topic, kind } = registration;
    let (method, _) = method_of(*role);
    let uris = node.master.register(method, topic, kind, &node.uri).await?;
    if *role == Role::Subscriber {
        let subscribed = node.topics().subscriptions.get(topic).cloned();
        if let Some(subscribed) = subscribed {
            subscribed.add_publishers(&uris);
        }
    }
    Ok(())
}

fn report(node: &NodeShared, notice: Notice) {
    let (name, master) = (&*node.name, node.master.uri().as_str());
    match notice {
        Notice::MasterLost { reason } => {
            tracing::warn!(
                node = name,
                reason,
                "the ROS master is not reachable; connections go on, trying again"
            );
        }
        Notice::MasterBack => tracing::info!(node = name, master, "the ROS master is reachable again"),
        Notice::Forgotten => {
            tracing::warn!(
                node = name,
                master,
                "the ROS master does not know the node any more; registering all topics again"
            );
        }
        Notice::Refused { reason } => {
            tracing::warn!(node = name, reason, "the ROS master refuses a registration; trying again");
        }
        Notice::NodeReplaced { uri } => {
            node.close(format!("another node, at {uri}, has registered with the same name"));
        }
    }
}
