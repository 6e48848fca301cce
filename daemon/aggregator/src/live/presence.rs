//! Whether a host is there, and when it was heard.

use peernet_clock::{MonoTime, Span, Stamp, WallTime};

/// A host that sent nothing for so long counts as disconnected; it sends four times a second.
const CONNECTED_WITHIN: Span = Span::from_seconds(3);

/// Whether a host is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// It said hello and tells of itself.
    Connected,
    /// It does not, and nobody knows why.
    Silent,
    /// It took its leave.
    Left,
}

/// The process of a host that was last heard, and when.
#[derive(Clone, Copy, Debug)]
pub(super) struct Presence {
    state: State,
    /// The number that the host's process made at its start.
    process: u64,
    seen: Stamp,
    /// The last update: the host's clock when it was sent, and the process that sent it.
    update: Option<(WallTime, u64)>,
}

impl Presence {
    /// A process that just introduced itself.
    pub(super) const fn new(process: u64, now: Stamp) -> Self {
        Self { state: State::Connected, process, seen: now, update: None }
    }

    pub(super) fn is_connected(&self) -> bool {
        self.state == State::Connected
    }

    pub(super) fn has_left(&self) -> bool {
        self.state == State::Left
    }

    /// When the host was last heard.
    pub(super) const fn seen(&self) -> Stamp {
        self.seen
    }

    /// The host's clock at its last update.
    pub(super) fn sent(&self) -> Option<WallTime> {
        self.update.map(|(sent, _)| sent)
    }

    /// The host's clock at the last update of the process that is there now.
    pub(super) fn sent_by_current(&self) -> Option<WallTime> {
        self.update.filter(|(_, process)| *process == self.process).map(|(sent, _)| sent)
    }

    /// Difference of the host's clock to ours at its last update.
    pub(super) fn clock_ahead(&self) -> Span {
        self.sent().map_or(Span::ZERO, |sent| sent - self.seen.wall)
    }

    /// A process introduced itself; whether it is the one that was there.
    pub(super) fn introduce(&mut self, process: u64, now: Stamp) -> bool {
        self.seen = now;
        let same = std::mem::replace(&mut self.process, process) == process;
        if same {
            self.state = State::Connected;
        }
        same
    }

    /// The host sent an update.
    pub(super) const fn update(&mut self, sent: WallTime, now: Stamp) {
        (self.state, self.seen) = (State::Connected, now);
        self.update = Some((sent, self.process));
    }

    /// The host took its leave.
    pub(super) const fn leave(&mut self) {
        self.state = State::Left;
    }

    /// The host is gone without a word, unless it had left before.
    pub(super) fn lose(&mut self) {
        if self.is_connected() {
            self.state = State::Silent;
        }
    }

    /// Whether the host counts as connected and was silent for too long.
    pub(super) fn is_overdue(&self, now: MonoTime) -> bool {
        self.is_connected() && now - self.seen.mono > CONNECTED_WITHIN
    }
}
