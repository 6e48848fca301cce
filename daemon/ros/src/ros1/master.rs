//! Client of the master's API, with the calls that a node with topics needs.

use super::environment::{Environment, RpcUri};
use super::error::NodeError;
use super::rpc::{self, RpcError};
use super::xmlrpc::Value;

/// Code of a successful answer.
pub(super) const SUCCESS: i64 = 1;

/// A topic and the nodes that publish or subscribe to it, or a service and its nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedNodes {
    /// Global name of the topic or service.
    pub name: String,
    /// Global names of the nodes.
    pub nodes: Vec<String>,
}

/// The master's lists of topics and services, with their nodes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SystemState {
    /// Topics with their publishers.
    pub publishers: Vec<NamedNodes>,
    /// Topics with their subscribers.
    pub subscribers: Vec<NamedNodes>,
    /// Services with their nodes.
    pub services: Vec<NamedNodes>,
}

impl SystemState {
    /// Returns the names of the nodes that publish a topic.
    pub fn publishers_of(&self, topic: &str) -> &[String] {
        nodes_of(&self.publishers, topic)
    }

    /// Returns the names of the nodes that subscribe to a topic.
    pub fn subscribers_of(&self, topic: &str) -> &[String] {
        nodes_of(&self.subscribers, topic)
    }
}

fn nodes_of<'a>(entries: &'a [NamedNodes], name: &str) -> &'a [String] {
    entries.iter().find(|entry| entry.name == name).map_or(&[], |entry| &entry.nodes)
}

/// Returns all topics that the master knows, with the names of their types. Does not register a node.
///
/// # Errors
/// If the master does not answer.
pub async fn topic_types(environment: &Environment) -> Result<Vec<(String, String)>, NodeError> {
    MasterClient::new(environment.master.clone(), "/peernet").topic_types().await
}

/// Client of the master for one node.
#[derive(Clone, Debug)]
pub(super) struct MasterClient {
    uri: RpcUri,
    caller: String,
}

impl MasterClient {
    pub(super) fn new(uri: RpcUri, caller: &str) -> Self {
        Self { uri, caller: caller.to_owned() }
    }

    pub(super) fn uri(&self) -> &RpcUri {
        &self.uri
    }

    /// Calls a method. The caller's name precedes the parameters.
    async fn call(&self, method: &'static str, params: &[&str]) -> Result<Value, NodeError> {
        let params = [self.caller.as_str()].iter().chain(params).map(|text| Value::from(*text)).collect();
        let answer = match rpc::call(&self.uri, method, params).await {
            Ok(answer) => answer,
            Err(RpcError::Fault { text, .. }) => return Err(self.refusal(method, text)),
            Err(source) => return Err(NodeError::NoMaster { uri: self.uri.to_string(), source }),
        };
        match split_answer(answer) {
            Some((SUCCESS, _, value)) => Ok(value),
            Some((_, reason, _)) => Err(self.refusal(method, reason)),
            None => Err(self.not_a_master(method)),
        }
    }

    fn refusal(&self, method: &'static str, reason: String) -> NodeError {
        NodeError::MasterRefused { uri: self.uri.to_string(), method, reason }
    }

    fn not_a_master(&self, method: &'static str) -> NodeError {
        NodeError::NotAMaster { uri: self.uri.to_string(), method }
    }

    /// Checks that a master answers.
    pub(super) async fn check(&self) -> Result<(), NodeError> {
        self.call("getUri", &[]).await.map(drop)
    }

    /// Registers the node with the URI `uri` as a publisher or subscriber of a topic. Returns the URIs of the topic's
    /// subscribers for a publisher, of its publishers for a subscriber.
    pub(super) async fn register(
        &self,
        method: &'static str,
        topic: &str,
        kind: &str,
        uri: &str,
    ) -> Result<Vec<String>, NodeError> {
        let answer = self.call(method, &[topic, kind, uri]).await?;
        texts(&answer).ok_or_else(|| self.not_a_master(method))
    }

    /// Removes a registration.
    pub(super) async fn unregister(
        &self,
        method: &'static str,
        topic: &str,
        uri: &str,
    ) -> Result<(), NodeError> {
        self.call(method, &[topic, uri]).await.map(drop)
    }

    /// Returns the URI of a node; `None` if the master does not know it.
    pub(super) async fn look_up_node(&self, node: &str) -> Result<Option<String>, NodeError> {
        match self.call("lookupNode", &[node]).await {
            Ok(Value::Text(uri)) => Ok(Some(uri)),
            Ok(_) => Err(self.not_a_master("lookupNode")),
            // The master answers with a refusal if it does not know the node.
            Err(NodeError::MasterRefused { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    pub(super) async fn system_state(&self) -> Result<SystemState, NodeError> {
        let state = self.call("getSystemState", &[]).await?;
        read_system_state(&state).ok_or_else(|| self.not_a_master("getSystemState"))
    }

    /// Returns topics with the names of their types.
    pub(super) async fn topic_types(&self) -> Result<Vec<(String, String)>, NodeError> {
        let types = self.call("getTopicTypes", &[]).await?;
        let pair = |value: &Value| match value.as_array()? {
            [topic, kind] => Some((topic.as_text()?.to_owned(), kind.as_text()?.to_owned())),
            _ => None,
        };
        let pairs = types.as_array().and_then(|entries| entries.iter().map(pair).collect());
        pairs.ok_or_else(|| self.not_a_master("getTopicTypes"))
    }
}

/// Splits an answer of the master's or a node's API into a code, a text and the result.
pub(super) fn split_answer(answer: Value) -> Option<(i64, String, Value)> {
    let Value::Array(parts) = answer else { return None };
    let [code, text, value] = <[Value; 3]>::try_from(parts).ok()?;
    Some((code.as_int()?, text.as_text()?.to_owned(), value))
}

/// Returns the elements of an array of texts.
pub(super) fn texts(value: &Value) -> Option<Vec<String>> {
    value.as_array()?.iter().map(|text| text.as_text().map(str::to_owned)).collect()
}

fn read_system_state(state: &Value) -> Option<SystemState> {
    let entry = |value: &Value| match value.as_array()? {
        [name, nodes] => Some(NamedNodes { name: name.as_text()?.to_owned(), nodes: texts(nodes)? }),
        _ => None,
    };
    let entries = |value: &Value| value.as_array()?.iter().map(entry).collect::<Option<Vec<_>>>();
    match state.as_array()? {
        [publishers, subscribers, services] => Some(SystemState {
            publishers: entries(publishers)?,
            subscribers: entries(subscribers)?,
            services: entries(services)?,
        }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_state_is_read() {
        let topic = |name: &str, nodes: &[&str]| {
            let nodes: Vec<Value> = nodes.iter().map(|node| Value::from(*node)).collect();
            Value::from([name.into(), nodes.into()])
        };
        let publishers = Value::from([topic("/t", &["/a", "/b"])]);
        let state = Value::from([publishers, Vec::new().into(), Vec::new().into()]);
        let state = read_system_state(&state).unwrap();
        assert_eq!(state.publishers_of("/t"), ["/a", "/b"]);
        assert!(state.publishers_of("/other").is_empty());
        assert_eq!(read_system_state(&Value::from([Value::Int(1)])), None);
    }
}
