//! One-way delays of a run, recomputed with the exchanges that came after them.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_store::{self as store, QuantityStatistics};
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::schema::VerdictCount;
use crate::error::{ProblemDetails, WebError};
use crate::parameters::path;
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(recomputed))
}

/// The one-way delays of a run as computed during the run, and as recomputed from all exchanges, including later ones.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Recomputed {
    pub run: i64,
    /// Number of stored clock samples that were used.
    pub samples: u64,
    /// Clocks whose stamps the recomputation used: `raw`, `raw-to-wall` (the free-running clock of the edge, the wall clock of the cloud), or
    /// `wall` for runs that were recorded before release 0.3.0, whose delays depend on steps and slews of wall clocks. Empty if no delay was
    /// recomputed.
    pub clocks: Vec<&'static str>,
    /// The stages `upload` and `download`.
    pub stages: Vec<RecomputedStage>,
}

/// One direction, before and after the recomputation. Successful iterations only, warm-up left out.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct RecomputedStage {
    pub stage: String,
    /// Result that was stored during the run.
    pub before: Judgement,
    /// Recomputed result.
    pub after: Judgement,
}

/// Statistics of delays and of their accuracy, judged at one time.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct Judgement {
    /// Delays that have a value, seconds.
    pub delay: Option<QuantityStatistics>,
    /// Half widths of the bounds of the delays, seconds.
    pub half_width: Option<QuantityStatistics>,
    pub verdicts: Vec<VerdictCount>,
}

impl From<&store::Judgement> for Judgement {
    fn from(judgement: &store::Judgement) -> Self {
        let verdicts = judgement.verdicts.iter();
        Self {
            delay: judgement.delay,
            half_width: judgement.half_width,
            verdicts: verdicts
                .map(|(verdict, count)| VerdictCount { verdict: verdict.name(), count: *count })
                .collect(),
        }
    }
}

impl From<&store::RecomputedDelays> for Recomputed {
    fn from(recomputed: &store::RecomputedDelays) -> Self {
        let stages = recomputed.stages.iter().map(|stage| RecomputedStage {
            stage: stage.stage.to_string(),
            before: Judgement::from(&stage.before),
            after: Judgement::from(&stage.after),
        });
        let clocks = recomputed.clocks.iter().map(|clocks| clocks.name()).collect();
        Self { run: recomputed.number, samples: recomputed.samples, clocks, stages: stages.collect() }
    }
}

/// One-way delays of a run as computed during the run, and recomputed with the exchanges that came after them. The stamps do not
/// change.
#[utoipa::path(get, path = "/api/v1/runs/{run}/recomputed", operation_id = "getRunRecomputed", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = Recomputed),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn recomputed(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<Recomputed>, WebError> {
    let number = path(number)?;
    let recomputed = app.store().recompute(number).await?.ok_or_else(|| WebError::no_run(number))?;
    Ok(Json(Recomputed::from(&recomputed)))
}
