//! Schema of statistics of nodes, of bounds, counts and placements.

use peernet_logger::Name;
use peernet_store::{self as store, QuantityStatistics};
use peernet_stream as stream;
use serde::Serialize;
use utoipa::ToSchema;

/// Statistics of one node name.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct NodeFigures {
    /// Name of a node: a stage, `total`, `upload-throughput` or another standard name, or a user-defined one.
    /// A throughput is the ratio of bits to time in one iteration. The mean of these ratios is not the speed over all
    /// iterations.
    pub name: String,
    #[serde(flatten)]
    pub statistics: QuantityStatistics,
}

impl NodeFigures {
    pub(crate) fn from_values(values: &[(Name, QuantityStatistics)]) -> Vec<Self> {
        values
            .iter()
            .map(|(name, statistics)| Self { name: name.to_string(), statistics: *statistics })
            .collect()
    }
}

/// Accuracy of the one-way delays in a direction.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Bound {
    /// `upload` or `download`.
    pub stage: String,
    /// Half the width of the interval that contains the delay, seconds; null if no delay had an interval.
    pub half_width: Option<QuantityStatistics>,
    pub verdicts: Vec<VerdictCount>,
}

/// Number of delays with a verdict.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct VerdictCount {
    /// `ok`, `limited`, `stale`, `unsynchronised`, `stepped` or `inconsistent`.
    pub verdict: &'static str,
    pub count: u64,
}

impl From<&store::DelayAccuracy> for Bound {
    fn from(bound: &store::DelayAccuracy) -> Self {
        let verdicts = bound.verdicts.iter();
        Self {
            stage: bound.stage.to_string(),
            half_width: bound.half_width,
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
    /// Number of iterations whose sample, model or actuator failed.
    pub failed: u64,
    /// Number of iterations whose connection broke.
    pub lost: u64,
    /// Number of iterations without an answer in time.
    pub timeout: u64,
}

impl From<stream::OutcomeCounts> for Counts {
    fn from(counts: stream::OutcomeCounts) -> Self {
        let stream::OutcomeCounts { ok, failed, lost, timeout } = counts;
        Self { ok, failed, lost, timeout }
    }
}

/// Placement of a pipeline: local or on a cloud over a network, and the model.
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
        Self {
            kind: placement.kind.name(),
            peer: placement.peer.as_ref().map(ToString::to_string),
            network: placement.network.clone(),
            address: placement.address.clone(),
            model: placement.model.to_string(),
            device: placement.device.clone(),
        }
    }
}
