//! A master for tests that supports topics only.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::net::{TcpListener, TcpSocket};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::ros1::RpcUri;
use crate::ros1::rpc;
use crate::ros1::xmlrpc::{Call, Response, Value};

/// Registrations of one role: topics with their nodes, each with its URI.
type Topics = BTreeMap<String, BTreeMap<String, String>>;

#[derive(Debug, Default)]
struct State {
    publishers: Topics,
    subscribers: Topics,
    types: BTreeMap<String, String>,
    nodes: BTreeMap<String, String>,
}

/// A master on its own port.
#[derive(Debug)]
pub(crate) struct TestMaster {
    address: SocketAddr,
    stop: CancellationToken,
    server: Option<tokio::task::JoinHandle<()>>,
    state: Arc<Mutex<State>>,
    changes: watch::Sender<()>,
}

impl TestMaster {
    pub(crate) async fn start() -> Self {
        let address = SocketAddr::from(([127, 0, 0, 1], 0));
        let mut master = Self {
            address,
            stop: CancellationToken::new(),
            server: None,
            state: Arc::default(),
            changes: watch::Sender::default(),
        };
        master.resume();
        master
    }

    pub(crate) fn uri(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Stops the server and removes all registrations.
    pub(super) async fn kill(&mut self) {
        self.stop.cancel();
        self.server.take().expect("it runs").await.unwrap();
        *self.state.lock().unwrap() = State::default();
    }

    /// Starts the server: at first on a free port, later on the same port.
    pub(super) fn resume(&mut self) {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_reuseaddr(true).unwrap();
        socket.bind(self.address).unwrap();
        let listener: TcpListener = socket.listen(64).unwrap();
        self.address = listener.local_addr().unwrap();
        self.stop = CancellationToken::new();
        let (state, changes) = (Arc::clone(&self.state), self.changes.clone());
        let answer = move |call: &Call| {
            let answer = answer(&mut state.lock().unwrap(), call);
            changes.send_replace(());
            answer
        };
        self.server = Some(tokio::spawn(rpc::serve(listener, answer, self.stop.clone())));
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    /// Returns the nodes that publish a topic.
    pub(crate) fn publishers(&self, topic: &str) -> Vec<String> {
        self.state().publishers.get(topic).map(|nodes| nodes.keys().cloned().collect()).unwrap_or_default()
    }

    /// Returns the nodes that subscribe to a topic.
    pub(super) fn subscribers(&self, topic: &str) -> Vec<String> {
        self.state().subscribers.get(topic).map(|nodes| nodes.keys().cloned().collect()).unwrap_or_default()
    }

    /// Returns the URI of a node.
    pub(super) fn uri_of(&self, node: &str) -> Option<String> {
        self.state().nodes.get(node).cloned()
    }

    /// Waits until a condition holds. The condition is checked after each call.
    pub(crate) async fn wait_until(&self, condition: impl Fn(&Self) -> bool) {
        let mut changes = self.changes.subscribe();
        while !condition(self) {
            changes.changed().await.unwrap();
        }
    }
}

fn success(value: impl Into<Value>) -> Response {
    Response::Success([Value::Int(1), "".into(), value.into()].into())
}

fn uris(nodes: Option<&BTreeMap<String, String>>) -> Value {
    nodes.into_iter().flat_map(BTreeMap::values).map(|uri| uri.as_str().into()).collect::<Vec<Value>>().into()
}

fn answer(state: &mut State, call: &Call) -> Response {
    let texts: Vec<&str> = call.params.iter().filter_map(Value::as_text).collect();
    match (call.method.as_str(), &texts[..]) {
        ("getUri", [_]) => success("http://master"),
        ("registerPublisher", [node, topic, kind, uri]) => {
            state.types.insert((*topic).to_owned(), (*kind).to_owned());
            register(state, node, uri);
            let nodes = state.publishers.entry((*topic).to_owned()).or_default();
            nodes.insert((*node).to_owned(), (*uri).to_owned());
            notify_subscribers(state, topic);
            success(uris(state.subscribers.get(*topic)))
        }
        ("registerSubscriber", [node, topic, _, uri]) => {
            register(state, node, uri);
            let nodes = state.subscribers.entry((*topic).to_owned()).or_default();
            nodes.insert((*node).to_owned(), (*uri).to_owned());
            success(uris(state.publishers.get(*topic)))
        }
        ("unregisterPublisher", [node, topic, uri]) => {
            let removed = remove(&mut state.publishers, topic, node, uri);
            notify_subscribers(state, topic);
            success(i64::from(removed))
        }
        ("unregisterSubscriber", [node, topic, uri]) => {
            let removed = remove(&mut state.subscribers, topic, node, uri);
            success(i64::from(removed))
        }
        ("lookupNode", [_, node]) => match state.nodes.get(*node) {
            Some(uri) => success(uri.as_str()),
            None => {
                Response::Success([Value::Int(-1), format!("unknown node [{node}]").into(), "".into()].into())
            }
        },
        ("getSystemState", [_]) => {
            let list = |topics: &Topics| -> Value {
                let entry = |(topic, nodes): (&String, &BTreeMap<String, String>)| {
                    let nodes = nodes.keys().map(|node| node.as_str().into()).collect::<Vec<Value>>();
                    Value::from([topic.as_str().into(), nodes.into()])
                };
                topics.iter().map(entry).collect::<Vec<Value>>().into()
            };
            success([list(&state.publishers), list(&state.subscribers), Vec::new().into()])
        }
        ("getTopicTypes", [_]) => {
            let entry = |(topic, kind): (&String, &String)| {
                Value::from([topic.as_str().into(), kind.as_str().into()])
            };
            success(state.types.iter().map(entry).collect::<Vec<Value>>())
        }
        _ => Response::Fault { code: 1, text: format!("unknown call {call:?}") },
    }
}

/// Removes a registration with this URI. Returns whether the registration existed.
fn remove(topics: &mut Topics, topic: &str, node: &str, uri: &str) -> bool {
    match topics.get_mut(topic) {
        Some(nodes) if nodes.get(node).is_some_and(|registered_uri| registered_uri == uri) => {
            nodes.remove(node).is_some()
        }
        _ => false,
    }
}

/// Stores a node's URI, and ends an older node with its name.
fn register(state: &mut State, node: &str, uri: &str) {
    let older_uri = state.nodes.insert(node.to_owned(), uri.to_owned());
    if let Some(older_uri) = older_uri.filter(|older_uri| older_uri != uri) {
        let reason = format!("[{node}] Reason: new node registered with same name");
        call_node(&older_uri, "shutdown", vec!["/master".into(), reason.into()]);
    }
}

fn notify_subscribers(state: &State, topic: &str) {
    let publishers = uris(state.publishers.get(topic));
    for uri in state.subscribers.get(topic).into_iter().flat_map(BTreeMap::values) {
        call_node(uri, "publisherUpdate", vec!["/master".into(), topic.into(), publishers.clone()]);
    }
}

/// Calls a node. A failure means that the node has ended.
fn call_node(uri: &str, method: &'static str, params: Vec<Value>) {
    let uri = RpcUri::parse(uri).unwrap();
    tokio::spawn(async move { rpc::call(&uri, method, params).await.map(drop) });
}
