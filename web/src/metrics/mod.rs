//! `GET /metrics`: the live state as OpenMetrics text, for Prometheus and other readers of this format.
//!
//! Each metric is an entry of [`table`]. A sample of a metric is a value with its labels. All samples of an answer come
//! from one snapshot.

mod aggregator;
mod hosts;
mod links;
mod pipelines;
mod scrape;
mod table;

use std::fmt;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use peernet_aggregator::Readiness;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::text;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::{Registry, Unit};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::aggregator::AggregatorNumbers;
use self::scrape::Scrape;
use self::table::{Kind, METRICS, Sample};
use crate::error::WebError;
use crate::state::App;

/// Content type of the [OpenMetrics text format](https://prometheus.io/docs/specs/om/open_metrics_spec/).
const CONTENT_TYPE_OPENMETRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Returns the operations of this resource.
pub(crate) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(serve))
}

/// All metrics, in the OpenMetrics text format; `docs/metrics.md` lists them.
#[utoipa::path(get, path = "/metrics", operation_id = "getMetrics", tag = "health", responses(
    (status = 200, body = String, content_type = "application/openmetrics-text"),
))]
async fn serve(State(app): State<App>) -> Result<Response, WebError> {
    let snapshot = app.live_state();
    let aggregator = AggregatorNumbers {
        ready: app.aggregator.current_readiness() == Readiness::Ready,
        database_bytes: app.aggregator.database_bytes(),
        ..AggregatorNumbers::from_live_state(&snapshot).with_rejections(app.aggregator.rejections())
    };
    let text = render(Scrape::from_live_state(&snapshot, aggregator))?;
    Ok(([(CONTENT_TYPE, CONTENT_TYPE_OPENMETRICS)], text).into_response())
}

fn render(scrape: Scrape) -> Result<String, WebError> {
    let mut registry = Registry::with_prefix("peernet");
    registry.register_collector(Box::new(scrape));
    let mut text = String::new();
    text::encode(&mut text, &registry)?;
    Ok(text)
}

impl Collector for Scrape {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        for metric in METRICS {
            let unit = Unit::Other(metric.unit.to_owned());
            let kind = match metric.kind {
                Kind::Counter => MetricType::Counter,
                Kind::Gauge => MetricType::Gauge,
            };
            let mut family = encoder.encode_descriptor(metric.name, metric.help, Some(&unit), kind)?;
            // The callback cannot return an error, so the first error is kept here and returned below.
            let mut result = Ok(());
            (metric.write_samples)(self, &mut |values, sample| {
                if result.is_err() {
                    return;
                }
                let labels: Vec<(&str, &str)> =
                    metric.labels.iter().copied().zip(values.iter().copied()).collect();
                // With an empty set of labels, the text would contain empty braces.
                result = if labels.is_empty() {
                    write(&mut family, sample)
                } else {
                    family.encode_family(&labels).and_then(|mut line| write(&mut line, sample))
                };
            });
            result?;
        }
        Ok(())
    }
}

fn write(line: &mut MetricEncoder<'_>, sample: Sample) -> fmt::Result {
    match sample {
        Sample::Count(count) => line.encode_counter::<NoLabelSet, u64, f64>(&count, None),
        Sample::Size(size) => line.encode_gauge(&size),
        // The format allows NaN and infinity, but such a sample has no meaning here.
        Sample::Value(value) if value.is_finite() => line.encode_gauge(&value),
        Sample::Value(_) => Ok(()),
    }
}
