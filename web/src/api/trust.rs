//! `GET /api/v1/runs/{run}/trust`: whether a run can be published.

use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use peernet_analysis::trust::{Finding, Report};
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::schema::grade_name;
use crate::error::{ProblemDetails, WebError};
use crate::parameters::path;
use crate::state::App;

/// Returns the operations of this resource.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get))
}

/// Whether a run can be published, with the findings from before, during and after the run, the most harmful first.
#[utoipa::path(get, path = "/api/v1/runs/{run}/trust", operation_id = "getRunTrust", tag = "runs", params(("run" = i64, Path)), responses(
    (status = 200, body = Trust),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
async fn get(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
) -> Result<Json<Trust>, WebError> {
    let number = path(number)?;
    let store = app.store();
    let run = store.run(number).await?.ok_or_else(|| WebError::no_run(number))?;
    Ok(Json(Trust::from(&Report::new(&store.trust_input(&run).await?))))
}

/// Whether a run can be published.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Trust {
    /// `yes`, `with-remarks` or `no`.
    pub verdict: &'static str,
    /// The answer in a sentence.
    pub answer: String,
    /// Findings, the most harmful first.
    pub sentences: Vec<Sentence>,
}

/// One finding about a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Sentence {
    /// Subject of the finding.
    pub about: String,
    /// `good`, `unknown`, `doubtful` or `bad`.
    pub grade: &'static str,
    pub text: String,
    /// Advice on what to do; may be empty.
    pub advice: String,
}

impl From<&Report> for Trust {
    fn from(report: &Report) -> Self {
        let sentence = |finding: &Finding| Sentence {
            about: finding.about.clone(),
            grade: grade_name(finding.grade),
            text: finding.text.clone(),
            advice: finding.advice.clone(),
        };
        Self {
            verdict: report.verdict.name(),
            answer: report.answer(),
            sentences: report.findings.iter().map(sentence).collect(),
        }
    }
}
