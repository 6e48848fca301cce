//! How far the connection to the aggregator has come, and when to greet it.

use peernet_clock::{MonoTime, Span};
use peernet_logger::Slug;

use super::SendingConfig;
use super::spool_reader::SpoolScan;
use crate::{AGENT_STREAM_VERSIONS, Chain};

/// Greetings without any progress that follow one another at once; later ones wait, each longer than the one before.
const PROMPT_GREETINGS: u32 = 3;

/// How far the connection has come.
#[derive(Clone, Debug)]
pub(super) enum Link {
    /// There is none.
    Down,
    /// A hello is due at `again`; `pause` passes before the one after.
    Greeting { again: MonoTime, pause: Span },
    /// Welcomed; the file is read to compare what both ends know.
    Comparing { scan: SpoolScan, purpose: ScanPurpose },
    /// Taken in; batch `next` is the next to go. `heard` is when there last was progress.
    Up { next: u64, heard: MonoTime },
}

/// What the file is read for.
#[derive(Clone, Debug)]
pub(super) enum ScanPurpose {
    /// For the chain of the batch that the aggregator has.
    Compare(Welcome),
    /// For what is taken as stored before the stream is left.
    Leave,
}

/// What the aggregator says it has.
#[derive(Clone, Debug)]
pub(super) struct Welcome {
    pub(super) aggregator: Slug,
    pub(super) stored: u64,
    pub(super) chain: Option<Chain>,
    /// Who sent that batch.
    pub(super) process: Option<u64>,
}

/// The state of the connection, and the greetings on it.
#[derive(Clone, Debug)]
pub(super) struct Session {
    config: SendingConfig,
    pub(super) link: Link,
    /// Greetings since there last was progress.
    greetings: u32,
    /// Greetings on this connection since the last answer.
    unanswered: u32,
    /// When the last of them went.
    greeted: MonoTime,
    /// The proof that the aggregator asked for, to be sent at once.
    proof: Option<Vec<u8>>,
    /// Version of the event stream that the aggregator chose; the oldest until it has.
    version: u16,
}

impl Session {
    /// There is no connection.
    pub(super) fn new(config: SendingConfig) -> Self {
        let (link, greeted) = (Link::Down, MonoTime::default());
        let version = AGENT_STREAM_VERSIONS.oldest();
        Self { config, link, greetings: 0, unanswered: 0, greeted, proof: None, version }
    }

    /// Whether the aggregator knows us.
    pub(super) const fn is_up(&self) -> bool {
        matches!(self.link, Link::Up { .. })
    }

    /// Whether the file is read to compare what both ends know.
    pub(super) const fn is_comparing(&self) -> bool {
        matches!(self.link, Link::Comparing { .. })
    }

    /// There is a connection: it is greeted at once.
    pub(super) fn connect(&mut self, now: MonoTime) {
        (self.greetings, self.unanswered) = (0, 0);
        self.greet_again(now);
    }

    /// There is none.
    pub(super) fn disconnect(&mut self) {
        (self.link, self.proof, self.version) = (Link::Down, None, AGENT_STREAM_VERSIONS.oldest());
    }

    /// Says hello: at once, unless that led to nothing several times.
    pub(super) fn greet_again(&mut self, now: MonoTime) {
        let first = self.config.first_pause;
        if let Link::Up { heard, .. } = self.link
            && now - heard > self.config.longest_pause
        {
            // It held for long.
            self.greetings = 0;
        }
        let idle = self.greetings.saturating_sub(PROMPT_GREETINGS);
        let wait = (0..idle.min(16)).fold(Span::ZERO, |wait, _| self.longer(wait.max(first)));
        self.greetings = self.greetings.saturating_add(1);
        self.proof = None;
        self.link = Link::Greeting { again: now + wait, pause: first.max(wait) };
    }

    fn longer(&self, pause: Span) -> Span {
        (pause + pause).min(self.config.longest_pause.max(self.config.refused_pause))
    }

    /// Whether a hello is due; it then counts as sent.
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

    /// When a hello is due; `None` when the aggregator is not to be greeted.
    pub(super) const fn hello_at(&self) -> Option<MonoTime> {
        match self.link {
            Link::Greeting { again, .. } => Some(again),
            _ => None,
        }
    }

    /// The aggregator answered a greeting: how long that took, where it is known which of several it answered.
    pub(super) fn answered(&mut self, now: MonoTime) -> Option<Span> {
        (std::mem::take(&mut self.unanswered) == 1).then(|| now - self.greeted)
    }

    /// Version of the event stream that is spoken on the connection.
    pub(super) const fn version(&self) -> u16 {
        self.version
    }

    /// The aggregator chose a version.
    pub(super) const fn choose(&mut self, version: u16) {
        self.version = version;
    }

    /// The aggregator asks for a proof: what that leads to takes another round trip. Whether it was greeted.
    pub(super) fn challenged(&mut self, now: MonoTime) -> bool {
        let Link::Greeting { pause, .. } = self.link else { return false };
        self.link = Link::Greeting { again: now + pause, pause };
        true
    }

    /// A proof is to be sent at once.
    pub(super) fn prove(&mut self, proof: Vec<u8>) {
        self.proof = Some(proof);
    }

    /// The proof to be sent now.
    pub(super) const fn take_proof(&mut self) -> Option<Vec<u8>> {
        self.proof.take()
    }

    /// The aggregator does not take us in: it is greeted again later.
    pub(super) fn refused(&mut self, now: MonoTime) {
        let pause = match self.link {
            Link::Greeting { pause, .. } => pause.max(self.config.refused_pause),
            _ => self.config.refused_pause,
        };
        self.link = Link::Greeting { again: now + pause, pause: self.longer(pause) };
    }

    /// A batch was acknowledged; `next` is the next to go.
    pub(super) fn progressed(&mut self, next: u64, now: MonoTime) {
        self.greetings = 0;
        self.link = Link::Up { next, heard: now };
    }

    /// When nothing was acknowledged for too long. `oldest` is the oldest batch that is held, and `arrived` when bytes of the
    /// durable lane last arrived.
    pub(super) fn patience_ends(&self, oldest: u64, arrived: MonoTime) -> Option<MonoTime> {
        match self.link {
            // What is on a slow link is not lost while it arrives bit by bit.
            Link::Up { next, heard } if next > oldest => Some(heard.max(arrived) + self.config.patience),
            _ => None,
        }
    }
}
