//! Incidents in a list.

use peernet_store::IncidentRow;

use super::chip::Tone;
use crate::zone::{Zone, ZonedTime};

/// One incident.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct IncidentLine {
    pub at: ZonedTime,
    pub kind: String,
    /// Name of the icon.
    pub sign: &'static str,
    pub tone: Tone,
    /// The reporting host; `None` for an incident of the aggregator.
    pub host: Option<String>,
    pub text: String,
    pub run: Option<i64>,
}

impl IncidentLine {
    pub(crate) fn new(row: &IncidentRow, zone: Zone) -> Self {
        let (sign, tone) = match row.kind.as_str() {
            "disconnected" => ("gap", Tone::Warn),
            "connected" => ("reconnect", Tone::Quiet),
            "refused" => ("unsynchronised", Tone::Bad),
            "model-loaded" | "model-unloaded" => ("model", Tone::Quiet),
            "clock-step" => ("stepped", Tone::Warn),
            "gap" => ("gap", Tone::Warn),
            "pipeline-failed" => ("failed", Tone::Bad),
            "storage" => ("failed", Tone::Bad),
            "retention" => ("run", Tone::Warn),
            _ => ("run", Tone::Quiet),
        };
        Self {
            at: zone.moment(row.at),
            kind: row.kind.replace('-', " "),
            sign,
            tone,
            host: row.host_name.as_ref().map(ToString::to_string),
            text: row.text.clone(),
            run: row.run,
        }
    }

    /// Returns the name of the reporter of the incident.
    pub(crate) fn reporter(&self) -> &str {
        self.host.as_deref().unwrap_or("aggregator")
    }

    /// Converts all rows of a list.
    pub(crate) fn all(rows: &[IncidentRow], zone: Zone) -> Vec<Self> {
        rows.iter().map(|row| Self::new(row, zone)).collect()
    }
}
