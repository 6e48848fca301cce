//! The connection to one subscriber, with a bounded queue.
//!
//! The publishing task writes to the socket itself, as far as the kernel accepts bytes. The connection's task writes
//! what remains in the queue.

use std::collections::VecDeque;
use std::io::{self, IoSlice};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::net::TcpStream;
use tokio::sync::Notify;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::limits::{DRAIN_TIMEOUT, HANDSHAKE_TIMEOUT, QueueLimits};
use crate::messages::EncodedMessage;

/// Maximum number of slices that one system call writes.
const MAX_SLICES: usize = 64;

/// Numbers of messages for one subscriber, by outcome. At all times, `offered = sent + dropped + lost + waiting`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendCounts {
    /// Messages that were published while the subscriber was connected.
    pub offered: u64,
    /// Messages that the kernel accepted completely.
    pub sent: u64,
    /// Bytes that the kernel accepted, including the length before each message.
    pub sent_bytes: u64,
    /// Messages that were dropped because the queue was full.
    pub dropped: u64,
    /// Messages that were waiting in the queue when the connection ended.
    pub lost: u64,
    /// Messages that wait in the queue, including the message that is partly written.
    pub waiting: u64,
}

impl SendCounts {
    pub(super) fn add(&mut self, other: &Self) {
        self.offered += other.offered;
        self.sent += other.sent;
        self.sent_bytes += other.sent_bytes;
        self.dropped += other.dropped;
        self.lost += other.lost;
        self.waiting += other.waiting;
    }
}

/// Result of offering a message to a queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OfferOutcome {
    Accepted,
    Full,
    Closed,
}

/// Policy for a message that is offered to a full queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FullQueuePolicy {
    /// The message is dropped and counted.
    Drop,
    /// The message is refused and not counted, because the caller offers it again.
    Refuse,
}

/// A connection to a subscriber.
#[derive(Debug)]
pub(super) struct OutgoingConnection {
    pub(super) subscriber: Arc<str>,
    pub(super) local: SocketAddr,
    pub(super) remote: SocketAddr,
    stream: TcpStream,
    limits: QueueLimits,
    queue: Mutex<Queue>,
    /// Notified when the task has something to write.
    write_needed: Notify,
    /// Notified when there may be space in the queue again.
    space_freed: Notify,
}

#[derive(Debug, Default)]
struct Queue {
    messages: VecDeque<QueuedMessage>,
    bytes: usize,
    /// `true` if the header has been written, which precedes all messages.
    is_header_written: bool,
    is_closed: bool,
    counts: SendCounts,
}

#[derive(Debug)]
struct QueuedMessage {
    /// Length of the message, which is written before the message.
    prefix: [u8; 4],
    message: EncodedMessage,
    /// Number of written bytes, including the prefix.
    written: usize,
}

impl QueuedMessage {
    fn len(&self) -> usize {
        self.prefix.len() + self.message.len()
    }

    /// Returns the bytes of the message that are not written yet.
    fn unwritten_slices(&self) -> impl Iterator<Item = &[u8]> {
        let mut skip = self.written;
        let segments = self.message.segments().iter().map(|segment| &segment[..]);
        std::iter::once(&self.prefix[..]).chain(segments).filter_map(move |piece| {
            let skipped = skip.min(piece.len());
            skip -= skipped;
            Some(&piece[skipped..]).filter(|slice| !slice.is_empty())
        })
    }
}

impl OutgoingConnection {
    pub(super) fn new(stream: TcpStream, subscriber: Arc<str>, limits: QueueLimits) -> io::Result<Self> {
        Ok(Self {
            subscriber,
            local: stream.local_addr()?,
            remote: stream.peer_addr()?,
            stream,
            limits,
            queue: Mutex::default(),
            write_needed: Notify::new(),
            space_freed: Notify::new(),
        })
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn counts(&self) -> SendCounts {
        let queue = self.queue();
        SendCounts { waiting: queue.messages.len() as u64, ..queue.counts }
    }

    /// Queues a message, and writes what the kernel accepts at once.
    pub(super) fn offer(
        &self,
        message: &EncodedMessage,
        prefix: [u8; 4],
        full_queue_policy: FullQueuePolicy,
    ) -> OfferOutcome {
        let mut queue = self.queue();
        if queue.is_closed {
            return OfferOutcome::Closed;
        }
        let message = QueuedMessage { prefix, message: message.clone(), written: 0 };
        if !self.limits.accepts(queue.messages.len(), queue.bytes, message.len()) {
            if full_queue_policy == FullQueuePolicy::Drop {
                queue.counts.offered += 1;
                queue.counts.dropped += 1;
            }
            return OfferOutcome::Full;
        }
        queue.counts.offered += 1;
        queue.bytes += message.len();
        queue.messages.push_back(message);
        // If earlier messages wait in the queue, the task writes them and then this message.
        if queue.is_header_written && queue.messages.len() == 1 {
            self.write_queue(&mut queue);
            if !queue.messages.is_empty() {
                self.write_needed.notify_one();
            }
        }
        OfferOutcome::Accepted
    }

    /// Returns whether the queue is too full for a message of `length` bytes.
    pub(super) fn is_full(&self, length: usize) -> bool {
        let queue = self.queue();
        !queue.is_closed && !self.limits.accepts(queue.messages.len(), queue.bytes, length)
    }

    /// Waits until the queue has accepted a message. Returns `false` if the connection has ended instead.
    pub(super) async fn offer_until_accepted(&self, message: &EncodedMessage, prefix: [u8; 4]) -> bool {
        loop {
            // The future is created before the queue is checked, so that no change in between is missed.
            let space_freed = self.space_freed.notified();
            match self.offer(message, prefix, FullQueuePolicy::Refuse) {
                OfferOutcome::Accepted => return true,
                OfferOutcome::Closed => return false,
                OfferOutcome::Full => space_freed.await,
            }
        }
    }

    /// Writes until the queue is empty or the kernel accepts no more. An error closes the queue.
    fn write_queue(&self, queue: &mut Queue) {
        while !queue.messages.is_empty() {
            let mut slices = [IoSlice::new(&[]); MAX_SLICES];
            let mut count = 0;
            let unwritten_slices = queue.messages.iter().flat_map(QueuedMessage::unwritten_slices);
            for (slice, piece) in slices.iter_mut().zip(unwritten_slices) {
                *slice = IoSlice::new(piece);
                count += 1;
            }
            match self.stream.try_write_vectored(&slices[..count]) {
                Ok(written) => queue.advance(written),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    tracing::debug!(subscriber = &*self.subscriber, %error, "a ROS subscriber disconnected");
                    queue.close();
                    // The task ends the connection.
                    self.write_needed.notify_one();
                }
            }
        }
    }

    fn write_unsent(&self) {
        self.write_queue(&mut self.queue());
        self.space_freed.notify_waiters();
    }

    fn has_unsent(&self) -> bool {
        !self.queue().messages.is_empty()
    }

    /// Writes the header, and then messages until the subscriber closes the connection or `stop` is cancelled. In the
    /// latter case the waiting messages are written within [`DRAIN_TIMEOUT`].
    pub(super) async fn run(&self, header: &[u8], stop: &CancellationToken) {
        match timeout(HANDSHAKE_TIMEOUT, self.write_header(header)).await {
            Ok(Ok(())) => self.write_messages(stop).await,
            Ok(Err(error)) => {
                tracing::debug!(subscriber = &*self.subscriber, %error, "a ROS subscriber disconnected");
            }
            Err(_) => tracing::warn!(
                subscriber = &*self.subscriber,
                "a ROS subscriber did not read the publisher's header in time"
            ),
        }
        self.queue().close();
        // Wakes publishers that wait for space, so that they see the closed queue.
        self.space_freed.notify_waiters();
    }

    async fn write_header(&self, mut header: &[u8]) -> io::Result<()> {
        while !header.is_empty() {
            self.stream.writable().await?;
            match self.stream.try_write(header) {
                Ok(written) => header = &header[written..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
        self.queue().is_header_written = true;
        self.write_unsent();
        Ok(())
    }

    async fn write_messages(&self, stop: &CancellationToken) {
        // Subscribers send nothing; reading detects that they close the connection.
        let mut ignored = [0; 256];
        while !self.queue().is_closed {
            let has_unsent = self.has_unsent();
            tokio::select! {
                () = stop.cancelled() => {
                    if timeout(DRAIN_TIMEOUT, self.drain()).await.is_err() {
                        tracing::warn!(
                            subscriber = &*self.subscriber,
                            messages = self.counts().waiting,
                            "a ROS subscriber did not read its last messages in time; they are lost"
                        );
                    }
                    break;
                }
                readable = self.stream.readable() => {
                    let read = readable.and_then(|()| self.stream.try_read(&mut ignored));
                    match read {
                        Ok(0) => break,
                        Ok(_) => {}
                        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                        Err(_) => break,
                    }
                }
                // Without unsent messages this branch is off, because a socket is writable nearly all the time.
                _ = self.stream.writable(), if has_unsent => self.write_unsent(),
                () = self.write_needed.notified() => {}
            }
        }
    }

    async fn drain(&self) {
        while self.has_unsent() && self.stream.writable().await.is_ok() {
            self.write_unsent();
        }
    }
}

impl Queue {
    /// Removes `written` bytes from the front, and counts the messages that are written completely.
    fn advance(&mut self, mut written: usize) {
        self.counts.sent_bytes += written as u64;
        while written > 0 {
            let Some(first) = self.messages.front_mut() else { return };
            let unwritten = first.len() - first.written;
            if written < unwritten {
                first.written += written;
                return;
            }
            written -= unwritten;
            self.bytes -= first.len();
            self.messages.pop_front();
            self.counts.sent += 1;
        }
    }

    fn close(&mut self) {
        self.is_closed = true;
        self.counts.lost += self.messages.len() as u64;
        self.messages.clear();
        self.bytes = 0;
    }
}
