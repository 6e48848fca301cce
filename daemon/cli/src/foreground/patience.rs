//! How long a peer that is away is waited for, and what is told of one that is slow.

use peernet_agent::Running;
use peernet_clock::{MonoTime, Span};
use peernet_stream::PipelineState;

/// How long it may stay silent before the user is told.
const SILENCE: Span = Span::from_seconds(3);
/// Why a peer is away that has not been heard of at all: nobody has refused either.
const UNKNOWN: &str = "neither a refusal nor a word of PEERNet's protocol has come back until then; check the address, and what listens there";

/// What a pipeline does at the moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Standing {
    /// Its sensor is being set up, since then.
    Preparing(MonoTime),
    /// Its sensor was asked for a sample, at that time.
    Sensing(MonoTime),
    /// Its peer is not there (yet); the text says why, once it is known.
    Away(Option<String>),
    /// It has all it needs.
    Running,
}

impl Standing {
    /// That of the first pipeline.
    pub(crate) fn of(running: &Running) -> Self {
        let Some(pipeline) = running.live().pipelines.into_iter().next() else { return Self::Running };
        match (pipeline.state, running.senses_since(&pipeline.pipeline)) {
            (PipelineState::Waiting(reason), _) => Self::Away(Some(reason)),
            (PipelineState::Starting, Some(since)) => Self::Preparing(since),
            (PipelineState::Starting, None) => Self::Away(None),
            (_, Some(since)) => Self::Sensing(since),
            (_, None) => Self::Running,
        }
    }

    /// Why the peer is away, if it is.
    pub(crate) fn waits_for(&self) -> Option<&str> {
        match self {
            Self::Away(reason) => reason.as_deref(),
            Self::Preparing(_) | Self::Sensing(_) | Self::Running => None,
        }
    }

    /// What the user is to know of the sensor: that it is slow.
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

/// Waits for the peer of one pipeline.
pub(crate) struct Patience {
    /// The last sign of the peer, or the last time when it was not asked.
    heard: MonoTime,
    /// When it was there last.
    there: MonoTime,
}

impl Patience {
    /// The longest that a peer that went away is waited for, unless there is a reason for less.
    pub(crate) const USUAL: Span = Span::from_seconds(90);

    pub(crate) const fn new(now: MonoTime) -> Self {
        Self { heard: now, there: now }
    }

    /// There was a sign of the peer.
    pub(crate) const fn heard(&mut self, now: MonoTime) {
        (self.heard, self.there) = (now, now);
    }

    /// When it was there last.
    pub(crate) const fn last(&self) -> MonoTime {
        self.there
    }

    /// Looks at what the pipeline does: only a peer that is away is given up. One that is connected has the time that
    /// the pipeline gives each iteration, and while the sensor is at work nobody was asked.
    pub(crate) const fn look(&mut self, standing: &Standing, now: MonoTime) {
        match standing {
            Standing::Preparing(_) | Standing::Sensing(_) => self.heard(now),
            Standing::Running => self.there = now,
            Standing::Away(_) => {}
        }
    }

    /// What the user is to know: that the peer called `name` is away or silent. `waits_for` is what the pipeline says.
    pub(crate) fn trouble(
        &self,
        name: &str,
        waits_for: Option<&str>,
        now: MonoTime,
        most: Span,
    ) -> Option<String> {
        let (away, silent) = (now - self.there, now - self.heard);
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

    /// Why the peer is given up, if it is.
    pub(crate) fn spent(&self, waits_for: Option<&str>, now: MonoTime, most: Span) -> Option<String> {
        let away = now - self.there;
        // Without a reason the first attempt goes on: it may take its time however little patience there is.
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
    fn a_silent_peer_is_told_of_and_given_up_in_the_end() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let mut patience = Patience::new(at(0));
        let most = Span::from_seconds(20);
        assert_eq!(patience.trouble("cloud", None, at(2), most), None);
        let silent = patience.trouble("cloud", None, at(5), most);
        assert_eq!(silent.as_deref(), Some("no answer from cloud for 5 s"));
        let away = patience.trouble("cloud", Some("refused"), at(1), most);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for it to answer"));
        let away = patience.trouble("cloud", Some("refused"), at(5), most);
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for 5 s, at most 20 s"));
        assert_eq!(patience.spent(None, at(20), most), None);
        let spent = patience.spent(Some("refused"), at(21), most);
        assert_eq!(spent.as_deref(), Some("gave up after 21 s without an answer: refused"));
        assert_eq!(patience.spent(None, at(1), Span::ZERO), None, "nothing has failed yet");
        patience.heard(at(21));
        assert_eq!((patience.spent(None, at(21), most), patience.last()), (None, at(21)));
    }
    #[test]
    fn only_a_peer_that_is_away_is_given_up() {
        let at = |seconds: i64| MonoTime::from_nanos(seconds * 1_000_000_000);
        let (mut patience, most) = (Patience::new(at(0)), Span::from_seconds(3));
        patience.look(&Standing::Running, at(50));
        let slow = patience.trouble("cloud", None, at(50), most);
        assert_eq!(slow.as_deref(), Some("no answer from cloud for 50 s"));
        assert_eq!(patience.spent(None, at(50), most), None, "a model may take its time");
        let sensing = Standing::Sensing(at(51));
        patience.look(&sensing, at(60));
        assert_eq!(sensing.slow_sensor(at(60)).as_deref(), Some("the sensor gave no sample for 9 s"));
        assert_eq!(
            (patience.trouble("cloud", None, at(60), most), sensing.slow_sensor(at(52))),
            (None, None)
        );
        let preparing = Standing::Preparing(at(0));
        assert_eq!(preparing.slow_sensor(at(9)).as_deref(), Some("the sensor is not ready after 9 s"));
        patience.look(&Standing::Away(None), at(64));
        assert!(
            patience
                .spent(None, at(64), most)
                .is_some_and(|text| text.contains("after 4 s without an answer: neither a refusal"))
        );
    }
}
