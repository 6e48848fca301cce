//! Display of progress: a bar on a terminal, otherwise a line every few seconds.

use std::fmt::Display;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};

use crate::output::print_to_stderr;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use peernet_clock::{MonoTime, Span};
use peernet_sample::{printable_line, printable_lines};

/// Time between two lines if standard error is not a terminal.
const LINE_INTERVAL: Span = Span::from_seconds(5);
/// Number of steps of the bar.
const STEPS: u64 = 1000;

/// The bar on the terminal. It is global, because the log writes to the same terminal and must hide the bar.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Writes to standard error with the bar hidden, if there is one.
pub(super) fn without_progress_bar<T>(write: impl FnOnce() -> T) -> T {
    let bar = BAR.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Display of progress on standard error.
pub(crate) struct Progress {
    display: DisplayKind,
    /// Time of the last printed line, or of the start.
    printed_at: MonoTime,
    /// `true` if there was trouble at the last update.
    has_trouble: bool,
    /// Last printed reason of trouble.
    last_reason: Option<String>,
    /// `true` once [`print_once`](Self::print_once) has printed its line.
    has_printed_once: bool,
}

enum DisplayKind {
    Bar(ProgressBar),
    Lines,
    Nothing,
}

impl Progress {
    /// Creates a display at 0 %.
    pub(crate) fn new(quiet: bool, now: MonoTime) -> Self {
        let display = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => DisplayKind::Nothing,
            (false, false) => DisplayKind::Lines,
            (false, true) => {
                let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
                let style = ProgressStyle::with_template("{wide_bar} {msg}");
                let bar = bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
                BAR.lock().unwrap_or_else(PoisonError::into_inner).replace(bar.clone());
                DisplayKind::Bar(bar)
            }
        };
        Self { display, printed_at: now, has_trouble: false, last_reason: None, has_printed_once: false }
    }

    /// Shows the text and the fraction done (0 to 1) that `state` returns. If there is `trouble`, `trouble` replaces
    /// the text.
    pub(crate) fn show(
        &mut self,
        now: MonoTime,
        trouble: Option<String>,
        state: impl FnOnce() -> (String, f64),
    ) {
        let is_new_trouble = trouble.is_some() && !self.has_trouble;
        self.has_trouble = trouble.is_some();
        match &self.display {
            DisplayKind::Nothing => {}
            DisplayKind::Bar(bar) => {
                let (text, fraction_done) = state();
                bar.set_position((fraction_done.clamp(0.0, 1.0) * STEPS as f64) as u64);
                bar.set_message(printable_line(&trouble.unwrap_or(text)).into_owned());
            }
            DisplayKind::Lines if now - self.printed_at < LINE_INTERVAL && !is_new_trouble => {}
            DisplayKind::Lines => {
                let trouble = trouble.map(|trouble| without_repeated_reason(trouble, &mut self.last_reason));
                print_to_stderr(printable_line(&trouble.unwrap_or_else(|| state().0)));
                self.printed_at = now;
            }
        }
    }

    /// Prints a line that stays visible. A bar stays below it.
    pub(crate) fn print_line(&self, text: impl Display) {
        let text = text.to_string();
        // Peers and custom code may have written parts of the text.
        let text = printable_lines(&text);
        match &self.display {
            DisplayKind::Bar(bar) => bar.suspend(|| print_to_stderr(text)),
            DisplayKind::Lines | DisplayKind::Nothing => print_to_stderr(text),
        }
    }

    /// Prints a line that stays visible. Only the first call prints a line.
    pub(crate) fn print_once(&mut self, text: impl Display) {
        if !std::mem::replace(&mut self.has_printed_once, true) {
            self.print_line(text);
        }
    }

    /// Removes the bar.
    pub(crate) fn end(&self) {
        if let DisplayKind::Bar(bar) = &self.display {
            bar.finish_and_clear();
            BAR.lock().unwrap_or_else(PoisonError::into_inner).take();
        }
    }
}

/// Removes the reason in brackets from the text if the last printed reason was the same, because printed lines stay
/// visible.
fn without_repeated_reason(trouble: String, last_reason: &mut Option<String>) -> String {
    let Some((problem, rest)) = trouble.split_once(" (") else { return trouble };
    let Some((reason, wait)) = rest.rsplit_once(");") else { return trouble };
    if last_reason.as_deref() == Some(reason) {
        return format!("{problem};{wait}");
    }
    *last_reason = Some(reason.to_owned());
    trouble
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_reason_is_printed_once() {
        let mut last_reason = None;
        let mut line = |reason: &str, wait: &str| {
            without_repeated_reason(format!("cloud is away ({reason}); waiting for {wait}"), &mut last_reason)
        };
        assert_eq!(
            line("refused (os error 111)", "it"),
            "cloud is away (refused (os error 111)); waiting for it"
        );
        assert_eq!(line("refused (os error 111)", "5 s"), "cloud is away; waiting for 5 s");
        assert_eq!(line("no room", "10 s"), "cloud is away (no room); waiting for 10 s");
        assert_eq!(without_repeated_reason("no answer".to_owned(), &mut last_reason), "no answer");
    }
}
