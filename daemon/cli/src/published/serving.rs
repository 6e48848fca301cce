//! Observation of a server: its sessions and its answers.

use futures::FutureExt;
use peernet_agent::RunningAgent;
use peernet_clock::{MonoTime, SharedClock};
use peernet_inference::LoadError;
use peernet_logger::Slug;
use peernet_statistics::number::counted;
use peernet_stream::Event;
use tokio::task::JoinHandle;

use super::Arguments;
use crate::foreground::{Ended, Progress, RunObserver, describe_quantiles, p99};

/// Observer of the agent.
pub(super) struct Serving {
    model: Slug,
    answers: AnswerCounts,
    clock: SharedClock,
    progress: Progress,
    /// Description of the durations of `inference`.
    inference: String,
    sessions: usize,
    loading: Loading,
}

/// Number of answers of the server, given and wanted.
struct AnswerCounts {
    wanted: u64,
    answered: u64,
    /// Answers that report an error.
    errors: u64,
    /// Iterations of ended runs that never arrived here.
    missed: u64,
    /// Time of the first observed answer, and the number of answers by then.
    first: Option<(MonoTime, u64)>,
    /// Time of the last observed answer.
    last: Option<MonoTime>,
}

/// State of loading the model.
enum Loading {
    NotBegun,
    UnderWay(JoinHandle<Result<(), LoadError>>),
    Done,
}

impl AnswerCounts {
    const fn new(wanted: u64) -> Self {
        Self { wanted, answered: 0, errors: 0, missed: 0, first: None, last: None }
    }

    /// Updates the counts from the counts of the agent, which never decrease.
    fn update(&mut self, answers: u64, errors: u64, missed: u64, now: MonoTime) {
        (self.errors, self.missed) = (errors, missed);
        if answers > self.answered {
            self.answered = answers;
            self.first.get_or_insert((now, answers));
            self.last = Some(now);
        }
    }

    const fn are_complete(&self) -> bool {
        self.answered.saturating_add(self.missed) >= self.wanted
    }

    /// Describes the number of errors among the answers, if there are any.
    fn describe_errors(&self) -> String {
        match self.errors {
            0 => String::new(),
            1 => ", 1 of them an error".to_owned(),
            many => format!(", {many} of them errors"),
        }
    }

    /// Describes the number of iterations that ended without arriving here, if there are any.
    fn describe_missed(&self) -> String {
        match self.missed {
            0 => String::new(),
            missed => format!(", {} did not arrive here", counted(missed, "iteration")),
        }
    }

    /// Returns the answers per second, from the first to the last.
    fn rate(&self) -> Option<f64> {
        let ((from, before), to) = (self.first?, self.last?);
        let seconds = (to - from).seconds();
        (seconds > 0.0).then(|| (self.answered - before) as f64 / seconds)
    }
}

impl Serving {
    pub(super) fn new(model: Slug, arguments: &Arguments, clock: SharedClock) -> Self {
        Self {
            model,
            answers: AnswerCounts::new(arguments.iterations.get()),
            progress: Progress::new(arguments.quiet, clock.mono()),
            clock,
            inference: String::new(),
            sessions: 0,
            loading: Loading::NotBegun,
        }
    }

    /// Returns whether there was an answer.
    pub(super) const fn has_answers(&self) -> bool {
        self.answers.answered > 0
    }

    /// Describes the result.
    pub(super) fn summary(&self) -> String {
        let Self { answers, inference, .. } = self;
        let rate = answers.rate().map_or_else(String::new, |rate| format!(", {rate:.1} /s"));
        let count = counted(answers.answered, "answer");
        format!("{count}{}{}{rate}{inference}", answers.describe_errors(), answers.describe_missed())
    }

    /// Describes the missing answers after no more will come, if any are missing.
    pub(super) fn shortfall(&self) -> Option<String> {
        let AnswerCounts { wanted, answered, .. } = self.answers;
        let short = wanted.saturating_sub(answered);
        let advice = "the clients' results say why";
        (short > 0)
            .then(|| format!("{short} of {} did not arrive here: {advice}", counted(wanted, "iteration")))
    }

    /// Loads the model before the first request, so that errors show immediately and no client waits for it.
    fn load(&mut self, running: &RunningAgent) -> Option<Ended<LoadError>> {
        match &mut self.loading {
            Loading::NotBegun => {
                self.loading = Loading::UnderWay(running.load_model(&self.model));
                None
            }
            Loading::UnderWay(loading) => {
                let loaded = loading.now_or_never()?;
                self.loading = Loading::Done;
                match loaded {
                    Ok(Ok(())) => {
                        let at = running
                            .serve_addresses()
                            .iter()
                            .map(ToString::to_string)
                            .collect::<Vec<_>>()
                            .join(", ");
                        self.progress.print_line(format_args!(
                            "serving {} on all interfaces at {at}; ends after {} answers or with Ctrl-C",
                            self.model, self.answers.wanted
                        ));
                        None
                    }
                    Ok(Err(error)) => Some(Ended::OwnReason(error)),
                    Err(_) => Some(Ended::Failed("loading the model panicked".to_owned())),
                }
            }
            Loading::Done => None,
        }
    }

    fn describe(&self) -> (String, f64) {
        let AnswerCounts { wanted, answered, .. } = self.answers;
        let share = answered as f64 / wanted as f64;
        let text = match (&self.loading, self.sessions, answered) {
            (Loading::NotBegun | Loading::UnderWay(_), ..) => format!("loading {}", self.model),
            (Loading::Done, 0, 0) => "waiting for a client".to_owned(),
            (Loading::Done, sessions, answered) => {
                let rate = self.answers.rate().map_or_else(String::new, |rate| format!(", {rate:.1} /s"));
                let clients = match sessions {
                    0 => "no client".to_owned(),
                    1 => "1 session".to_owned(),
                    many => format!("{many} sessions"),
                };
                let (failed, without) = (self.answers.describe_errors(), self.answers.describe_missed());
                let inference = &self.inference;
                format!("{answered} of {wanted} answers{failed}{without}, {clients}{rate}{inference}")
            }
        };
        (text, share)
    }
}

impl RunObserver for Serving {
    /// The model cannot be loaded.
    type OwnReason = LoadError;

    fn handle_event(&mut self, _event: Event, _running: Option<&RunningAgent>) -> Option<Ended<LoadError>> {
        None
    }

    fn poll_state(&mut self, running: &RunningAgent) -> Option<Ended<LoadError>> {
        if let Some(ended) = self.load(running) {
            return Some(ended);
        }
        let served = running.served_counts().borrow().clone();
        let inference =
            served.inference.quantile(0.5).map(|p50| describe_quantiles(p50, p99(&served.inference)));
        self.inference = inference.map_or_else(String::new, |quantiles| format!(", inference {quantiles}"));
        self.sessions = served.sessions;
        let now = self.clock.mono();
        self.answers.update(served.answers, served.errors, served.missed, now);
        let state = self.describe();
        self.progress.show(now, None, || state);
        self.answers.are_complete().then_some(Ended::Finished)
    }

    fn end_decided(&mut self) {
        self.progress.end();
    }
}
