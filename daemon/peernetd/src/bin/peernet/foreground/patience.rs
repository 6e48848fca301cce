//! How long a peer that is away or silent is waited for.

use peernet_agent::Running;
use peernet_clock::{MonoTime, Span};
use peernet_logger::stream::PipelineState;

/// How long it may stay silent before the user is told.
const SILENCE: Span = Span::from_seconds(3);

/// Waits for the peer of one pipeline.
pub(crate) struct Patience {
    /// The last sign of the peer.
    heard: MonoTime,
}

impl Patience {
    /// The longest that a peer that went away is waited for, unless there is a reason for less.
    pub(crate) const USUAL: Span = Span::from_seconds(90);

    pub(crate) const fn new(now: MonoTime) -> Self {
        Self { heard: now }
    }

    /// There was a sign of the peer.
    pub(crate) const fn heard(&mut self, now: MonoTime) {
        self.heard = now;
    }

    /// When the last one was.
    pub(crate) const fn last(&self) -> MonoTime {
        self.heard
    }

    /// What the user is to know: that the peer called `name` is away or silent. `waits_for` is what the pipeline says.
    pub(crate) fn trouble(
        &self,
        name: &str,
        waits_for: Option<&str>,
        now: MonoTime,
        most: Span,
    ) -> Option<String> {
        let silent = now - self.heard;
        let (seconds, most) = (silent.seconds(), most.seconds());
        match waits_for {
            Some(reason) => {
                Some(format!("{name} is away ({reason}); waiting for {seconds:.0} s, at most {most:.0} s"))
            }
            None if silent > SILENCE => Some(format!("no answer from {name} for {seconds:.0} s")),
            None => None,
        }
    }

    /// Why the peer is given up, if it is.
    pub(crate) fn spent(&self, waits_for: Option<&str>, now: MonoTime, most: Span) -> Option<String> {
        let silent = now - self.heard;
        let reason = waits_for.map_or_else(String::new, |reason| format!(": {reason}"));
        let text = || format!("gave up after {:.0} s without an answer{reason}", silent.seconds());
        (silent > most).then(text)
    }
}

/// What the first pipeline waits for, if it waits.
pub(crate) fn waits_for(running: &Running) -> Option<String> {
    let pipelines = running.live().pipelines;
    match pipelines.into_iter().next().map(|pipeline| pipeline.state) {
        Some(PipelineState::Waiting(reason)) => Some(reason),
        _ => None,
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
        assert_eq!(away.as_deref(), Some("cloud is away (refused); waiting for 1 s, at most 20 s"));
        assert_eq!(patience.spent(None, at(20), most), None);
        let spent = patience.spent(Some("refused"), at(21), most);
        assert_eq!(spent.as_deref(), Some("gave up after 21 s without an answer: refused"));
        patience.heard(at(21));
        assert_eq!((patience.spent(None, at(21), most), patience.last()), (None, at(21)));
    }
}
