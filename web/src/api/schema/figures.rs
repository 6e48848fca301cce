//! Figures, bounds, counts and placements.

use peernet_logger::Name;
use peernet_store as store;
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

/// Statistics of one quantity, in its SI unit. Quantiles are within 1 % of the true ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Figures {
    /// Samples.
    pub count: u64,
    pub mean: f64,
    /// Sample standard deviation; null below two samples.
    pub std: Option<f64>,
    pub min: f64,
    pub p50: f64,
    /// Null below 60 samples.
    pub p95: Option<f64>,
    /// Null below 300 samples.
    pub p99: Option<f64>,
    pub max: f64,
}

impl From<store::Figures> for Figures {
    fn from(figures: store::Figures) -> Self {
        let store::Figures { count, mean, std, min, p50, p95, p99, max } = figures;
        Self { count, mean, std, min, p50, p95, p99, max }
    }
}

/// Statistics of one node name.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct NodeFigures {
    /// A stage, `total`, `upload-throughput` and so on, or a name of the user's own.
    pub name: String,
    #[serde(flatten)]
    pub figures: Figures,
}

impl NodeFigures {
    pub(crate) fn all(values: &[(Name, store::Figures)]) -> Vec<Self> {
        values
            .iter()
            .map(|(name, figures)| Self { name: name.to_string(), figures: (*figures).into() })
            .collect()
    }
}

/// How well the one-way delays of one direction are known.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Bound {
    /// `upload` or `download`.
    pub stage: String,
    /// Half the width of the interval that contains the delay, seconds; null when no delay had one.
    pub half_width: Option<Figures>,
    pub verdicts: Vec<VerdictCount>,
}

/// How often a verdict was given.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct VerdictCount {
    /// `ok`, `limited`, `stale`, `unsynchronised`, `stepped` or `inconsistent`.
    pub verdict: &'static str,
    pub count: u64,
}

impl From<&store::Bound> for Bound {
    fn from(bound: &store::Bound) -> Self {
        let verdicts = bound.verdicts.iter();
        Self {
            stage: bound.stage.to_string(),
            half_width: bound.half_width.map(Figures::from),
            verdicts: verdicts
                .map(|(verdict, count)| VerdictCount { verdict: verdict.name(), count: *count })
                .collect(),
        }
    }
}

/// Iterations by outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Counts {
    pub ok: u64,
    /// The sample or the model failed.
    pub failed: u64,
    /// The connection broke.
    pub lost: u64,
    /// No answer in time.
    pub timeout: u64,
}

impl From<stream::OutcomeCounts> for Counts {
    fn from(counts: stream::OutcomeCounts) -> Self {
        let stream::OutcomeCounts { ok, failed, lost, timeout } = counts;
        Self { ok, failed, lost, timeout }
    }
}

/// Where a pipeline computes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Placement {
    /// `local`, `remote`, or `none` for a sensor alone.
    pub kind: &'static str,
    /// Name of the serving host.
    pub peer: Option<String>,
    /// Kind of network, such as `zmq-tcp`.
    pub network: Option<String>,
    pub address: Option<String>,
    pub model: String,
    pub device: Option<String>,
}

impl From<&stream::Placement> for Placement {
    fn from(placement: &stream::Placement) -> Self {
        let kind = match placement.kind {
            stream::PlacementKind::Local => "local",
            stream::PlacementKind::Remote => "remote",
            stream::PlacementKind::None => "none",
        };
        Self {
            kind,
            peer: placement.peer.as_ref().map(ToString::to_string),
            network: placement.network.clone(),
            address: placement.address.clone(),
            model: placement.model.to_string(),
            device: placement.device.clone(),
        }
    }
}
