//! The API that a node offers to the master and to other nodes ("slave API"). Calls are read without I/O.

use std::sync::Arc;

use super::master::{SUCCESS, split_answer, texts};
use super::node::NodeState;
use super::publisher::PublishedTopic;
use super::subscriber::{PublisherState, SubscribedTopic};
use super::xmlrpc::{Call, Response, Value};

/// Code of an answer to an invalid call.
const ERROR: i64 = -1;

/// Code of an answer to a call that failed.
const FAILURE: i64 = 0;

/// End of the reason with which the master asks a node to shut down when another node registers with its name. The
/// reason begins with `[/NODE] Reason: `.
const NAME_TAKEN_REASON: &str = "new node registered with same name";

/// A call of the API. The first parameter, the caller's name, is omitted where it is not used.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum SlaveCall {
    BusStats,
    BusInfo,
    MasterUri,
    Shutdown { caller: String, reason: String },
    Pid,
    Subscriptions,
    Publications,
    ParamUpdate,
    PublisherUpdate { topic: String, publishers: Vec<String> },
    RequestTopic { topic: String, protocols: Vec<String> },
}

/// Reason why a call is not a valid call of the API.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum CallError {
    UnknownMethod,
    InvalidParameters,
}

impl SlaveCall {
    /// Reads a call.
    pub(super) fn read(call: &Call) -> Result<Self, CallError> {
        let slave_call = match (call.method.as_str(), call.params.as_slice()) {
            ("getBusStats", [_]) => Some(Self::BusStats),
            ("getBusInfo", [_]) => Some(Self::BusInfo),
            ("getMasterUri", [_]) => Some(Self::MasterUri),
            ("getPid", [_]) => Some(Self::Pid),
            ("getSubscriptions", [_]) => Some(Self::Subscriptions),
            ("getPublications", [_]) => Some(Self::Publications),
            ("paramUpdate", [_, _, _]) => Some(Self::ParamUpdate),
            ("shutdown", [caller, reason @ ..]) if reason.len() <= 1 => caller.as_text().map(|caller| {
                let reason = reason.first().and_then(Value::as_text).unwrap_or_default();
                Self::Shutdown { caller: caller.to_owned(), reason: reason.to_owned() }
            }),
            ("publisherUpdate", [_, topic, publishers]) => topic
                .as_text()
                .zip(texts(publishers))
                .map(|(topic, publishers)| Self::PublisherUpdate { topic: topic.to_owned(), publishers }),
            ("requestTopic", [_, topic, protocols]) => topic
                .as_text()
                .zip(protocol_names(protocols))
                .map(|(topic, protocols)| Self::RequestTopic { topic: topic.to_owned(), protocols }),
            (
                "getBusStats" | "getBusInfo" | "getMasterUri" | "getPid" | "getSubscriptions"
                | "getPublications" | "paramUpdate" | "shutdown" | "publisherUpdate" | "requestTopic",
                _,
            ) => None,
            _ => return Err(CallError::UnknownMethod),
        };
        slave_call.ok_or(CallError::InvalidParameters)
    }
}

/// Reads the names of protocols. Each name is the first element of a list with the protocol's parameters.
fn protocol_names(value: &Value) -> Option<Vec<String>> {
    let name = |protocol: &Value| protocol.as_array()?.first()?.as_text().map(str::to_owned);
    value.as_array()?.iter().map(name).collect()
}

/// Answers a call to a node.
pub(super) fn answer(node: &NodeState, call: &Call) -> Response {
    match SlaveCall::read(call) {
        Ok(call) => Response::Success(execute(node, call)),
        Err(CallError::InvalidParameters) => {
            // ROS reports invalid parameters in the answer. Faults are for unknown methods.
            let text = format!("invalid parameters of {}", call.method);
            Response::Success([ERROR.into(), text.into(), 0.into()].into())
        }
        Err(CallError::UnknownMethod) => {
            Response::Fault { code: ERROR, text: format!("unknown method {:?}", call.method) }
        }
    }
}

fn success(value: impl Into<Value>) -> Value {
    [SUCCESS.into(), "".into(), value.into()].into()
}

/// Executes a call. Returns the value of the answer.
fn execute(node: &NodeState, call: SlaveCall) -> Value {
    match call {
        SlaveCall::BusStats => success(bus_statistics(node)),
        SlaveCall::BusInfo => success(bus_info(node)),
        SlaveCall::MasterUri => success(node.registrar.master().uri().as_str()),
        SlaveCall::Pid => success(i64::from(std::process::id())),
        SlaveCall::Subscriptions => {
            let topics = node.topics.subscribed();
            let name_and_type = |topic: &Arc<SubscribedTopic>| {
                [(&*topic.subscription.topic).into(), (&*topic.subscription.kind.name).into()].into()
            };
            success(topics.iter().map(name_and_type).collect::<Vec<Value>>())
        }
        SlaveCall::Publications => {
            let topics = node.topics.published();
            let name_and_type = |topic: &Arc<PublishedTopic>| {
                [(&*topic.publication.topic).into(), (&*topic.publication.kind.name).into()].into()
            };
            success(topics.iter().map(name_and_type).collect::<Vec<Value>>())
        }
        // The node caches no parameters, so there is nothing to update.
        SlaveCall::ParamUpdate => success(0),
        // The call is wrong if it is meant for an ended node whose port this node has now. It is also wrong if an ended
        // node of the same name has replaced this node at the master, because the ended node's registration arrived
        // late. Therefore the registrar asks the master which node has the name.
        SlaveCall::Shutdown { reason, .. } if reason.ends_with(NAME_TAKEN_REASON) => {
            node.registrar.request_check();
            success(0)
        }
        SlaveCall::Shutdown { caller, reason } => {
            let reason = if reason.is_empty() { "no reason given".to_owned() } else { reason };
            node.lifetime.end(format!("{caller} asked it to shut down: {reason}"));
            success(0)
        }
        SlaveCall::PublisherUpdate { topic, publishers } => {
            if let Some(subscribed) = node.topics.find_subscribed(&topic) {
                subscribed.set_publishers(&publishers);
            }
            success(0)
        }
        SlaveCall::RequestTopic { topic, protocols } => request_topic(node, &topic, &protocols),
    }
}

/// Returns whether an answer to `getPublications` or `getSubscriptions` contains a topic.
pub(super) fn has_topic(answer: Value, topic: &str) -> bool {
    let Some((SUCCESS, _, topics)) = split_answer(answer) else { return false };
    let is_topic = |pair: &Value| pair.as_array().and_then(|pair| pair.first()?.as_text()) == Some(topic);
    topics.as_array().is_some_and(|topics| topics.iter().any(is_topic))
}

fn request_topic(node: &NodeState, topic: &str, protocols: &[String]) -> Value {
    let failure = |text: String| [FAILURE.into(), text.into(), Value::Int(0)].into();
    if node.topics.find_published(topic).is_none() {
        return failure(format!("topic {topic} is not published by node {}", node.name.global()));
    }
    if !protocols.iter().any(|protocol| protocol == "TCPROS") {
        return failure(format!("node {} offers TCPROS only, asked for {protocols:?}", node.name.global()));
    }
    let (host, port) = (node.address.host(), node.address.tcpros_port());
    let text = format!("ready on {host}:{port}");
    let params = ["TCPROS".into(), host.into(), i64::from(port).into()];
    [SUCCESS.into(), text.into(), params.into()].into()
}

/// Returns a count as an XML-RPC value.
fn count_value(count: u64) -> Value {
    Value::Int(i64::try_from(count).unwrap_or(i64::MAX))
}

/// Returns the statistics for `getBusStats`: of publishers, of subscribers, and of services, which this node does not
/// have.
fn bus_statistics(node: &NodeState) -> Value {
    let (published, subscribed) = (node.topics.published(), node.topics.subscribed());
    let publishers = published.iter().map(|topic| {
        let connections = topic.subscribers().into_iter().zip(0..).map(|(subscriber, id)| {
            let counts = subscriber.counts;
            // Only connected subscribers are listed.
            let is_connected = Value::Bool(true);
            [Value::Int(id), count_value(counts.sent_bytes), count_value(counts.sent), is_connected].into()
        });
        let sent_bytes = count_value(topic.counts().sent_bytes);
        let connections = connections.collect::<Vec<Value>>();
        [(&*topic.publication.topic).into(), sent_bytes, connections.into()].into()
    });
    let subscribers = subscribed.iter().map(|topic| {
        let connections = topic.publishers().into_iter().zip(0..).map(|(publisher, id)| {
            let is_connected = matches!(publisher.state, PublisherState::Connected(_));
            let counts = publisher.counts;
            [
                Value::Int(id),
                count_value(counts.bytes),
                count_value(counts.dropped),
                Value::Bool(is_connected),
            ]
            .into()
        });
        [(&*topic.subscription.topic).into(), connections.collect::<Vec<Value>>().into()].into()
    });
    // Numbers of requests, of received bytes and of sent bytes, as the slave API requires.
    let services = Value::from([0.into(), 0.into(), 0.into()]);
    [publishers.collect::<Vec<Value>>().into(), subscribers.collect::<Vec<Value>>().into(), services].into()
}

/// Returns the connections for `getBusInfo`. Each has a number, the other end, the direction (`i` in, `o` out), the
/// transport, the topic, whether it is connected, and a description.
fn bus_info(node: &NodeState) -> Value {
    let mut connections: Vec<Value> = Vec::new();
    let mut add_connection =
        |other_end: &str, direction: &str, topic: &str, is_connected: bool, description: String| {
            let id = Value::Int(connections.len() as i64 + 1);
            let connected = Value::Bool(is_connected);
            let (other_end, direction, topic) = (other_end.into(), direction.into(), topic.into());
            connections.push(
                [id, other_end, direction, "TCPROS".into(), topic, connected, description.into()].into(),
            );
        };
    for topic in node.topics.published() {
        for subscriber in topic.subscribers() {
            let description =
                format!("TCPROS connection on port {} to [{}]", subscriber.local.port(), subscriber.remote);
            // Only connected subscribers are listed.
            let is_connected = true;
            add_connection(&subscriber.node, "o", &topic.publication.topic, is_connected, description);
        }
    }
    for topic in node.topics.subscribed() {
        for publisher in topic.publishers() {
            let (is_connected, description) = match publisher.state {
                PublisherState::Connecting => (false, "connecting".to_owned()),
                PublisherState::Failed(reason) => (false, reason),
                PublisherState::Connected(info) => {
                    let description =
                        format!("TCPROS connection on port {} to [{}]", info.local.port(), info.remote);
                    (true, description)
                }
            };
            add_connection(&publisher.uri, "i", &topic.subscription.topic, is_connected, description);
        }
    }
    connections.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(method: &str, params: Vec<Value>) -> Result<SlaveCall, CallError> {
        SlaveCall::read(&Call { method: method.to_owned(), params })
    }

    #[test]
    fn calls_are_read() {
        assert_eq!(call("getPid", vec!["/c".into()]), Ok(SlaveCall::Pid));
        let protocols =
            Value::from([Value::from(["UDPROS".into(), 1.into()]), Value::from(["TCPROS".into()])]);
        assert_eq!(
            call("requestTopic", vec!["/c".into(), "/t".into(), protocols]),
            Ok(SlaveCall::RequestTopic {
                topic: "/t".into(),
                protocols: vec!["UDPROS".into(), "TCPROS".into()]
            })
        );
        assert_eq!(
            call("publisherUpdate", vec!["/master".into(), "/t".into(), ["http://a:1/".into()].into()]),
            Ok(SlaveCall::PublisherUpdate { topic: "/t".into(), publishers: vec!["http://a:1/".into()] })
        );
        assert_eq!(
            call("shutdown", vec!["/master".into()]),
            Ok(SlaveCall::Shutdown { caller: "/master".into(), reason: String::new() })
        );
    }

    #[test]
    fn wrong_calls_get_distinct_errors() {
        assert_eq!(call("getPid", vec![]), Err(CallError::InvalidParameters));
        assert_eq!(
            call("requestTopic", vec!["/c".into(), "/t".into(), ["TCPROS".into()].into()]),
            Err(CallError::InvalidParameters)
        );
        assert_eq!(call("format", vec!["/c".into()]), Err(CallError::UnknownMethod));
    }
}
