//! State of the connection to the aggregator, and the times of hellos.

use peernet_clock::{MonoTime, Span};
use peernet_logger::Slug;

use super::SendingConfig;
use super::spool_reader::SpoolScan;
use crate::{AGENT_STREAM_VERSIONS, Chain};

/// Number of hellos without progress that are sent without a pause. Later ones wait, each longer than the one before.
const PROMPT_GREETINGS: u32 = 3;

/// State of the connection.
#[derive(Clone, Debug)]
pub(super) enum Link {
    /// No connection.
    Down,
    /// A hello is due at `again`; the next one follows after `pause`.
    Greeting { again: MonoTime, pause: Span },
    /// Welcomed; the file is being read to compare both ends' batches.
    Comparing { scan: SpoolScan, purpose: ScanPurpose },
    /// Accepted; batch `next` is sent next. `heard` is the time of the last progress.
    Up { next: u64, heard: MonoTime },
}

/// Purpose of reading the file.
#[derive(Clone, Debug)]
pub(super) enum ScanPurpose {
    /// To find the chain of the batch that the aggregator has.
    Compare(Welcome),
    /// To count the batches that are considered stored before the stream is left.
    Leave,
}

/// State of the stream at the aggregator.
#[derive(Clone, Debug)]
pub(super) struct Welcome {
    pub(super) aggregator: Slug,
    pub(super) stored: u64,
    pub(super) chain: Option<Chain>,
    /// Process that sent the last stored batch.
    pub(super) process: Option<u64>,
}

/// State of the connection, and the hellos on it.
#[derive(Clone, Debug)]
pub(super) struct Session {
    config: SendingConfig,
    pub(super) link: Link,
    /// Number of hellos since the last progress.
    greetings: u32,
    /// Number of hellos on this connection since the last answer.
    unanswered: u32,
    /// Time of the last of them.
    greeted: MonoTime,
    /// Requested proof, to be sent at once.
    proof: Option<Vec<u8>>,
    /// Version of the event stream that the aggregator chose; the oldest one before that.
    version: u16,
}

impl Session {
    /// Creates a session without a connection.
    pub(super) fn new(config: SendingConfig) -> Self {
        let (link, greeted) = (Link::Down, MonoTime::default());
        let version = AGENT_STREAM_VERSIONS.oldest();
        Self { config, link, greetings: 0, unanswered: 0, greeted, proof: None, version }
    }

    /// Returns whether the aggregator has accepted this host.
    pub(super) const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// Returns whether the file is being read to compare both ends' batches.
    pub(super) const fn is_comparing(&self) -> bool {
        matches!(self.link, Link::Comparing { .. })
    }

    /// Starts a connection; a hello is due at once.
    pub(super) fn connect(&mut self, now: MonoTime) {
        (self.greetings, self.unanswered) = (0, 0);
        self.schedule_hello(now);
    }

    /// Ends the connection.
    pub(super) fn disconnect(&mut self) {
        (self.link, self.proof, self.version) = (Link::Down, None, AGENT_STREAM_VERSIONS.oldest());
    }

    /// Schedules a hello: at once, unless several had no effect.
    pub(super) fn schedule_hello(&mut self, now: MonoTime) {
        let first = self.config.first_pause;
        if let Link::Up { heard, .. } = self.link
            && now - heard > self.config.longest_pause
        {
            // The connection worked for long enough.
            self.greetings = 0;
        }
        // Hellos without effect become rarer, so that agents which are refused do not load the aggregator.
        let idle = self.greetings.saturating_sub(PROMPT_GREETINGS);
        let wait = (0..idle.min(16)).fold(Span::ZERO, |wait, _| self.longer(wait.max(first)));
        self.greetings = self.greetings.saturating_add(1);
        self.proof = None;
        self.link = Link::Greeting { again: now + wait, pause: first.max(wait) };
    }

    fn longer(&self, pause: Span) -> Span {
        (pause + pause).min(self.config.longest_pause.max(self.config.refused_pause))
    }

    /// Returns whether a hello is due, and records it as sent.
    pub(super) fn take_hello(&mut self, now: MonoTime) -> bool {
        match self.link {
            Link::Greeting { again, pause } if now >= again => {
                self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
                (self.unanswered, self.greeted) = (self.unanswered.saturating_add(1), now);
                true
            }
            _ => false,
        }
    }

    /// Returns the time at which a hello is due; `None` if none is.
    pub(super) const fn hello_at(&self) -> Option<MonoTime> {
        match self.link {
            Link::Greeting { again, .. } => Some(again),
            _ => None,
        }
    }

    /// Records an answer. Returns its round trip, if only one hello can have caused it.
    pub(super) fn answered(&mut self, now: MonoTime) -> Option<Span> {
        // After several hellos it is unknown which of them was answered.
        (std::mem::take(&mut self.unanswered) == 1).then(|| now - self.greeted)
    }

    /// Returns the version of the event stream on the connection.
    pub(super) const fn version(&self) -> u16 {
        self.version
    }

    /// Sets the version that the aggregator chose.
    pub(super) const fn choose(&mut self, version: u16) {
        self.version = version;
    }

    /// Records a challenge: its proof takes another round trip. Returns whether a hello was sent.
    pub(super) fn challenged(&mut self, now: MonoTime) -> bool {
        let Link::Greeting { pause, .. } = self.link else { return false };
        self.link = Link::Greeting { again: now + pause, pause };
        true
    }

    /// Sets a proof to be sent at once.
    pub(super) fn prove(&mut self, proof: Vec<u8>) {
        self.proof = Some(proof);
    }

    /// Returns the proof to be sent now.
    pub(super) const fn take_proof(&mut self) -> Option<Vec<u8>> {
        self.proof.take()
    }

    /// Records that the aggregator refused this host, which sends another hello later.
    pub(super) fn refused(&mut self, now: MonoTime) {
        let pause = match self.link {
            Link::Greeting { pause, .. } => pause.max(self.config.refused_pause),
            _ => self.config.refused_pause,
        };
        self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
    }

    /// Records an acknowledgement; `next` is the batch to be sent next.
    pub(super) fn progressed(&mut self, next: u64, now: MonoTime) {
        self.greetings = 0;
        self.link = Link::Up { next, heard: now };
    }

    /// Returns the time at which the timeout without an acknowledgement ends. `oldest` is the oldest batch that is
    /// held, and `arrived` the time at which bytes of the durable lane last arrived.
    pub(super) fn patience_ends(&self, oldest: u64, arrived: MonoTime) -> Option<MonoTime> {
        match self.link {
            // Batches on a slow link are not lost while their bytes arrive.
            Link::Up { next, heard } if next > oldest => Some(heard.max(arrived) + self.config.patience),
            _ => None,
        }
    }
}
