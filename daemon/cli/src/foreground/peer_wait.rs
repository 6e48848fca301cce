//! Wait for a peer that is away: the time after which the agent gives up, and the messages about a slow peer.

use peernet_agent::RunningAgent;
use peernet_clock::{MonoTime, Span};
use peernet_networks::OpenError;
use peernet_stream::PipelineState;

/// Time without an answer of the peer, or without a sample of the sensor, after which a message is shown.
const SILENCE: Span = Span::from_seconds(3);
/// Reason given for a peer that has sent nothing at all, not even a refusal.
const NO_MESSAGE_REASON: &str = "neither a refusal nor a PEERNet message has arrived; check the address, which program listens there, and \
     whether it hangs";

/// Current activity of a pipeline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PipelineActivity {
    /// The sensor has been in preparation since this time.
    Preparing(MonoTime),
    /// The sensor was asked for a sample at this time.
    Sensing(MonoTime),
    /// The peer is unreachable, for this reason if one is known.
    Away(Option<String>),
    /// The pipeline waits neither for its sensor nor for its peer.
    Running,
}

impl PipelineActivity {
    /// Returns the activity of the first pipeline.
    pub(crate) fn current(running: &RunningAgent) -> Self {
        let Some(pipeline) = running.live_update().pipelines.into_iter().next() else { return Self::Running };
        match (pipeline.state, running.sensor_busy_since(&pipeline.pipeline)) {
            (PipelineState::Waiting(reason), _) => Self::Away(Some(reason)),
            (PipelineState::Starting, Some(since)) => Self::Preparing(since),
            // A starting pipeline whose sensor is ready waits for its peer.
            (PipelineState::Starting, None) => Self::Away(None),
            (_, Some(since)) => Self::Sensing(since),
            (_, None) => Self::Running,
        }
    }

    /// Returns the reason for which the peer is away; `None` if it is not away or the reason is unknown. The hint about a
    /// model that loads is left out: it names a key of a configuration file, which a foreground command does not have.
    pub(crate) fn wait_reason(&self) -> Option<&str> {
        let Self::Away(Some(reason)) = self else { return None };
        Some(reason.strip_suffix(OpenError::LOADING_HINT).unwrap_or(reason))
    }

    /// Describes a sensor that is slow at `now`; `None` if the sensor is not slow.
    pub(crate) fn describe_slow_sensor(&self, now: MonoTime) -> Option<String> {
        let (since, problem) = match self {
            Self::Preparing(since) => (*since, "the sensor is not ready after"),
            Self::Sensing(since) => (*since, "the sensor gave no sample for"),
            Self::Away(_) | Self::Running => return None,
        };
        let wait = now - since;
        (wait > SILENCE).then(|| format!("{problem} {:.0} s", wait.seconds()))
    }
}

/// Wait for the peer of one pipeline.
pub(crate) struct PeerWait {
    /// Later of these times: the peer's last answer, and the last time without an open request.
    last_answer: MonoTime,
    /// Last time at which the peer was connected.
    last_present: MonoTime,
}

impl PeerWait {
    /// Default timeout for an unreachable peer.
    pub(crate) const DEFAULT_TIMEOUT: Span = Span::from_seconds(90);
    /// Words at the beginning of the reason for giving up a peer.
    pub(crate) const GAVE_UP: &str = "gave up after";

    pub(crate) const fn new(now: MonoTime) -> Self {
        Self { last_answer: now, last_present: now }
    }

    /// Records an answer of the peer.
    pub(crate) const fn record_answer(&mut self, now: MonoTime) {
        (self.last_answer, self.last_present) = (now, now);
    }

    /// Returns the last time at which the peer was connected.
    pub(crate) const fn last_present(&self) -> MonoTime {
        self.last_present
    }

    /// Updates the times from the pipeline's activity. Only a peer that is away is given up.
    ///
    /// A connected peer is not given up, because the pipeline has its own timeout for each iteration. While the
    /// sensor works, there is no open request.
    pub(crate) const fn update(&mut self, activity: &PipelineActivity, now: MonoTime) {
        match activity {
            PipelineActivity::Preparing(_) | PipelineActivity::Sensing(_) => self.record_answer(now),
            PipelineActivity::Running => self.last_present = now,
            PipelineActivity::Away(_) => {}
        }
    }

    /// Describes that the peer called `name` is away or silent; `None` if the peer is neither. `wait_reason` is the
    /// reason for which the pipeline waits.
    pub(crate) fn describe_trouble(
        &self,
        name: &str,
        wait_reason: Option<&str>,
        now: MonoTime,
        timeout: Span,
    ) -> Option<String> {
        let (absence, silence) = (now - self.last_present, now - self.last_answer);
        let (absence_s, timeout_s) = (absence.seconds(), timeout.seconds());
        match wait_reason {
            Some(reason) if absence <= SILENCE => {
                Some(format!("{name} is away ({reason}); waiting for it to answer"))
            }
            Some(reason) => Some(format!(
                "{name} is away ({reason}); waiting for {absence_s:.0} s, at most {timeout_s:.0} s"
            )),
            None if silence > SILENCE => {
                Some(format!("no answer from {name} for {:.0} s", silence.seconds()))
            }
            None => None,
        }
    }

    /// Returns the reason for giving up the peer, if the wait is over.
    pub(crate) fn timeout_reason(
        &self,
        wait_reason: Option<&str>,
        now: MonoTime,
        timeout: Span,
    ) -> Option<String> {
        let absence = now - self.last_present;
        // Without a reason, the first attempt to connect has not ended yet. This attempt gets at least the time
        // `SILENCE`, even if the timeout is shorter.
        let timeout = if wait_reason.is_none() { timeout.max(SILENCE) } else { timeout };
        let reason = wait_reason.unwrap_or(NO_MESSAGE_REASON);
        let text = || format!("{} {:.0} s without an answer: {reason}", Self::GAVE_UP, absence.seconds());
        (absence > timeout).then(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_peer_times_out_with_report() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let mut peer_wait = PeerWait::new(at(0));
        let timeout = Span::from_seconds(20);
        assert_eq!(peer_wait.describe_trouble("cloud", None, at(2), timeout), None);
        let silent = peer_wait.describe_trouble("cloud", None, at(5), timeout);
        assert_eq!(silent.as_deref(), Some("no answer from cloud for 5 s"));
        let away = peer_wait.describe_trouble("cloud", Some("refused"), at(1), timeout);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for it to answer"));
        let away = peer_wait.describe_trouble("cloud", Some("refused"), at(5), timeout);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for 5 s, at most 20 s"));
        assert_eq!(peer_wait.timeout_reason(None, at(20), timeout), None);
        let expired = peer_wait.timeout_reason(Some("refused"), at(21), timeout);
        assert_eq!(expired.as_deref(), Some("gave up after 21 s without an answer: refused"));
        assert_eq!(peer_wait.timeout_reason(None, at(1), Span::ZERO), None, "nothing has failed yet");
        peer_wait.record_answer(at(21));
        assert_eq!(
            (peer_wait.timeout_reason(None, at(21), timeout), peer_wait.last_present()),
            (None, at(21))
        );
    }

    #[test]
    fn connected_peer_is_not_given_up() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let (mut peer_wait, timeout) = (PeerWait::new(at(0)), Span::from_seconds(3));
        peer_wait.update(&PipelineActivity::Running, at(50));
        let slow = peer_wait.describe_trouble("cloud", None, at(50), timeout);
        assert_eq!(slow.as_deref(), Some("no answer from cloud for 50 s"));
        assert_eq!(peer_wait.timeout_reason(None, at(50), timeout), None, "a model may take its time");
        let sensing = PipelineActivity::Sensing(at(51));
        peer_wait.update(&sensing, at(60));
        assert_eq!(
            sensing.describe_slow_sensor(at(60)).as_deref(),
            Some("the sensor gave no sample for 9 s")
        );
        assert_eq!(
            (
                peer_wait.describe_trouble("cloud", None, at(60), timeout),
                sensing.describe_slow_sensor(at(52))
            ),
            (None, None)
        );
        let preparing = PipelineActivity::Preparing(at(0));
        assert_eq!(
            preparing.describe_slow_sensor(at(9)).as_deref(),
            Some("the sensor is not ready after 9 s")
        );
        peer_wait.update(&PipelineActivity::Away(None), at(64));
        assert!(
            peer_wait
                .timeout_reason(None, at(64), timeout)
                .is_some_and(|text| text.contains("after 4 s without an answer: neither a refusal"))
        );
    }
}
