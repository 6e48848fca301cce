//! Tests with publishers that claim long messages.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;

use super::{TestMaster, node, within};
use crate::messages::StringMessage;
use crate::ros1::rpc;
use crate::ros1::tcpros::{ConnectionHeader, Publication};
use crate::ros1::xmlrpc::{Response, Value};
use crate::ros1::{MemoryLimit, PublisherOptions, RpcUri, SubscriberOptions, TopicType};

/// A limit of bytes that messages share.
#[derive(Clone, Debug)]
pub(in crate::ros1) struct TestLimit {
    reserved: Arc<AtomicUsize>,
    max: usize,
}

impl TestLimit {
    pub(in crate::ros1) fn new(max: usize) -> Self {
        Self { reserved: Arc::default(), max }
    }

    /// Returns the limit in the form that options have.
    pub(in crate::ros1) fn to_memory_limit(&self) -> Option<Arc<dyn MemoryLimit>> {
        Some(Arc::new(self.clone()))
    }

    pub(in crate::ros1) fn reserved(&self) -> usize {
        self.reserved.load(Relaxed)
    }
}

impl MemoryLimit for TestLimit {
    fn reserve(&self, bytes: usize) -> Option<Box<dyn Any + Send + Sync>> {
        let reserved = self.reserved.fetch_add(bytes, Relaxed) + bytes;
        let reservation = Reservation(Arc::clone(&self.reserved), bytes);
        // Above the limit, the reservation is dropped, which returns its bytes.
        (reserved <= self.max).then(|| Box::new(reservation) as Box<dyn Any + Send + Sync>)
    }
}

struct Reservation(Arc<AtomicUsize>, usize);

impl Drop for Reservation {
    fn drop(&mut self) {
        self.0.fetch_sub(self.1, Relaxed);
    }
}

/// Registers a publisher that is not one of our nodes. Returns the connection of its first subscriber.
async fn foreign_publisher(master: &TestMaster, name: &str, stop: &CancellationToken) -> TcpStream {
    let publication = Publication {
        node: name.into(),
        topic: "/t".into(),
        kind: TopicType::from_message::<StringMessage>(),
        is_latching: false,
    };
    let (server, messages) = (listener().await, listener().await);
    let uri = format!("http://{}", server.local_addr().unwrap());
    let port = Value::Int(messages.local_addr().unwrap().port().into());
    let endpoint = Value::from(["TCPROS".into(), "127.0.0.1".into(), port]);
    let answer = move |_: &_| Response::Success([Value::Int(1), "".into(), endpoint.clone()].into());
    tokio::spawn(rpc::serve(server, answer, stop.clone()));
    let params = vec![name.into(), "/t".into(), "std_msgs/String".into(), uri.as_str().into()];
    within(rpc::call(&RpcUri::parse(&master.uri()).unwrap(), "registerPublisher", params)).await.unwrap();
    let (mut stream, _) = within(messages.accept()).await.unwrap();
    let length = within(stream.read_u32_le()).await.unwrap();
    let mut header = vec![0; length as usize];
    within(stream.read_exact(&mut header)).await.unwrap();
    let (answer, _) = publication.answer(&ConnectionHeader::decode(&header).unwrap()).unwrap();
    within(stream.write_all(&answer.encode())).await.unwrap();
    stream
}

async fn listener() -> TcpListener {
    TcpListener::bind("127.0.0.1:0").await.unwrap()
}

#[tokio::test]
async fn claimed_lengths_take_no_memory_of_other_publishers() {
    const CLAIMED_BYTES: u32 = 50_000_000;
    let master = TestMaster::start().await;
    let (a, b) = (node(&master, "a").await, node(&master, "b").await);
    let kind = TopicType::from_message::<StringMessage>();
    let limit = TestLimit::new(4_000_000);
    let options = SubscriberOptions { memory: limit.to_memory_limit(), ..SubscriberOptions::default() };
    let mut subscriber = b.subscribe("t", kind.clone(), options).await.unwrap();
    let stop = CancellationToken::new();
    let mut claiming_streams = Vec::new();
    for number in 0..16 {
        let mut stream = foreign_publisher(&master, &format!("/claiming{number}"), &stop).await;
        within(stream.write_all(&CLAIMED_BYTES.to_le_bytes())).await.unwrap();
        within(stream.write_all(&[0; 10_000])).await.unwrap();
        claiming_streams.push(stream);
    }
    let publisher = a.publish("t", kind, PublisherOptions::default()).await.unwrap();
    within(subscriber.wait_for_publishers(17)).await.unwrap();
    let message = Bytes::from(vec![7; 1_000_000]);
    for _ in 0..20 {
        within(publisher.publish_waiting(message.clone())).await.unwrap();
        assert_eq!(within(subscriber.recv()).await.unwrap().bytes, message);
    }
    assert_eq!(subscriber.counts().connections, 17, "no publisher was disconnected");
    // One of the claiming publishers sends the claimed bytes, until the memory is exhausted and it is disconnected.
    let [claiming_stream, ..] = &mut claiming_streams[..] else { unreachable!() };
    within(async { while claiming_stream.write_all(&[0; 100_000]).await.is_ok() {} }).await;
    within(publisher.publish_waiting(message.clone())).await.unwrap();
    assert_eq!(within(subscriber.recv()).await.unwrap().bytes, message);
    drop(claiming_streams);
    stop.cancel();
}
