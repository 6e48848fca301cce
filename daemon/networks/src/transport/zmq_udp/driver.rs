//! The task of a socket, which moves datagrams between the socket and the state machine of its connections.

use std::collections::VecDeque;
use std::fmt;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use peernet_clock::{MonoTime, Span};
use tokio::sync::{Notify, mpsc};
use tokio::time::{Instant, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::radio;
use super::socket::{ReceiveBuffers, UdpPort};
use crate::transport::datagram::endpoint::Route;
use crate::transport::datagram::sending::Batch;

/// Maximum number of deliveries that wait to be received.
const MAX_QUEUED_DELIVERIES: usize = 1_024;

/// Maximum number of batches that are read before the next send.
const READS_PER_ITERATION: usize = 8;

/// Shortest and longest sleep of the task.
const MIN_SLEEP: Span = Span::from_millis(1);
const MAX_SLEEP: Span = Span::from_seconds(3_600);

/// The state machine of a socket.
pub(super) trait Machine: Send + fmt::Debug + 'static {
    /// An event for the layer above.
    type Delivery: Send + 'static;

    /// Handles the body of a datagram. `local` is the address of this host at which the datagram arrived.
    fn receive(&mut self, source: SocketAddr, local: Option<IpAddr>, body: &[u8], now: MonoTime);
    /// Handles the report of the system that no socket is bound to the destination port.
    fn handle_port_unreachable(&mut self);
    /// Runs the timers that have expired at `now`.
    fn tick(&mut self, now: MonoTime);
    /// Returns the latest time for the next call of [`tick`](Self::tick); `None` if no timer runs.
    fn next_timer(&self, now: MonoTime) -> Option<MonoTime>;
    /// Appends datagrams that may be sent now. Returns their route; `None` if there are none.
    fn fill(&mut self, out: &mut Vec<u8>, max_datagrams: usize, now: MonoTime) -> Option<(Route, Batch)>;
    /// Removes and returns the next event for the layer above.
    fn next_delivery(&mut self) -> Option<Self::Delivery>;
    /// Starts to say goodbye.
    fn close(&mut self, now: MonoTime);
    /// Says goodbye once, and does not wait for the answer.
    fn abandon(&mut self);
    /// Returns whether nothing is left to do.
    fn is_finished(&self) -> bool;
}

/// State that senders share with the task.
#[derive(Debug)]
pub(super) struct Port<M> {
    pub(super) socket: UdpPort,
    state: Mutex<State<M>>,
    /// Wakes the task.
    wake: Notify,
    /// Token that ends the task at once.
    pub(super) abort: CancellationToken,
    /// Token that the task cancels when it ends.
    pub(super) ended: CancellationToken,
    start: Instant,
}

#[derive(Debug)]
struct State<M> {
    machine: M,
    /// Datagrams that are being sent.
    out: Vec<u8>,
    /// Route and batch of the datagrams in `out` if the socket has not accepted these datagrams.
    blocked_batch: Option<(Route, Batch)>,
    /// Time until which the task sleeps if nothing wakes it.
    asleep_until: MonoTime,
}

impl<M: Machine> Port<M> {
    /// Starts to serve a socket. The machine's time is counted from `start`.
    pub(super) fn serve(
        socket: UdpPort,
        machine: M,
        start: Instant,
    ) -> (Arc<Self>, mpsc::Receiver<M::Delivery>) {
        let port = Arc::new(Self {
            socket,
            state: Mutex::new(State {
                machine,
                out: Vec::new(),
                blocked_batch: None,
                asleep_until: MonoTime::default(),
            }),
            wake: Notify::new(),
            abort: CancellationToken::new(),
            ended: CancellationToken::new(),
            start,
        });
        let (sender, receiver) = mpsc::channel(MAX_QUEUED_DELIVERIES);
        tokio::spawn(Arc::clone(&port).run(sender));
        (port, receiver)
    }

    /// Converts an instant to the machine's time.
    pub(super) fn time(&self, at: Instant) -> MonoTime {
        time_since(self.start, at)
    }

    fn lock(&self) -> MutexGuard<'_, State<M>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Calls `action` with the machine, then sends the datagrams that the machine may send.
    pub(super) fn with_machine<T>(&self, action: impl FnOnce(&mut M, MonoTime) -> T) -> T {
        let mut state = self.lock();
        let now = self.time(Instant::now());
        let result = action(&mut state.machine, now);
        self.flush(&mut state);
        // The task is woken only if it must send the rest, run an earlier timer or report the end of the connection. A
        // needless wake-up would take longer than sending the message. No timer runs if no connection is open.
        let next_timer = state.machine.next_timer(now);
        if state.blocked_batch.is_some() || next_timer.is_none_or(|time| time < state.asleep_until) {
            self.wake.notify_one();
        }
        result
    }

    /// Says goodbye to all peers and waits at most `linger`.
    pub(super) async fn close(&self, linger: Duration) {
        self.with_machine(|machine, now| machine.close(now));
        self.wake.notify_one();
        if timeout(linger, self.ended.cancelled()).await.is_err() {
            self.abort.cancel();
            self.ended.cancelled().await;
        }
    }

    /// Sends until nothing may be sent or the socket accepts no more.
    fn flush(&self, state: &mut State<M>) {
        let State { machine, out, blocked_batch, .. } = state;
        loop {
            let (route, batch) = match blocked_batch.take() {
                Some(batch) => batch,
                None => {
                    out.clear();
                    let now = self.time(Instant::now());
                    let Some(filled) = machine.fill(out, self.socket.max_segments(), now) else { return };
                    filled
                }
            };
            let mut result = self.socket.try_send(route, out, batch);
            // If the source address does not belong to this host any more, the system chooses another source
            // address.
            if let Err(error) = &result
                && route.from.is_some()
                && !matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::ConnectionRefused)
            {
                result = self.socket.try_send(Route { from: None, ..route }, out, batch);
            }
            match result {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    *blocked_batch = Some((route, batch));
                    return;
                }
                Err(error) => {
                    if error.kind() == io::ErrorKind::ConnectionRefused {
                        machine.handle_port_unreachable();
                    }
                    // The error is only logged: datagrams may be lost anyway, and if a path never carries datagrams,
                    // silence ends the connection.
                    tracing::debug!(%error, to = %route.to, "cannot send datagrams");
                }
            }
        }
    }

    /// Serves the socket until the machine is finished or the task is aborted.
    async fn run(self: Arc<Self>, deliveries: mpsc::Sender<M::Delivery>) {
        let mut buffers = ReceiveBuffers::new();
        let mut queued_deliveries = VecDeque::new();
        loop {
            let (next_wake_up, is_blocked, is_finished) = {
                let mut state = self.lock();
                let now = self.time(Instant::now());
                state.machine.tick(now);
                self.flush(&mut state);
                while let Some(delivery) = state.machine.next_delivery() {
                    queued_deliveries.push_back(delivery);
                }
                let now = self.time(Instant::now());
                // The sleep is at least as long as the resolution of the runtime's timers, and at most an hour.
                let next_timer = state
                    .machine
                    .next_timer(now)
                    .unwrap_or(now + MAX_SLEEP)
                    .clamp(now + MIN_SLEEP, now + MAX_SLEEP);
                state.asleep_until = next_timer;
                (
                    self.start + (next_timer - MonoTime::default()).to_duration(),
                    state.blocked_batch.is_some(),
                    state.machine.is_finished(),
                )
            };
            while !queued_deliveries.is_empty()
                && let Ok(permit) = deliveries.try_reserve()
                && let Some(delivery) = queued_deliveries.pop_front()
            {
                permit.send(delivery);
            }
            if is_finished && queued_deliveries.is_empty() {
                break;
            }
            tokio::select! {
                () = self.abort.cancelled() => break,
                // While deliveries are queued, datagrams stay in the kernel, which drops them when its buffer is full.
                result = self.socket.readable(), if queued_deliveries.is_empty() && !is_finished => {
                    if let Err(error) = result {
                        tracing::debug!(%error, "a UDP socket reported an error");
                        if error.kind() == io::ErrorKind::ConnectionRefused {
                            self.lock().machine.handle_port_unreachable();
                        }
                    }
                    self.receive_datagrams(&mut buffers);
                }
                _ = self.socket.writable(), if is_blocked => {}
                permit = deliveries.reserve(), if !queued_deliveries.is_empty() => match permit {
                    Ok(permit) => if let Some(delivery) = queued_deliveries.pop_front() {
                        permit.send(delivery);
                    },
                    // Nothing receives the deliveries any more.
                    Err(_) => queued_deliveries.clear(),
                },
                () = self.wake.notified() => {}
                () = sleep_until(next_wake_up) => {}
            }
        }
        let mut state = self.lock();
        state.machine.abandon();
        // The blocked batch would be sent before the goodbye, or would prevent the goodbye if the socket still accepts
        // nothing.
        state.blocked_batch = None;
        self.flush(&mut state);
        drop(state);
        self.ended.cancel();
    }

    /// Receives the datagrams that have arrived.
    fn receive_datagrams(&self, buffers: &mut ReceiveBuffers) {
        let mut state = self.lock();
        for _ in 0..READS_PER_ITERATION {
            let now = self.time(Instant::now());
            let machine = &mut state.machine;
            let received = self.socket.try_receive(buffers, |source, local, datagram| {
                // A datagram of another group or of another program is handled as an empty body, which is an invalid
                // packet.
                let body = radio::body(datagram).unwrap_or_default();
                machine.receive(source, local, body, now);
            });
            match received {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                    machine.handle_port_unreachable();
                }
                Err(error) => tracing::debug!(%error, "a UDP socket reported an error"),
            }
        }
    }
}

/// Returns the time of a machine whose time started at `start`.
pub(super) fn time_since(start: Instant, at: Instant) -> MonoTime {
    MonoTime::default() + Span::from(at.saturating_duration_since(start))
}
