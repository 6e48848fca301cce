//! Chips: an icon (sign) and a word for a verdict or a state. The icon and the word say everything that the colour
//! says.

use askama::Template;
use peernet_clock::Verdict;

/// Severity of a state, from the least to the most severe: pages sort by this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Tone {
    /// Good state.
    Ok,
    /// State that is neither good nor bad.
    Quiet,
    /// State that needs attention.
    Warn,
    /// Bad state.
    Bad,
}

impl Tone {
    /// Returns the CSS class that gives the tone its colour.
    pub(crate) const fn class(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Quiet => "quiet",
            Self::Warn => "warn",
            Self::Bad => "bad",
        }
    }
}

/// Verdict or state, as shown in tables and notes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Template)]
#[template(
    ext = "html",
    source = r##"<span class="chip {{ tone.class() }}"><svg aria-hidden="true"><use href="#i-{{ sign }}"/></svg>{{ word }}</span>"##
)]
pub(crate) struct Chip {
    pub tone: Tone,
    /// Name of the icon.
    pub sign: &'static str,
    pub word: &'static str,
}

impl askama::filters::HtmlSafe for Chip {}

impl Chip {
    pub(crate) const fn new(tone: Tone, sign: &'static str, word: &'static str) -> Self {
        Self { tone, sign, word }
    }

    /// Returns the chip of a verdict.
    pub(crate) const fn verdict(verdict: Verdict) -> Self {
        let tone = match verdict {
            Verdict::Ok => Tone::Ok,
            Verdict::Limited | Verdict::Stale | Verdict::Stepped => Tone::Warn,
            Verdict::Unsynchronised | Verdict::Inconsistent => Tone::Bad,
        };
        Self::new(tone, verdict.name(), verdict.name())
    }
}

/// The icon of a chip without the word, for narrow columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Template)]
#[template(
    ext = "html",
    source = r##"<svg class="vi {{ chip.tone.class() }}" role="img" aria-label="{{ chip.word }}"><use href="#i-{{ chip.sign }}"/></svg>"##
)]
pub(crate) struct Sign {
    chip: Chip,
}

impl askama::filters::HtmlSafe for Sign {}

impl From<Chip> for Sign {
    fn from(chip: Chip) -> Self {
        Self { chip }
    }
}
