//! Writes incidents to the log and queues them for the aggregator.

use peernet_clock::{SharedClock, Span};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{Event, Incident, IncidentKind};

use crate::event_queue::EventQueue;

/// Formats how far a clock was set, without its sign: in seconds with milliseconds, and below a millisecond in the
/// unit that fits.
pub(crate) fn step_size_text(by: Span) -> String {
    let far = by.abs();
    if far < Span::from_millis(1) { far.to_string() } else { format!("{:.3} s", far.seconds()) }
}

/// Log target of remarks about connections. The command `peernet` shows the lines of this target on the terminal.
pub const REMARKS: &str = "peernet_agent::remarks";

/// Logs something that makes a connection worse than it could be, with the target [`REMARKS`].
pub(crate) fn remark(text: &str) {
    tracing::warn!(target: REMARKS, "{text}");
}

/// Reports incidents to the log and to the event queue.
#[derive(Clone, Debug)]
pub(crate) struct Incidents {
    clock: SharedClock,
    event_queue: EventQueue,
}

/// The pipeline, run and peer that an incident concerns.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct IncidentContext<'a> {
    pub(crate) pipeline: Option<&'a Slug>,
    pub(crate) run: Option<RunId>,
    pub(crate) peer: Option<HostId>,
}

impl Incidents {
    pub(crate) const fn new(clock: SharedClock, event_queue: EventQueue) -> Self {
        Self { clock, event_queue }
    }

    /// Logs an incident as a warning and queues it; a kind that needs no attention is logged as [`note`](Self::note)
    /// does. `text` is one sentence for people.
    pub(crate) fn report(&self, kind: IncidentKind, what: IncidentContext<'_>, text: String) {
        match kind {
            IncidentKind::Connected | IncidentKind::ModelLoaded | IncidentKind::Control => {
                self.note(kind, what, text);
            }
            _ => {
                let pipeline = what.pipeline.map_or("-", Slug::as_str);
                tracing::warn!(%kind, pipeline, "{text}");
                self.enqueue(kind, what, text);
            }
        }
    }

    /// Reports an incident that makes a connection worse than it could be, with the target [`REMARKS`].
    pub(crate) fn remark(&self, kind: IncidentKind, what: IncidentContext<'_>, text: String) {
        remark(&text);
        self.enqueue(kind, what, text);
    }

    /// Reports an incident that needs no attention, whatever its kind; it is logged at level info.
    pub(crate) fn note(&self, kind: IncidentKind, what: IncidentContext<'_>, text: String) {
        let pipeline = what.pipeline.map_or("-", Slug::as_str);
        tracing::info!(%kind, pipeline, "{text}");
        self.enqueue(kind, what, text);
    }

    fn enqueue(&self, kind: IncidentKind, what: IncidentContext<'_>, text: String) {
        let incident = Incident {
            at: self.clock.wall(),
            kind,
            pipeline: what.pipeline.cloned(),
            run: what.run,
            peer: what.peer,
            text,
        };
        self.event_queue.event(what.pipeline, Event::Incident(incident));
    }
}
