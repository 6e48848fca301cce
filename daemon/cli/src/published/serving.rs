//! Watching a server: who is there, how many answers there were.

use futures::FutureExt;
use peernet_agent::Running;
use peernet_clock::{MonoTime, SharedClock};
use peernet_inference::LoadError;
use peernet_logger::Slug;
use peernet_statistics::number::counted;
use peernet_stream::Event;
use tokio::task::JoinHandle;

use super::Arguments;
use crate::foreground::{Ended, Eyes, Progress, p99, told};

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
    /// How many iterations of runs that are over never came here.
    missed: u64,
    /// How long `inference` took.
    inference: String,
    sessions: usize,
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
            missed: 0,
            inference: String::new(),
            sessions: 0,
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
        let answers = counted(self.answered, "answer");
        format!("{answers}{}{}{rate}{}", self.failed(), self.without(), self.inference)
    }

    /// Why there were not all answers although there will be no more, if so.
    pub(super) fn shortfall(&self) -> Option<String> {
        let short = self.wanted.saturating_sub(self.answered);
        let said = "the clients' results say why";
        (short > 0)
            .then(|| format!("{short} of {} never came here: {said}", counted(self.wanted, "iteration")))
    }

    /// How many of the answers are errors, if any.
    fn failed(&self) -> String {
        match self.errors {
            0 => String::new(),
            1 => ", 1 of them an error".to_owned(),
            many => format!(", {many} of them errors"),
        }
    }

    /// How many iterations clients have ended without asking, if any.
    fn without(&self) -> String {
        match self.missed {
            0 => String::new(),
            missed => format!(", {} never came here", counted(missed, "iteration")),
        }
    }

    /// Answers per second, from the first to the last.
    fn rate(&self) -> Option<f64> {
        let ((from, before), to) = (self.first?, self.last?);
        let seconds = (to - from).seconds();
        (seconds > 0.0).then(|| (self.answered - before) as f64 / seconds)
    }

    /// Brings the model into memory before anybody asks: what is wrong with it shows at once, and nobody waits for it.
    fn load(&mut self, running: &Running) -> Option<Ended<LoadError>> {
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
                    Ok(Err(error)) => Some(Ended::Own(error)),
                    Err(_) => Some(Ended::Failed("loading the model panicked".to_owned())),
                }
            }
            Loading::Done => None,
        }
    }

    fn describe(&self) -> (String, f64) {
        let share = self.answered as f64 / self.wanted as f64;
        let text = match (&self.loading, self.sessions, self.answered) {
            (Loading::NotBegun | Loading::UnderWay(_), ..) => format!("loading {}", self.model),
            (Loading::Done, 0, 0) => "waiting for a client".to_owned(),
            (Loading::Done, sessions, answered) => {
                let rate = self.rate().map_or_else(String::new, |rate| format!(", {rate:.1} /s"));
                let clients = match sessions {
                    0 => "no client".to_owned(),
                    1 => "1 session".to_owned(),
                    many => format!("{many} sessions"),
                };
                let (wanted, failed, without) = (self.wanted, self.failed(), self.without());
                let inference = &self.inference;
                format!("{answered} of {wanted} answers{failed}{without}, {clients}{rate}{inference}")
            }
        };
        (text, share)
    }
}

impl Eyes for Serving {
    /// The model cannot be had.
    type Own = LoadError;

    fn take(&mut self, _event: Event, _running: Option<&Running>) -> Option<Ended<LoadError>> {
        None
    }

    fn look(&mut self, running: &Running) -> Option<Ended<LoadError>> {
        if let Some(ended) = self.load(running) {
            return Some(ended);
        }
        let served = running.served().borrow().clone();
        let inference = served.inference.quantile(0.5).map(|p50| told(p50, p99(&served.inference)));
        self.inference = inference.map_or_else(String::new, |told| format!(", inference {told}"));
        (self.sessions, self.errors, self.missed) = (served.sessions, served.errors, served.missed);
        let now = self.clock.mono();
        if served.answers > self.answered {
            self.answered = served.answers;
            self.first.get_or_insert((now, served.answers));
            self.last = Some(now);
        }
        let state = self.describe();
        self.progress.show(now, None, || state);
        (self.answered.saturating_add(self.missed) >= self.wanted).then_some(Ended::Finished)
    }

    fn over(&mut self) {
        self.progress.end();
    }
}
