//! Texts about the placement of a pipeline.

use peernet_aggregator::Window;
use peernet_logger::stage;
use peernet_statistics::number::bytes;
use peernet_store::RunSummary;
use peernet_stream::{Placement, PlacementKind};

/// Text in the place of model and network, for a pipeline that only senses.
const SENSOR_ONLY: &str = "sensor alone";

/// Returns the hosts of a pipeline: `cam-2 → rack-a`, or `cam-1` if the edge computes. A cloud without a known name is
/// shown by its address.
pub(crate) fn route(host: &str, placement: &Placement) -> String {
    match (placement.kind, &placement.peer, &placement.address) {
        (PlacementKind::Local | PlacementKind::None, ..) => host.to_owned(),
        (PlacementKind::Remote, Some(peer), _) => format!("{host} → {peer}"),
        (PlacementKind::Remote, None, Some(address)) => format!("{host} → {address}"),
        (PlacementKind::Remote, None, None) => format!("{host} → ?"),
    }
}

/// Returns the model of a local pipeline, or network and mean payload of a remote pipeline: `resnet on board`,
/// `zmq-tcp · 1.23 MB`. The model replaces a payload that is not known.
pub(crate) fn details(placement: &Placement, window: Option<&Window>) -> String {
    match placement.kind {
        PlacementKind::Local => format!("{} on board", placement.model),
        PlacementKind::None => SENSOR_ONLY.to_owned(),
        PlacementKind::Remote => {
            let network = placement.network.as_deref().unwrap_or("network unknown");
            match window.and_then(|window| window.value(&stage::UPLOAD_BYTES)) {
                Some(size) => format!("{network} · {}", bytes(size.mean)),
                None => format!("{network} · {}", placement.model),
            }
        }
    }
}

/// Returns the model with its device: `quality-control, cpu`.
pub(crate) fn model(placement: &Placement) -> String {
    match &placement.device {
        _ if placement.kind == PlacementKind::None => SENSOR_ONLY.to_owned(),
        Some(device) => format!("{}, {device}", placement.model),
        None => placement.model.to_string(),
    }
}

/// Returns the address of a pipeline's page.
pub(crate) fn pipeline_href(host: &str, pipeline: &str) -> String {
    format!("/pipelines/{host}/{pipeline}")
}

/// Returns a run's name for people: `offload-resized #412`.
pub(crate) fn run_name(run: &RunSummary) -> String {
    format!("{} #{}", run.pipeline, run.number)
}
