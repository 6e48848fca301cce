//! Wait for a peer that is away: when it is given up, and what is shown of a slow one.

use peernet_agent::RunningAgent;
use peernet_clock::{MonoTime, Span};
use peernet_stream::PipelineState;

/// Time of silence after which a message is shown.
const SILENCE: Span = Span::from_seconds(3);
/// Reason given for a peer that has sent nothing at all, not even a refusal.
const UNKNOWN: &str = "neither a refusal nor a word of PEERNet's protocol has come back until then; check the address, and what listens there";

/// Current activity of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PipelineActivity {
    /// The sensor has been in preparation since this time.
    Preparing(MonoTime),
    /// The sensor was asked for a sample at this time.
    Sensing(MonoTime),
    /// Its peer is away; the text is the reason, once it is known.
    Away(Option<String>),
    /// It waits neither for its sensor nor for its peer.
    Running,
}

impl PipelineActivity {
    /// Returns the activity of the first pipeline.
    pub(crate) fn of(running: &RunningAgent) -> Self {
        let Some(pipeline) = running.live_update().pipelines.into_iter().next() else { return Self::Running };
        match (pipeline.state, running.sensor_busy_since(&pipeline.pipeline)) {
            (PipelineState::Waiting(reason), _) => Self::Away(Some(reason)),
            (PipelineState::Starting, Some(since)) => Self::Preparing(since),
            (PipelineState::Starting, None) => Self::Away(None),
            (_, Some(since)) => Self::Sensing(since),
            (_, None) => Self::Running,
        }
    }

    /// Returns the reason that the peer is away, if it is and the reason is known.
    pub(crate) fn waits_for(&self) -> Option<&str> {
        match self {
            Self::Away(reason) => reason.as_deref(),
            Self::Preparing(_) | Self::Sensing(_) | Self::Running => None,
        }
    }

    /// Describes a slow sensor for the user.
    pub(crate) fn slow_sensor(&self, now: MonoTime) -> Option<String> {
        let (since, what) = match self {
            Self::Preparing(since) => (*since, "the sensor is not ready after"),
            Self::Sensing(since) => (*since, "the sensor gave no sample for"),
            Self::Away(_) | Self::Running => return None,
        };
        let slow = now - since;
        (slow > SILENCE).then(|| format!("{what} {:.0} s", slow.seconds()))
    }
}

/// Wait for the peer of one pipeline.
pub(crate) struct PeerWait {
    /// Time of the peer's last answer, or the last time at which it was not asked.
    answered: MonoTime,
    /// Last time at which the peer was connected.
    present: MonoTime,
}

impl PeerWait {
    /// The longest that a peer that went away is waited for, unless there is a reason for less.
    pub(crate) const USUAL: Span = Span::from_seconds(90);

    pub(crate) const fn new(now: MonoTime) -> Self {
        Self { answered: now, present: now }
    }

    /// Records an answer of the peer.
    pub(crate) const fn record_answer(&mut self, now: MonoTime) {
        (self.answered, self.present) = (now, now);
    }

    /// Returns the last time at which the peer was connected.
    pub(crate) const fn last_present(&self) -> MonoTime {
        self.present
    }

    /// Takes the pipeline's activity into account: only a peer that is away is given up.
    ///
    /// A connected peer has the time that the pipeline gives each iteration; while the sensor works, the peer was not asked.
    pub(crate) const fn update(&mut self, activity: &PipelineActivity, now: MonoTime) {
        match activity {
            PipelineActivity::Preparing(_) | PipelineActivity::Sensing(_) => self.record_answer(now),
            PipelineActivity::Running => self.present = now,
            PipelineActivity::Away(_) => {}
        }
    }

    /// Describes for the user that the peer called `name` is away or silent. `waits_for` is the pipeline's reason.
    pub(crate) fn describe_trouble(
        &self,
        name: &str,
        waits_for: Option<&str>,
        now: MonoTime,
        most: Span,
    ) -> Option<String> {
        let (away, silent) = (now - self.present, now - self.answered);
        let (seconds, most) = (away.seconds(), most.seconds());
        match waits_for {
            Some(reason) if away <= SILENCE => {
                Some(format!("{name} is away ({reason}); waiting for it to answer"))
            }
            Some(reason) => {
                Some(format!("{name} is away ({reason}); waiting for {seconds:.0} s, at most {most:.0} s"))
            }
            None if silent > SILENCE => Some(format!("no answer from {name} for {:.0} s", silent.seconds())),
            None => None,
        }
    }

    /// Returns the reason for giving up the peer, if the wait is over.
    pub(crate) fn reason_to_give_up(
        &self,
        waits_for: Option<&str>,
        now: MonoTime,
        most: Span,
    ) -> Option<String> {
        let away = now - self.present;
        // Without a reason the first attempt is still under way: it gets a minimum of time, whatever the limit.
        let most = if waits_for.is_none() { most.max(SILENCE) } else { most };
        let reason = waits_for.unwrap_or(UNKNOWN);
        let text = || format!("gave up after {:.0} s without an answer: {reason}", away.seconds());
        (away > most).then(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_peer_is_reported_and_given_up_at_limit() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let mut peer_wait = PeerWait::new(at(0));
        let most = Span::from_seconds(20);
        assert_eq!(peer_wait.describe_trouble("cloud", None, at(2), most), None);
        let silent = peer_wait.describe_trouble("cloud", None, at(5), most);
        assert_eq!(silent.as_deref(), Some("no answer from cloud for 5 s"));
        let away = peer_wait.describe_trouble("cloud", Some("refused"), at(1), most);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for it to answer"));
        let away = peer_wait.describe_trouble("cloud", Some("refused"), at(5), most);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for 5 s, at most 20 s"));
        assert_eq!(peer_wait.reason_to_give_up(None, at(20), most), None);
        let spent = peer_wait.reason_to_give_up(Some("refused"), at(21), most);
        assert_eq!(spent.as_deref(), Some("gave up after 21 s without an answer: refused"));
        assert_eq!(peer_wait.reason_to_give_up(None, at(1), Span::ZERO), None, "nothing has failed yet");
        peer_wait.record_answer(at(21));
        assert_eq!(
            (peer_wait.reason_to_give_up(None, at(21), most), peer_wait.last_present()),
            (None, at(21))
        );
    }
    #[test]
    fn connected_peer_is_not_given_up() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let (mut peer_wait, most) = (PeerWait::new(at(0)), Span::from_seconds(3));
        peer_wait.update(&PipelineActivity::Running, at(50));
        let slow = peer_wait.describe_trouble("cloud", None, at(50), most);
        assert_eq!(slow.as_deref(), Some("no answer from cloud for 50 s"));
        assert_eq!(peer_wait.reason_to_give_up(None, at(50), most), None, "a model may take its time");
        let sensing = PipelineActivity::Sensing(at(51));
        peer_wait.update(&sensing, at(60));
        assert_eq!(sensing.slow_sensor(at(60)).as_deref(), Some("the sensor gave no sample for 9 s"));
        assert_eq!(
            (peer_wait.describe_trouble("cloud", None, at(60), most), sensing.slow_sensor(at(52))),
            (None, None)
        );
        let preparing = PipelineActivity::Preparing(at(0));
        assert_eq!(preparing.slow_sensor(at(9)).as_deref(), Some("the sensor is not ready after 9 s"));
        peer_wait.update(&PipelineActivity::Away(None), at(64));
        assert!(
            peer_wait
                .reason_to_give_up(None, at(64), most)
                .is_some_and(|text| text.contains("after 4 s without an answer: neither a refusal"))
        );
    }
}
