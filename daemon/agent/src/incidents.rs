//! Writes incidents to the log and queues them for the aggregator.

use peernet_clock::{SharedClock, Span};
use peernet_logger::{HostId, RunId, Slug};
use peernet_stream::{Event, Incident, IncidentKind};

use crate::event_queue::EventQueue;

/// Formats the size of a clock step without its sign: in seconds with three decimals, or in a smaller unit if it is
/// below one millisecond.
pub(crate) fn format_step_size(step: Span) -> String {
    let size = step.abs();
    if size < Span::from_millis(1) { size.to_string() } else { format!("{:.3} s", size.seconds()) }
}

/// Log target of remarks about connections. The command `peernet` shows the lines of this target on the terminal.
pub const REMARK_LOG_TARGET: &str = "peernet_agent::remarks";

/// Logs a remark about a limitation of a connection, with the target [`REMARK_LOG_TARGET`].
pub(crate) fn remark(text: &str) {
    tracing::warn!(target: REMARK_LOG_TARGET, "{text}");
}

/// Reports incidents to the log and to the event queue.
#[derive(Clone, Debug)]
pub(crate) struct Incidents {
    clock: SharedClock,
    event_queue: EventQueue,
}

/// The pipeline, run and peer that an incident concerns.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct IncidentSubject<'a> {
    pub(crate) pipeline: Option<&'a Slug>,
    pub(crate) run: Option<RunId>,
    pub(crate) peer: Option<HostId>,
}

impl Incidents {
    pub(crate) const fn new(clock: SharedClock, event_queue: EventQueue) -> Self {
        Self { clock, event_queue }
    }

    /// Logs an incident as a warning and queues it. A kind that needs no attention is logged at level info. `text` is
    /// one sentence for people.
    pub(crate) fn report(&self, kind: IncidentKind, subject: IncidentSubject<'_>, text: String) {
        match kind {
            IncidentKind::Connected
            | IncidentKind::ModelLoaded
            | IncidentKind::ModelUnloaded
            | IncidentKind::Control => {
                self.report_info(kind, subject, text);
            }
            _ => {
                let pipeline = subject.pipeline.map_or("-", Slug::as_str);
                tracing::warn!(%kind, pipeline, "{text}");
                self.enqueue(kind, subject, text);
            }
        }
    }

    /// Reports a limitation of a connection as an incident. The limitation is logged with the target
    /// [`REMARK_LOG_TARGET`].
    pub(crate) fn remark(&self, kind: IncidentKind, subject: IncidentSubject<'_>, text: String) {
        remark(&text);
        self.enqueue(kind, subject, text);
    }

    /// Logs an incident of any kind at level info, and queues it.
    pub(crate) fn report_info(&self, kind: IncidentKind, subject: IncidentSubject<'_>, text: String) {
        let pipeline = subject.pipeline.map_or("-", Slug::as_str);
        tracing::info!(%kind, pipeline, "{text}");
        self.enqueue(kind, subject, text);
    }

    /// Queues an incident for the aggregator, without logging it.
    fn enqueue(&self, kind: IncidentKind, subject: IncidentSubject<'_>, text: String) {
        let incident = Incident {
            at: self.clock.wall(),
            kind,
            pipeline: subject.pipeline.cloned(),
            run: subject.run,
            peer: subject.peer,
            text,
        };
        self.event_queue.push_event(subject.pipeline, Event::Incident(incident));
    }
}
