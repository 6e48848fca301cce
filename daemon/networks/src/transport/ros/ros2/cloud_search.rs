//! Search for the cloud with a given name in a domain.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use peernet_ros::messages::{Message, MessageInfo, SessionHello};
use peernet_ros::ros2::{EndpointRole, ParticipantId, Ros2Node};
use tokio::time::{sleep, timeout};

use super::participant::{Participant, is_local_participant};
use super::ros2_type_name;
use crate::transport::ros::interface::{EdgeTopics, NodeFailure};
use crate::transport::ros::names::sessions_topic;

/// Duration of the search for another cloud with the same name.
// Discovery takes less than a second where multicast works.
const OTHER_CLOUD_SEARCH_TIME: Duration = Duration::from_secs(1);

/// Duration of the search for other programs that use the topics of a pipeline. This search follows the search for the
/// cloud.
const OTHER_PROGRAM_SEARCH_TIME: Duration = Duration::from_millis(250);

/// Waits until discovery has found the cloud of an edge, and checks that no other program uses the topics. Returns the
/// name of the cloud's participant.
pub(super) async fn find_cloud_and_check_topics(
    participant: &Participant,
    topics: &EdgeTopics,
    time_limit: Duration,
) -> Result<Arc<str>, NodeFailure> {
    let node = participant.node()?;
    let sessions = sessions_topic(&topics.cloud);
    let current_clouds = || visible_clouds(&node, &sessions);
    // The edge waits until exactly one cloud is visible, because a cloud that has just ended may still be visible.
    let discovery = wait_for_discovery(&node, time_limit, || current_clouds().len() == 1).await;
    if discovery.is_err() && current_clouds().is_empty() {
        return Err(NodeFailure(format!(
            "{} has no cloud with the name {}: no node subscribes to {sessions} within {} s; {}",
            node.describe_domain(),
            topics.cloud,
            time_limit.as_secs_f64(),
            node.advise(),
        )));
    }
    // DDS does not report the end of discovery, and other programs may be found slightly later than the cloud.
    sleep(OTHER_PROGRAM_SEARCH_TIME).await;
    check_topics(&node, topics)?;
    let clouds = current_clouds();
    match clouds.first() {
        Some(cloud) if clouds.len() == 1 => Ok(cloud.to_string().into()),
        _ => Err(NodeFailure(format!(
            "{} clouds have the name {} in {}; stop all but one, or give each a different name",
            clouds.len(),
            topics.cloud,
            node.describe_domain(),
        ))),
    }
}

/// Checks that no other program uses the topics of a pipeline.
fn check_topics(node: &Ros2Node, topics: &EdgeTopics) -> Result<(), NodeFailure> {
    let remedy = "give the pipeline another name, or set ROS_NAMESPACE to a namespace of this robot";
    let expected = ros2_type_name(MessageInfo::DEFINITION.name);
    for topic in [&topics.request.info, &topics.response.info] {
        if let Some(endpoint_of_other_type) =
            node.endpoints_of(topic).iter().find(|endpoint| endpoint.type_name != expected)
        {
            let node_suffix = endpoint_of_other_type
                .node
                .as_ref()
                .map(|name| format!(" for node {name}"))
                .unwrap_or_default();
            return Err(NodeFailure(format!(
                "topic {topic} has the message type {}{node_suffix} and would need {expected}; {remedy}",
                endpoint_of_other_type.type_name
            )));
        }
    }
    for topic in [&topics.request.info, &topics.request.payload] {
        let publishers = node.publishers_of(topic);
        // A local participant belongs to another connection of this process, not to another program.
        if let Some(other_publisher) =
            publishers.iter().find(|endpoint| !is_local_participant(endpoint.id.participant()))
        {
            let host =
                other_publisher.host.map_or_else(|| "this host".to_owned(), |host| format!("host {host}"));
            let publisher = match &other_publisher.node {
                Some(name) => format!("node {name}"),
                None => {
                    format!(
                        "a program without a known node (participant {})",
                        other_publisher.id.participant()
                    )
                }
            };
            return Err(NodeFailure(format!(
                "{publisher} on {host} publishes topic {topic} already; stop it, {remedy}"
            )));
        }
    }
    Ok(())
}

/// Checks that no other cloud has the name `cloud`.
pub(super) async fn check_cloud_name(participant: &Participant, cloud: &str) -> Result<(), NodeFailure> {
    let node = participant.node()?;
    let sessions = sessions_topic(cloud);
    // Waits for the whole time even if a cloud is visible, because that cloud may just be ending.
    sleep(OTHER_CLOUD_SEARCH_TIME).await;
    match visible_clouds(&node, &sessions).is_empty() {
        true => Ok(()),
        false => Err(NodeFailure(format!(
            "another cloud has the name {cloud} in {} already; stop it, or end the address with another name",
            node.describe_domain()
        ))),
    }
}

/// Returns the participants other than this node's that subscribe to the topic on which edges ask for connections.
fn visible_clouds(node: &Ros2Node, sessions: &str) -> BTreeSet<ParticipantId> {
    let expected = ros2_type_name(SessionHello::DEFINITION.name);
    let is_cloud = |role, kind: &str| role == EndpointRole::Subscription && kind == expected;
    let endpoints = node.endpoints_of(sessions).into_iter();
    endpoints
        .filter(|endpoint| is_cloud(endpoint.role, &endpoint.type_name))
        .map(|endpoint| endpoint.id.participant())
        .collect()
}

/// Waits until a condition holds for the state of discovery.
async fn wait_for_discovery(
    node: &Ros2Node,
    time_limit: Duration,
    holds: impl Fn() -> bool,
) -> Result<(), tokio::time::error::Elapsed> {
    let mut changes = node.discovery_changes();
    let condition = async {
        while !holds() {
            if changes.changed().await.is_err() {
                // Discovery has ended. The time limit ends the wait.
                std::future::pending::<()>().await;
            }
        }
    };
    timeout(time_limit, condition).await
}
