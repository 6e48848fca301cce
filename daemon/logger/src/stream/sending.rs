//! The agent's end of the durable lane.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};

use super::codec::{self, BatchHead};
use super::intake::Intake;
use super::spool::{Spool, SpoolError};
use super::{Accounting, Event, Hello, HostDescription, PROTOCOL, StreamId, ToAgent, ToAggregator};
use crate::{HostId, Slug};

/// How events are batched and sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SendingConfig {
    /// A batch is cut when it holds so many nodes.
    pub batch_nodes: usize,
    /// A batch is cut before it takes more bytes than this (a single larger event is a batch of its own).
    pub batch_bytes: usize,
    /// A batch is cut when its first event is this old.
    pub batch_age: Span,
    /// Batches under way that are not acknowledged yet, at most.
    pub window: u64,
    /// Places of the spool that iterations leave to the other events: an iteration is worth nothing without the
    /// start of its run. Must be well below what the spool takes, or no iteration ever fits.
    pub reserve_events: u64,
    /// The first pause before a hello is repeated; each is twice the one before.
    pub first_pause: Span,
    /// The longest such pause.
    pub longest_pause: Span,
    /// The first pause after a refusal; the others follow the same rule.
    pub refused_pause: Span,
    /// Without an acknowledgement for so long, the connection is opened anew.
    pub patience: Span,
}

impl Default for SendingConfig {
    fn default() -> Self {
        Self {
            batch_nodes: 8192,
            batch_bytes: 512 * 1024,
            batch_age: Span::from_millis(200),
            window: 8,
            reserve_events: 1024,
            first_pause: Span::from_millis(250),
            longest_pause: Span::from_seconds(10),
            refused_pause: Span::from_seconds(1),
            patience: Span::from_seconds(10),
        }
    }
}

/// What the agent should know of, and log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// The aggregator took us in; batches flow.
    Welcomed {
        /// Name of its host.
        aggregator: Slug,
        /// Number of the last batch it has.
        stored: u64,
    },
    /// It did not; tried again later.
    Refused(String),
    /// It has batches of this stream that were never made here: the spool is a copy, or older than it was. What it
    /// holds goes on in a new stream.
    StreamRenewed {
        /// Number of the last batch the aggregator has.
        stored: u64,
        /// Number of the last batch made here.
        newest: u64,
    },
}

/// The agent's end of the durable lane, without I/O: told of events, messages and time, it says what to send.
///
/// Whoever owns it calls [`transmit`](Self::transmit) after every other call until it returns nothing, and
/// [`tick`](Self::tick) when [`deadline`](Self::deadline) has come. It recovers by itself from whatever the transport
/// loses, repeats or reorders; being told of connections only makes that faster.
#[derive(Debug)]
pub struct Sending<S> {
    config: SendingConfig,
    host: HostDescription,
    process: u64,
    intake: Intake<S>,
    link: Link,
    stored: u64,
}

#[derive(Clone, Copy, Debug)]
enum Link {
    /// There is no connection.
    Down,
    /// A hello is due at `again`; `pause` passes before the one after.
    Greeting { again: MonoTime, pause: Span },
    /// Welcomed; batch `next` is the next to go. `heard` is when there last was progress.
    Up { next: u64, heard: MonoTime },
}

impl<S: Spool> Sending<S> {
    /// The sending end of a host; `process` is a random number made at process start. Nothing is sent before
    /// [`connected`](Self::connected).
    ///
    /// Events that the spool already holds count as offered.
    pub fn new(config: SendingConfig, host: HostDescription, process: u64, spool: S) -> Self {
        Self { config, host, process, intake: Intake::new(config, spool), link: Link::Down, stored: 0 }
    }

    /// Takes in an event, or drops and counts it. Never waits, never fails: when the spool is full the newest
    /// events are dropped, and a gap stands in their place as soon as there is room.
    pub fn offer(&mut self, event: &Event, now: Stamp) {
        self.intake.offer(event, now);
    }

    /// The transport has a connection.
    pub fn connected(&mut self, now: MonoTime) {
        self.greet(now);
    }

    /// The transport has none. Batches under way count as not sent.
    pub fn disconnected(&mut self) {
        self.link = Link::Down;
    }

    /// A message came.
    ///
    /// # Errors
    /// When the spool fails; the message then had no effect and may be handed in again.
    pub fn received(&mut self, message: &ToAgent, now: Stamp) -> Result<Option<Notice>, SpoolError> {
        match message {
            _ if matches!(self.link, Link::Down) => Ok(None),
            ToAgent::Welcome { aggregator, stream, stored } if *stream == self.intake.spool.stream() => {
                let notice = self.acknowledged(*stored, now)?;
                if notice.is_none() && matches!(self.link, Link::Greeting { .. }) {
                    self.link = Link::Up { next: self.intake.spool.oldest(), heard: now.mono };
                    return Ok(Some(Notice::Welcomed { aggregator: aggregator.clone(), stored: *stored }));
                }
                Ok(notice)
            }
            ToAgent::Ack { stream, through } if *stream == self.intake.spool.stream() => {
                self.acknowledged(*through, now)
            }
            ToAgent::Resend { stream, from } if *stream == self.intake.spool.stream() => {
                self.asked_again(*from, now.mono);
                Ok(None)
            }
            // Answers to what was sent in a stream that has been left since.
            ToAgent::Welcome { .. } | ToAgent::Ack { .. } | ToAgent::Resend { .. } => Ok(None),
            ToAgent::Refused { reason } => {
                let pause = match self.link {
                    Link::Greeting { pause, .. } => pause.max(self.config.refused_pause),
                    _ => self.config.refused_pause,
                };
                self.link = Link::Greeting { again: now.mono + pause, pause: self.longer(pause) };
                Ok(Some(Notice::Refused(reason.clone())))
            }
            ToAgent::Unknown => {
                if matches!(self.link, Link::Up { .. }) {
                    self.greet(now.mono);
                }
                Ok(None)
            }
        }
    }

    /// Time has passed: cuts a batch that is old enough, reports losses, opens the connection anew when no
    /// acknowledgement came for too long.
    pub fn tick(&mut self, now: Stamp) {
        self.intake.tick(now);
        if let Some(limit) = self.patience_ends()
            && now.mono >= limit
        {
            self.greet(now.mono);
        }
    }

    /// When [`tick`](Self::tick) or [`transmit`](Self::transmit) has something to do without anything else
    /// happening.
    pub fn deadline(&self) -> Option<MonoTime> {
        let greeting = match self.link {
            Link::Greeting { again, .. } => Some(again),
            _ => None,
        };
        [self.intake.deadline(), self.patience_ends(), greeting].into_iter().flatten().min()
    }

    /// The next frame to send now, if there is one.
    ///
    /// # Errors
    /// When the spool cannot read the batch that is due.
    pub fn transmit(&mut self, now: MonoTime) -> Result<Option<Vec<u8>>, SpoolError> {
        match self.link {
            Link::Greeting { again, pause } if now >= again => {
                self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
                Ok(Some(codec::encode(&ToAggregator::Hello(self.hello()))))
            }
            Link::Up { next, heard } => {
                let spool = &self.intake.spool;
                let idle = next == spool.oldest();
                if next >= spool.oldest() + self.config.window {
                    return Ok(None);
                }
                let Some(batch) = spool.get(next)? else { return Ok(None) };
                // Patience begins when there is something to wait for.
                self.link = Link::Up { next: next + 1, heard: if idle { now } else { heard } };
                let head = BatchHead { host: self.host.id, stream: spool.stream(), number: next };
                Ok(Some(codec::batch_frame(head, batch.events, &batch.body)))
            }
            _ => Ok(None),
        }
    }

    /// Reports losses and cuts the batch under construction now: before a stop.
    pub fn flush(&mut self, now: WallTime) {
        self.intake.flush(now);
    }

    /// Gives up everything that waits, for want of time, and returns how many events that were; they count as
    /// dropped. The hello that follows tells the aggregator from where on the stream goes on, and it records the
    /// gap.
    ///
    /// # Errors
    /// When the spool cannot delete it.
    pub fn give_up(&mut self, now: Stamp) -> Result<u64, SpoolError> {
        self.intake.cut(now);
        let newest = self.intake.spool.newest();
        let events = self.intake.spool.delete_through(newest)?;
        self.intake.dropped += events;
        if !matches!(self.link, Link::Down) {
            self.greet(now.mono);
        }
        Ok(events)
    }

    /// The frame that says goodbye; `None` when nobody knows us, so that a refused copy cannot say it in our name.
    pub fn goodbye(&mut self) -> Option<Vec<u8>> {
        let known = matches!(self.link, Link::Up { .. });
        self.link = Link::Down;
        known.then(|| codec::encode(&ToAggregator::Goodbye(self.host.id)))
    }

    /// Whether the aggregator knows us, and live updates make sense.
    pub const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// Whether everything that was taken in is stored.
    pub fn is_idle(&self) -> bool {
        self.accounting().waiting == 0
    }

    /// What became of the events. `offered = stored + waiting + dropped` at any time; gaps that are reported
    /// count as events of their own.
    pub fn accounting(&self) -> Accounting {
        let waiting = self.intake.waiting();
        Accounting {
            offered: self.intake.offered,
            stored: self.stored,
            waiting: waiting.events,
            dropped: self.intake.dropped,
            waiting_bytes: waiting.bytes,
        }
    }

    /// Whose events these are.
    pub const fn host(&self) -> HostId {
        self.host.id
    }

    /// The host, to be described anew when the connection is next opened.
    pub const fn describe(&mut self) -> &mut HostDescription {
        &mut self.host
    }

    /// The spool.
    pub const fn spool(&self) -> &S {
        &self.intake.spool
    }

    /// Ends the machine and returns its spool. What was not [cut](Self::flush) is lost.
    pub fn into_spool(self) -> S {
        self.intake.spool
    }

    fn hello(&self) -> Hello {
        let spool = &self.intake.spool;
        Hello {
            protocol: PROTOCOL,
            host: self.host.clone(),
            stream: spool.stream(),
            oldest: spool.oldest(),
            process: self.process,
        }
    }

    fn greet(&mut self, now: MonoTime) {
        self.link = Link::Greeting { again: now, pause: self.config.first_pause };
    }

    fn longer(&self, pause: Span) -> Span {
        (pause + pause).min(self.config.longest_pause.max(self.config.refused_pause))
    }

    fn patience_ends(&self) -> Option<MonoTime> {
        match self.link {
            Link::Up { next, heard } if next > self.intake.spool.oldest() => {
                Some(heard + self.config.patience)
            }
            _ => None,
        }
    }

    /// All up to and including `through` is stored over there.
    fn acknowledged(&mut self, through: u64, now: Stamp) -> Result<Option<Notice>, SpoolError> {
        let spool = &mut self.intake.spool;
        let newest = spool.newest();
        if through > newest {
            spool.renew(StreamId::random())?;
            self.greet(now.mono);
            return Ok(Some(Notice::StreamRenewed { stored: through, newest }));
        }
        if through >= spool.oldest() {
            self.stored += spool.delete_through(through)?;
            if let Link::Up { next, .. } = self.link {
                self.link = Link::Up { next: next.max(through + 1), heard: now.mono };
            }
            self.intake.report_losses(now);
        }
        Ok(None)
    }

    fn asked_again(&mut self, from: u64, now: MonoTime) {
        let Link::Up { next, heard } = self.link else { return };
        if from < self.intake.spool.oldest() {
            // It lacks what is no longer here: the hello tells it so, and it records the gap.
            self.greet(now);
        } else {
            self.link = Link::Up { next: next.min(from), heard };
        }
    }
}
