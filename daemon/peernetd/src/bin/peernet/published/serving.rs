//! Watching a server: who is there, how many answers there were.

use std::collections::BTreeMap;

use futures::FutureExt;
use peernet_agent::Running;
use peernet_clock::{MonoTime, SharedClock};
use peernet_inference::LoadError;
use peernet_logger::stream::{Event, IncidentKind};
use peernet_logger::{HostId, Slug};
use peernet_report::number::milliseconds;
use tokio::task::JoinHandle;

use super::Arguments;
use crate::foreground::{Cut, Eyes, Progress};

/// How serving ended.
#[derive(Debug)]
pub(super) enum Ended {
    /// All answers were given.
    Answered,
    /// The user ended it.
    Interrupted,
    /// The model cannot be had.
    Model(LoadError),
    /// The agent could not go on; the text says why.
    Failed(String),
}

impl From<Cut> for Ended {
    fn from(cut: Cut) -> Self {
        match cut {
            Cut::Interrupted => Self::Interrupted,
            Cut::Deserted => Self::Failed("the agent ended by itself".to_owned()),
        }
    }
}

/// The eyes on the agent.
pub(super) struct Serving {
    model: Slug,
    wanted: u64,
    answered: u64,
    /// How many of them said that there is none.
    errors: u64,
    clock: SharedClock,
    progress: Progress,
    /// When the first answer was seen, and how many there were by then.
    first: Option<(MonoTime, u64)>,
    last: Option<MonoTime>,
    /// Median and 99th percentile of `inference`, seconds.
    inference: Option<(f64, f64)>,
    /// Sessions by peer.
    sessions: BTreeMap<HostId, u32>,
    loading: Loading,
}

/// The model on its way into memory.
enum Loading {
    NotBegun,
    UnderWay(JoinHandle<Result<(), LoadError>>),
    Done,
}

impl Serving {
    pub(super) fn new(model: Slug, arguments: &Arguments, clock: SharedClock) -> Self {
        Self {
            model,
            wanted: arguments.iterations.get(),
            answered: 0,
            errors: 0,
            progress: Progress::new(arguments.quiet, clock.mono()),
            clock,
            first: None,
            last: None,
            inference: None,
            sessions: BTreeMap::new(),
            loading: Loading::NotBegun,
        }
    }

    /// Whether there was an answer.
    pub(super) const fn answered(&self) -> bool {
        self.answered > 0
    }

    /// What came of it.
    pub(super) fn summary(&self) -> String {
        let rate = self.rate().map_or_else(String::new, |rate| format!(", {rate:.1} /s"));
        format!("{} answers{}{rate}{}", self.answered, self.failed(), self.inference())
    }

    /// How many of the answers are errors, if any.
    fn failed(&self) -> String {
        match self.errors {
            0 => String::new(),
            1 => ", 1 of them an error".to_owned(),
            many => format!(", {many} of them errors"),
        }
    }

    /// Answers per second, from the first to the last.
    fn rate(&self) -> Option<f64> {
        let ((from, before), to) = (self.first?, self.last?);
        let seconds = (to - from).seconds();
        (seconds > 0.0).then(|| (self.answered - before) as f64 / seconds)
    }

    fn inference(&self) -> String {
        let told = |(p50, p99)| format!(", inference {} ms (p99 {})", milliseconds(p50), milliseconds(p99));
        self.inference.map_or_else(String::new, told)
    }

    /// Brings the model into memory before anybody asks: what is wrong with it shows at once, and nobody waits for it.
    fn load(&mut self, running: &Running) -> Option<Ended> {
        match &mut self.loading {
            Loading::NotBegun => {
                self.loading = Loading::UnderWay(running.load(&self.model));
                None
            }
            Loading::UnderWay(loading) => {
                let loaded = loading.now_or_never()?;
                self.loading = Loading::Done;
                match loaded {
                    Ok(Ok(())) => {
                        let at = running.serves().map(ToString::to_string).unwrap_or_default();
                        self.progress.say(format_args!(
                            "serving {} on all interfaces at {at}; ends after {} answers or with Ctrl-C",
                            self.model, self.wanted
                        ));
                        None
                    }
                    Ok(Err(error)) => Some(Ended::Model(error)),
                    Err(_) => Some(Ended::Failed("loading the model panicked".to_owned())),
                }
            }
            Loading::Done => None,
        }
    }

    fn describe(&self) -> (String, f64) {
        let share = self.answered as f64 / self.wanted as f64;
        let sessions: u32 = self.sessions.values().sum();
        let text = match (&self.loading, sessions, self.answered) {
            (Loading::NotBegun | Loading::UnderWay(_), ..) => format!("loading {}", self.model),
            (Loading::Done, 0, 0) => "waiting for a client".to_owned(),
            (Loading::Done, sessions, answered) => {
                let rate = self.rate().map_or_else(String::new, |rate| format!(", {rate:.1} /s"));
                let clients = match sessions {
                    0 => "no client".to_owned(),
                    1 => "1 session".to_owned(),
                    many => format!("{many} sessions"),
                };
                let (wanted, failed) = (self.wanted, self.failed());
                format!("{answered} of {wanted} answers{failed}, {clients}{rate}{}", self.inference())
            }
        };
        (text, share)
    }
}

impl Eyes for Serving {
    type Ended = Ended;

    fn take(&mut self, event: Event, _running: Option<&Running>) -> Option<Ended> {
        let Event::Incident(incident) = event else { return None };
        let peer = incident.peer?;
        match incident.kind {
            IncidentKind::Connected => *self.sessions.entry(peer).or_default() += 1,
            IncidentKind::Disconnected => {
                if let Some(sessions) = self.sessions.get_mut(&peer) {
                    *sessions = sessions.saturating_sub(1);
                }
            }
            _ => return None,
        }
        None
    }

    fn look(&mut self, running: &Running) -> Option<Ended> {
        if let Some(ended) = self.load(running) {
            return Some(ended);
        }
        let (answered, errors, p50, p99) = {
            let served = running.served();
            let served = served.borrow();
            (served.answers, served.errors, served.inference.quantile(0.5), served.inference.quantile(0.99))
        };
        self.inference = p50.zip(p99);
        self.errors = errors;
        let now = self.clock.mono();
        if answered > self.answered {
            self.answered = answered;
            self.first.get_or_insert((now, answered));
            self.last = Some(now);
        }
        let state = self.describe();
        self.progress.show(now, None, || state);
        (answered >= self.wanted).then_some(Ended::Answered)
    }

    fn over(&mut self) {
        self.progress.end();
    }
}
