//! Observation of a server: its sessions and its answers.

use futures::FutureExt;
use peernet_agent::RunningAgent;
use peernet_clock::{MonoTime, SharedClock};
use peernet_inference::LoadError;
use peernet_logger::Slug;
use peernet_statistics::mean_rate;
use peernet_statistics::number::{counted, rate};
use peernet_stream::Event;
use tokio::task::JoinHandle;

use super::Arguments;
use crate::foreground::{AgentEnd, Progress, RunObserver, describe_quantiles};

/// Observer of an agent that serves one model: shows the progress, and ends the agent after the requested number of
/// answers.
pub(super) struct ServeObserver {
    model: Slug,
    answers: AnswerCounts,
    clock: SharedClock,
    progress: Progress,
    /// Description of the durations of `inference`.
    inference: String,
    /// Number of open sessions.
    sessions: usize,
    loading: Loading,
}

/// Number of answers that the server has given, and how many it is to give.
struct AnswerCounts {
    /// Number of answers after which the server ends.
    target: u64,
    answered: u64,
    /// Answers that report an error.
    errors: u64,
    /// Iterations of ended runs that never arrived here.
    missed: u64,
    /// Time of the first observed answer, and the number of answers by then.
    first_answer: Option<(MonoTime, u64)>,
    /// Time of the last observed answer.
    last_answer: Option<MonoTime>,
}

/// State of loading the model.
enum Loading {
    NotStarted,
    InProgress(JoinHandle<Result<(), LoadError>>),
    Done,
}

impl AnswerCounts {
    const fn new(target: u64) -> Self {
        Self { target, answered: 0, errors: 0, missed: 0, first_answer: None, last_answer: None }
    }

    /// Updates the counts from the counts of the agent, which never decrease.
    fn update(&mut self, answers: u64, errors: u64, missed: u64, now: MonoTime) {
        (self.errors, self.missed) = (errors, missed);
        if answers > self.answered {
            self.answered = answers;
            // The count is kept with the time: several answers may have been given before the first observation, and
            // their duration is unknown.
            self.first_answer.get_or_insert((now, answers));
            self.last_answer = Some(now);
        }
    }

    const fn are_complete(&self) -> bool {
        // Iterations that never arrive are counted, too; otherwise the server would wait for them forever.
        self.answered.saturating_add(self.missed) >= self.target
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

    /// Describes the answers per second, from the first to the last, if they are known.
    fn describe_rate(&self) -> String {
        let times = self.first_answer.zip(self.last_answer);
        let hz = times.and_then(|((first_at, first_count), last_at)| {
            mean_rate(self.answered - first_count, (last_at - first_at).seconds())
        });
        hz.map_or_else(String::new, |hz| format!(", {} answers/s", rate(hz)))
    }
}

impl ServeObserver {
    pub(super) fn new(model: Slug, arguments: &Arguments, clock: SharedClock) -> Self {
        Self {
            model,
            answers: AnswerCounts::new(arguments.iterations.get()),
            progress: Progress::new(arguments.quiet, clock.mono()),
            clock,
            inference: String::new(),
            sessions: 0,
            loading: Loading::NotStarted,
        }
    }

    /// Returns whether there was an answer.
    pub(super) const fn has_answers(&self) -> bool {
        self.answers.answered > 0
    }

    /// Describes the result.
    pub(super) fn summary(&self) -> String {
        let Self { answers, inference, .. } = self;
        let (count, rate) = (counted(answers.answered, "answer"), answers.describe_rate());
        format!("{count}{}{}{rate}{inference}", answers.describe_errors(), answers.describe_missed())
    }

    /// Describes the answers that are missing when no more will come; `None` if none is missing.
    pub(super) fn shortfall(&self) -> Option<String> {
        let AnswerCounts { target, answered, .. } = self.answers;
        let missing = target.saturating_sub(answered);
        let advice = "the clients' results say why";
        (missing > 0)
            .then(|| format!("{missing} of {} did not arrive here: {advice}", counted(target, "iteration")))
    }

    /// Starts to load the model in the first call, and checks in later calls whether the model is loaded. Returns the
    /// end of the agent if the model cannot be loaded. The model is loaded before the first request, so that errors
    /// show immediately and no client waits for the model.
    fn poll_loading(&mut self, running: &RunningAgent) -> Option<AgentEnd<LoadError>> {
        match &mut self.loading {
            Loading::NotStarted => {
                self.loading = Loading::InProgress(running.load_model(&self.model));
                None
            }
            Loading::InProgress(loading) => {
                let result = loading.now_or_never()?;
                self.loading = Loading::Done;
                match result {
                    Ok(Ok(())) => {
                        let addresses = running
                            .serve_addresses()
                            .iter()
                            .map(ToString::to_string)
                            .collect::<Vec<_>>()
                            .join(", ");
                        self.progress.print_line(format_args!(
                            "serving {} on all interfaces at {addresses}; ends after {} answers or with Ctrl-C",
                            self.model, self.answers.target
                        ));
                        None
                    }
                    Ok(Err(error)) => Some(AgentEnd::OwnReason(error)),
                    Err(_) => Some(AgentEnd::Failed("loading the model panicked".to_owned())),
                }
            }
            Loading::Done => None,
        }
    }

    /// Describes the state. Also returns the fraction of the answers that are given.
    fn describe(&self) -> (String, f64) {
        let AnswerCounts { target, answered, .. } = self.answers;
        let fraction_done = answered as f64 / target as f64;
        let text = match (&self.loading, self.sessions, answered) {
            (Loading::NotStarted | Loading::InProgress(_), ..) => format!("loading {}", self.model),
            (Loading::Done, 0, 0) => "waiting for a client".to_owned(),
            (Loading::Done, sessions, answered) => {
                let rate = self.answers.describe_rate();
                let clients = match sessions {
                    0 => "no client".to_owned(),
                    1 => "1 session".to_owned(),
                    many => format!("{many} sessions"),
                };
                let (errors, missed) = (self.answers.describe_errors(), self.answers.describe_missed());
                let inference = &self.inference;
                format!("{answered} of {target} answers{errors}{missed}, {clients}{rate}{inference}")
            }
        };
        (text, fraction_done)
    }
}

impl RunObserver for ServeObserver {
    /// The model cannot be loaded.
    type OwnReason = LoadError;

    fn handle_event(
        &mut self,
        _event: Event,
        _running: Option<&RunningAgent>,
    ) -> Option<AgentEnd<LoadError>> {
        None
    }

    fn poll_state(&mut self, running: &RunningAgent) -> Option<AgentEnd<LoadError>> {
        // The observer does not wait for the model, so that signals are handled while a large model is loaded.
        if let Some(end) = self.poll_loading(running) {
            return Some(end);
        }
        let served = running.served_counts().borrow().clone();
        let inference =
            served.inference.quantile(0.5).map(|p50| describe_quantiles(p50, served.inference.p99()));
        self.inference = inference.map_or_else(String::new, |quantiles| format!(", inference {quantiles}"));
        self.sessions = served.sessions;
        let now = self.clock.mono();
        self.answers.update(served.answers, served.errors, served.missed, now);
        let (state, no_trouble) = (self.describe(), None);
        self.progress.show(now, no_trouble, || state);
        self.answers.are_complete().then_some(AgentEnd::Finished)
    }

    fn end_decided(&mut self) {
        self.progress.end();
    }
}
