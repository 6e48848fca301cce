//! How far the sweep is.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use peernet_clock::{Direction, MonoTime};
use peernet_report::calibration::Sample;
use peernet_report::number::{bytes, milliseconds};
use peernet_report::order::Ordered;
use peernetd::output::complain;

use super::plan::Plan;

/// Seconds between two lines where there is no terminal.
const LINE_S: f64 = 5.0;
/// Steps of the bar.
const STEPS: u64 = 1000;

/// Shows how far the sweep is: a bar on a terminal, now and then a line elsewhere.
pub(super) struct Progress {
    shown: Shown,
    iterations: u64,
    seconds: f64,
    extremes: (u64, u64),
    began: MonoTime,
    said: f64,
    /// Whether it waited for something at the last look.
    troubled: bool,
}

enum Shown {
    Bar(ProgressBar),
    Lines,
    Nothing,
}

impl Progress {
    pub(super) fn new(plan: &Plan, quiet: bool, now: MonoTime) -> Self {
        let shown = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Shown::Nothing,
            (false, false) => Shown::Lines,
            (false, true) => {
                let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
                let style = ProgressStyle::with_template("{wide_bar} {msg}");
                Shown::Bar(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())))
            }
        };
        let sizes = plan.sizes();
        let extremes =
            (sizes.first().copied().unwrap_or_default(), sizes.last().copied().unwrap_or_default());
        Self {
            shown,
            iterations: plan.all(),
            seconds: plan.seconds,
            extremes,
            began: now,
            said: 0.0,
            troubled: false,
        }
    }

    /// The first iteration is under way.
    pub(super) fn begin(&mut self, now: MonoTime) {
        self.began = now;
    }

    /// Shows the state at `now`, or in its place what it waits for.
    pub(super) fn show(&mut self, samples: &[Sample], now: MonoTime, trouble: Option<String>) {
        let elapsed = (now - self.began).seconds();
        let is_news = trouble.is_some() && !self.troubled;
        self.troubled = trouble.is_some();
        match &self.shown {
            Shown::Nothing => {}
            Shown::Bar(bar) => {
                let (text, share) = self.describe(samples, elapsed);
                let text = trouble.unwrap_or(text);
                bar.set_position((share * STEPS as f64) as u64);
                bar.set_message(text);
            }
            Shown::Lines if elapsed - self.said < LINE_S && !is_news => {}
            Shown::Lines => {
                complain(trouble.unwrap_or_else(|| self.describe(samples, elapsed).0));
                self.said = elapsed;
            }
        }
    }

    /// Takes the bar away.
    pub(super) fn end(&self) {
        if let Shown::Bar(bar) = &self.shown {
            bar.finish_and_clear();
        }
    }

    /// In words, and how much of the whole is done.
    fn describe(&self, samples: &[Sample], elapsed: f64) -> (String, f64) {
        let done = samples.len() as f64;
        let share = (done / self.iterations as f64).max(elapsed / self.seconds).clamp(0.0, 1.0);
        let left = if share > 0.0 { elapsed * (1.0 - share) / share } else { self.seconds };
        let rate = if elapsed > 0.0 { done / elapsed } else { 0.0 };
        let (smallest, largest) = self.extremes;
        let text = format!(
            "{done} of {}, {rate:.0} /s, upload {} at {}, {} at {}, {left:.0} s left",
            self.iterations,
            median(samples, smallest),
            bytes(smallest as f64),
            median(samples, largest),
            bytes(largest as f64),
        );
        (text, share)
    }
}

/// The median delay of one payload's uploads so far.
fn median(samples: &[Sample], payload_bytes: u64) -> String {
    let delays = samples.iter().filter(|sample| sample.payload_bytes == payload_bytes);
    let delays: Ordered = delays.filter_map(|sample| sample.passage(Direction::Up)?.seconds()).collect();
    delays.median().map_or_else(|| "—".to_owned(), |median| format!("{} ms", milliseconds(median)))
}
