//! A run as a table.

use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::stream;
use peernet_aggregator::{IterationFilter, IterationRow};
use peernet_logger::{Name, stage};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::parameters::{Parameters, path};
use super::run::no_run;
use super::schema::{StageDelay, time};
use crate::error::{ProblemDetails, WebError};
use crate::state::App;

/// The stages that cross hosts, and what stands beside each: seconds and words.
const DIRECTIONS: [Name; 2] = [stage::UPLOAD, stage::DOWNLOAD];
const DELAY: [&str; 5] = ["lo", "hi", "verdict", "source", "raw"];
/// Iterations read and sent at a time.
const CHUNK: u32 = 1_000;

/// The form of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Format {
    /// Comma-separated values (RFC 4180), one row per iteration, times in seconds.
    #[default]
    Csv,
}

/// Which form.
#[derive(Clone, Copy, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields, default)]
#[into_params(parameter_in = Query)]
pub(crate) struct Query {
    /// `csv`, the only one so far.
    format: Format,
}

/// All iterations of a run as a table: one row each, one column per stage, in seconds. Of `upload` and `download` the
/// ends of the interval, the verdict, what it rests on and the raw difference of the stamps stand beside; `both-ways` is
/// their sum where one of them has no value of its own.
#[utoipa::path(get, path = "/api/v1/runs/{run}/export", operation_id = "exportRun", tag = "runs", params(("run" = i64, Path), Query), responses(
    (status = 200, body = String, content_type = "text/csv"),
    (status = "default", body = ProblemDetails, content_type = "application/problem+json"),
))]
pub(crate) async fn table(
    State(app): State<App>,
    number: Result<Path<i64>, PathRejection>,
    Parameters(Query { format: Format::Csv }): Parameters<Query>,
) -> Result<Response, WebError> {
    let number = path(number)?;
    let run = app.store().run(number).await?.ok_or_else(|| no_run(number))?;
    let name = format!("{}-{number}.csv", run.summary.pipeline);
    // One chunk at a time, made when the reader has taken the one before.
    let chunks = stream::try_unfold(Some(0u64), move |after| {
        let app = app.clone();
        async move {
            let Some(after) = after else { return Ok::<_, WebError>(None) };
            let filter = IterationFilter { after, limit: CHUNK, ..IterationFilter::default() };
            let rows = app.store().iterations(number, &filter).await?;
            let text =
                lines(&rows, after == 0).map_err(|error| WebError::Render(askama::Error::custom(error)))?;
            let next = rows.last().filter(|_| rows.len() == CHUNK as usize).map(|row| row.number);
            Ok(Some((Bytes::from(text), next)))
        }
    });
    let head = [
        (CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    Ok((head, Body::from_stream(chunks)).into_response())
}

/// Rows as text, below the names of the columns where they are the first.
fn lines(rows: &[IterationRow], first: bool) -> Result<Vec<u8>, csv::Error> {
    let mut writer = csv::WriterBuilder::new().from_writer(Vec::new());
    if first {
        let begin = ["iteration", "episode", "step", "warm-up", "outcome", "reason", "started", "total"];
        let stages = stage::ORDER.into_iter().map(|name| name.to_string());
        let delays = DIRECTIONS.into_iter().flat_map(|way| DELAY.map(|what| format!("{way}-{what}")));
        let end = ["both-ways", "unattributed"].map(str::to_owned);
        let begin = begin.into_iter().map(str::to_owned);
        writer.write_record(begin.chain(stages).chain(delays).chain(end))?;
    }
    for row in rows {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let mut record = vec![
            row.number.to_string(),
            row.episode.to_string(),
            row.step.to_string(),
            row.warm_up.to_string(),
            row.outcome.clone(),
            row.reason.clone().unwrap_or_default(),
            time(row.started),
            number(row.total),
        ];
        let stage = |name: &peernet_logger::Name| {
            row.stages.iter().find(|(known, _)| known == name).map(|(_, value)| *value)
        };
        record.extend(stage::ORDER.iter().map(|name| number(stage(name))));
        for way in DIRECTIONS {
            let delay = StageDelay::of(row, &way);
            let word =
                |of: fn(StageDelay) -> &'static str| delay.map_or_else(String::new, |one| of(one).to_owned());
            record.extend([
                number(delay.and_then(|one| one.lo_s)),
                number(delay.and_then(|one| one.hi_s)),
                word(|one| one.verdict),
                word(|one| one.source),
                number(delay.map(|one| one.raw_s)),
            ]);
        }
        record.extend([number(row.both_ways), number(row.unattributed)]);
        writer.write_record(&record)?;
    }
    writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))
}
