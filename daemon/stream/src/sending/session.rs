//! State of the connection to the aggregator, and the times of hellos.

use peernet_clock::{MonoTime, Span};
use peernet_logger::Slug;

use super::SendingConfig;
use super::spool_reader::SpoolScan;
use crate::{AGENT_STREAM_VERSIONS, ChainHash};

/// Maximum number of hellos without progress after which the next hello is sent without a pause. Each later hello waits
/// longer than the previous hello.
const HELLOS_WITHOUT_PAUSE: u32 = 3;

/// State of the connection.
#[derive(Clone, Debug)]
pub(super) enum ConnectionState {
    /// No connection.
    Down,
    /// The aggregator has not accepted this host yet. The next hello is due at `retry_at`, and the hello after that
    /// `pause` later.
    Handshake { retry_at: MonoTime, pause: Span },
    /// The aggregator has welcomed this host. The spool's file is being scanned before sending continues.
    Scanning { scan: SpoolScan, purpose: ScanPurpose },
    /// The aggregator has accepted this host. Batch `next` is sent next. `last_progress` is the time of the acceptance,
    /// of the last acknowledgement, or of the sending of the first batch in flight.
    Up { next: u64, last_progress: MonoTime },
}

/// Purpose of scanning the spool's file.
#[derive(Clone, Debug)]
pub(super) enum ScanPurpose {
    /// To find the chain hash of the aggregator's last batch.
    Compare(Welcome),
    /// To count the stored batches before the stream is left.
    Leave,
}

/// State of the stream at the aggregator.
#[derive(Clone, Debug)]
pub(super) struct Welcome {
    pub(super) aggregator: Slug,
    /// Number of the last stored batch.
    pub(super) last_stored: u64,
    /// Chain hash of the last stored batch, if the aggregator knows it.
    pub(super) chain: Option<ChainHash>,
    /// Process that sent the last stored batch.
    pub(super) process: Option<u64>,
}

/// State of the connection, and the hellos on it.
#[derive(Clone, Debug)]
pub(super) struct Session {
    config: SendingConfig,
    pub(super) state: ConnectionState,
    /// Number of scheduled hellos since the last progress. A hello that is repeated for lack of an answer counts once.
    hellos_without_progress: u32,
    /// Number of hellos on this connection since the last answer.
    unanswered_hellos: u32,
    /// Time of the last hello.
    last_hello_at: MonoTime,
    /// Proof that a challenge requested, to be sent at once.
    proof: Option<Vec<u8>>,
    /// Version of the event stream that the aggregator chose; before it has chosen, the oldest supported version.
    version: u16,
}

impl Session {
    /// Creates a session without a connection.
    pub(super) fn new(config: SendingConfig) -> Self {
        let (state, last_hello_at) = (ConnectionState::Down, MonoTime::default());
        let version = AGENT_STREAM_VERSIONS.oldest();
        Self {
            config,
            state,
            hellos_without_progress: 0,
            unanswered_hellos: 0,
            last_hello_at,
            proof: None,
            version,
        }
    }

    /// Returns whether the aggregator has accepted this host.
    pub(super) const fn is_up(&self) -> bool {
        matches!(self.state, ConnectionState::Up { .. })
    }

    /// Returns whether the spool's file is being scanned.
    pub(super) const fn is_scanning(&self) -> bool {
        matches!(self.state, ConnectionState::Scanning { .. })
    }

    /// Starts a connection; a hello is due at once.
    pub(super) fn connect(&mut self, now: MonoTime) {
        (self.hellos_without_progress, self.unanswered_hellos) = (0, 0);
        self.schedule_hello(now);
    }

    /// Ends the connection.
    pub(super) fn disconnect(&mut self) {
        (self.state, self.proof, self.version) =
            (ConnectionState::Down, None, AGENT_STREAM_VERSIONS.oldest());
    }

    /// Schedules a hello: now, or after a pause if the last hellos led to no progress.
    pub(super) fn schedule_hello(&mut self, now: MonoTime) {
        let first_pause = self.config.first_pause;
        if let ConnectionState::Up { last_progress, .. } = self.state
            && now - last_progress > self.config.longest_pause
        {
            // The aggregator accepted this host long ago, so earlier hellos no longer matter.
            self.hellos_without_progress = 0;
        }
        // Hellos without effect become rarer, so that agents which are refused do not load the aggregator.
        let repeated = self.hellos_without_progress.saturating_sub(HELLOS_WITHOUT_PAUSE);
        let pause =
            // 16 doublings reach any longest pause.
            (0..repeated.min(16)).fold(Span::ZERO, |pause, _| self.next_pause(pause.max(first_pause)));
        self.hellos_without_progress = self.hellos_without_progress.saturating_add(1);
        self.proof = None;
        self.state = ConnectionState::Handshake { retry_at: now + pause, pause: first_pause.max(pause) };
    }

    fn next_pause(&self, pause: Span) -> Span {
        (pause + pause).min(self.config.longest_pause.max(self.config.refused_pause))
    }

    /// Returns whether a hello is due, and records it as sent.
    pub(super) fn take_hello(&mut self, now: MonoTime) -> bool {
        match self.state {
            ConnectionState::Handshake { retry_at, pause } if now >= retry_at => {
                self.state =
                    ConnectionState::Handshake { retry_at: now + pause, pause: self.next_pause(pause) };
                (self.unanswered_hellos, self.last_hello_at) =
                    (self.unanswered_hellos.saturating_add(1), now);
                true
            }
            _ => false,
        }
    }

    /// Returns the time at which a hello is due; `None` if no hello is due.
    pub(super) const fn hello_at(&self) -> Option<MonoTime> {
        match self.state {
            ConnectionState::Handshake { retry_at, .. } => Some(retry_at),
            _ => None,
        }
    }

    /// Records an answer. Returns the round trip of the answer, if only one hello can have caused the answer.
    pub(super) fn record_answer(&mut self, now: MonoTime) -> Option<Span> {
        // After several hellos it is unknown which of them was answered.
        (std::mem::take(&mut self.unanswered_hellos) == 1).then(|| now - self.last_hello_at)
    }

    /// Returns the version of the event stream on the connection.
    pub(super) const fn version(&self) -> u16 {
        self.version
    }

    /// Sets the version that the aggregator chose.
    pub(super) const fn set_version(&mut self, version: u16) {
        self.version = version;
    }

    /// Records a challenge, whose proof takes another round trip. Returns whether the challenge is expected; a
    /// challenge is expected after a hello only.
    pub(super) fn record_challenge(&mut self, now: MonoTime) -> bool {
        let ConnectionState::Handshake { pause, .. } = self.state else { return false };
        self.state = ConnectionState::Handshake { retry_at: now + pause, pause };
        true
    }

    /// Sets a proof to be sent at once.
    pub(super) fn queue_proof(&mut self, proof: Vec<u8>) {
        self.proof = Some(proof);
    }

    /// Returns the proof to be sent now.
    pub(super) const fn take_proof(&mut self) -> Option<Vec<u8>> {
        self.proof.take()
    }

    /// Records that the aggregator refused this host. Another hello is sent later.
    pub(super) fn record_refusal(&mut self, now: MonoTime) {
        let pause = match self.state {
            // A refusal is a decision and not a loss, so the next hello may wait for longer.
            ConnectionState::Handshake { pause, .. } => pause.max(self.config.refused_pause),
            _ => self.config.refused_pause,
        };
        self.state = ConnectionState::Handshake { retry_at: now + pause, pause: self.next_pause(pause) };
    }

    /// Records an acknowledgement; `next` is the batch to be sent next.
    pub(super) fn record_progress(&mut self, next: u64, now: MonoTime) {
        self.hellos_without_progress = 0;
        self.state = ConnectionState::Up { next, last_progress: now };
    }

    /// Returns the time by which an acknowledgement must arrive; `None` if no batch is in flight. `oldest` is the
    /// number of the oldest batch without an acknowledgement. `last_arrival_at` is the time at which bytes of the
    /// durable lane last arrived.
    pub(super) fn ack_deadline(&self, oldest: u64, last_arrival_at: MonoTime) -> Option<MonoTime> {
        match self.state {
            // Batches on a slow link are not lost while their bytes arrive.
            ConnectionState::Up { next, last_progress } if next > oldest => {
                Some(last_progress.max(last_arrival_at) + self.config.ack_timeout)
            }
            _ => None,
        }
    }
}
