//! The health of the system in sentences: the title of the overview and the notes under it.

use peernet_aggregator::{LiveState, PipelineSnapshot};
use peernet_analysis::trust::NOTABLE_SHARE;
use peernet_clock::WallTime;
use peernet_logger::Name;
use peernet_statistics::number::{count, counted, percent};
use peernet_stream::PipelineState;

use super::chip::{Chip, Tone};
use super::notes::Note;
use super::pipeline_table::{state_chip, state_reason};
use super::{hosts, link, place, startup, warnings};
use crate::config::WarnConfig;
use crate::zone::Zone;

/// Maximum number of notes that are shown. Of further notes only the number is shown.
const MAX_NOTES: usize = 5;

/// Title and notes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Health {
    pub title: String,
    /// The title in the past tense, for when the connection is lost.
    pub past_title: String,
    /// `true` if known agents may still reconnect after a restart of the aggregator.
    pub is_starting: bool,
    pub notes: Vec<Note>,
    /// Text such as `and 55 more` after the notes; `None` if all notes are shown.
    pub hidden_notes: Option<String>,
}

impl Health {
    /// Returns the health of the system. `since` is the time at which this server started.
    pub(crate) fn of(snapshot: &LiveState, zone: Zone, since: WallTime, warn: &WarnConfig) -> Self {
        let mut notes = Vec::new();
        notes.extend(snapshot.refused.iter().map(|refused| Note {
            chip: Chip::new(Tone::Bad, "unsynchronised", "refused"),
            subject: refused.name.to_string(),
            href: "/hosts".to_owned(),
            text: format!("was refused at {}: {}", zone.moment(refused.at).time_of_day(), refused.reason),
            link: None,
        }));
        notes.extend(snapshot.hosts.iter().flat_map(|host| hosts::notes(host, snapshot.at, zone, warn)));
        notes.extend(snapshot.pipelines.iter().flat_map(|pipeline| pipeline_notes(pipeline, snapshot, warn)));
        // The most severe notes come first. The sort is stable, so notes of the same severity keep their order.
        notes.sort_by_key(|note| std::cmp::Reverse(note.chip.tone));

        let running = snapshot.pipelines.iter().filter(|one| one.state == PipelineState::Running).count();
        let subject = match running {
            0 => "No pipeline".to_owned(),
            _ => counted(running as u64, "pipeline"),
        };
        // `2 pipelines running`, but `No pipeline is running`.
        let (present_verb, past_verb) = if running > 1 {
            ("", "were ")
        } else if running == 1 {
            ("", "was ")
        } else {
            ("is ", "was ")
        };
        let rest = match notes.len() {
            0 => String::new(),
            many => format!(", {} to look at", count(many as u64)),
        };
        let is_starting = startup::is_waiting_for_agents(snapshot, since);
        let hidden_notes = notes.len().saturating_sub(MAX_NOTES);
        let hidden_notes = (hidden_notes > 0).then(|| format!("and {} more", count(hidden_notes as u64)));
        notes.truncate(MAX_NOTES);
        Self {
            title: if is_starting {
                format!("{}{rest}", startup::WAITING)
            } else {
                format!("{subject} {present_verb}running{rest}")
            },
            past_title: if is_starting {
                "No agent had reported".to_owned()
            } else {
                format!("{subject} {past_verb}running")
            },
            is_starting,
            notes,
            hidden_notes,
        }
    }
}

fn pipeline_notes(pipeline: &PipelineSnapshot, snapshot: &LiveState, warn: &WarnConfig) -> Vec<Note> {
    let subject = pipeline.pipeline.to_string();
    let href = place::pipeline_href(pipeline.host_name.as_str(), &subject);
    let note = |chip, text| Note { chip, subject: subject.clone(), href: href.clone(), text, link: None };
    let mut notes = Vec::new();
    notes.extend(
        state_chip(&pipeline.state).zip(state_reason(&pipeline.state)).map(|(chip, text)| note(chip, text)),
    );
    // The figures of a pipeline that does not run are not current, so they cause no notes.
    if pipeline.state != PipelineState::Running {
        return notes;
    }
    let Some(window) = pipeline.window(60) else { return notes };
    if let Some(failed) = window.failed_fraction.filter(|failed| *failed > NOTABLE_SHARE) {
        let text = format!("failed in {}\u{202f}% of the iterations of the last minute.", percent(failed));
        notes.push(note(Chip::new(Tone::Warn, "gap", "losses"), text));
    }
    notes.extend(warnings::pipeline_warnings(window, warn).into_iter().map(|(chip, text)| note(chip, text)));
    let link = link::href_of_placement(snapshot, pipeline.host_name.as_str(), &pipeline.placement);
    let value = |name: &Name| window.value(name).copied();
    notes.extend(Note::delay_notes(&subject, &href, link.as_deref(), &window.bounds, value));
    notes
}
