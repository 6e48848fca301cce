//! Model kind `distribution`. Its latencies are drawn at random from a distribution; they are not those of a
//! computation.

mod columns;
mod data_file;
mod latency;
mod latency_rows;
mod run_folder;

pub use columns::Columns;
pub use latency::Histogram;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use peernet_clock::Span;
use peernet_logger::{Name, Recorder, Slug, Unit, fact, stage};
use peernet_sample::{Description, Sample};
use peernet_statistics::SplitMix64;
use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

use super::{CommonSettings, LoadContext, ModelConfig, ModelKind};
use crate::{Cancelled, InferenceError, LoadError, Model, PartialAnswerError, Requester, Worker};
use data_file::read_latencies;
use latency::{LatencyDistribution, check_ms, describe_stages};
use latency_rows::open_regular_file;
use run_folder::data_file;

/// Largest ratio of the standard deviation to the mean. Nearly all values of a wider log-normal distribution are 0.
const MAX_RELATIVE_STD: f64 = 100.0;

/// Node below `inference`: the time that the inner model took. The stages of the inner model are below this node.
const INNER_MODEL: Name = Name::from_static("inner-model");

/// Keys of a model of `kind = "distribution"`. Exactly one of `data`, `histogram` and `mean_ms` must be set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistributionConfig {
    /// `data.csv` of a run, or the folder that contains this file. The latencies in the file are drawn, each with the
    /// same probability.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<PathBuf>,
    /// Columns of `data`. The sum of these columns in a row is one latency, seconds.
    #[serde(default)]
    pub column: Columns,
    /// Mean of a log-normal distribution, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_ms: Option<f64>,
    /// Standard deviation of the log-normal distribution, milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_ms: Option<f64>,
    /// Seed of the random numbers. After loading, models with equal seeds draw equal sequences of latencies. Default: a
    /// new seed each time the model is loaded; in an experiment, a seed for each repeat and user.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Name of another model of this host, the inner model. Its answer is returned after the drawn latency. Without an
    /// inner model, the answer is empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inner: Option<Slug>,
    /// Histogram of latencies.
    // TOML requires that tables follow the other keys.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub histogram: Option<Histogram>,
}

impl ModelKind for DistributionConfig {
    /// Returns `replayed`, because the latencies are those of another machine.
    fn default_device() -> &'static str {
        "replayed"
    }

    fn keys_omitted_from_runs(&self) -> &'static [&'static str] {
        // A fact with the hash of the file identifies the latencies. The path only says where the file is.
        &["data"]
    }

    fn remove_defaults(&self, keys: &mut super::Keys) {
        // Without `data`, `column` has no effect.
        if self.data.is_none() {
            keys.remove("column");
        }
    }

    fn seed_mut(&mut self) -> Option<&mut Option<u64>> {
        Some(&mut self.seed)
    }

    fn check(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<(), LoadError> {
        self.distribution(common)?;
        self.inner_model(common, context).map(|_| ())
    }

    fn load(&self, common: &CommonSettings, context: &LoadContext<'_>) -> Result<Arc<dyn Model>, LoadError> {
        let distribution = self.distribution(common)?;
        if let LatencyDistribution::Empirical { recorded, columns } = &distribution
            && !recorded.omitted_stages.is_empty()
        {
            let omitted = describe_stages(&recorded.omitted_stages);
            tracing::warn!(
                model = %common.name, %columns,
                "the drawn latencies do not include {omitted}, although the file has these stages; to replay them, too, add their \
                 columns to column in this [[model]]"
            );
        }
        let inner = self.inner_model(common, context)?.map(|inner| inner.load(context)).transpose()?;
        let hash = self.data.as_deref().map(|data| {
            let file = data_file(data)?;
            let hash = open_regular_file(&file).and_then(peernet_external::sha256);
            hash.map_err(|error| LoadError::File { file, reason: error.to_string() })
        });
        let seed = self.seed.unwrap_or_else(|| {
            // A seed has at most 53 bits, because programs that read JSON or TOML may store numbers as 64-bit floats.
            let seed = rand::random::<u64>() >> 11;
            tracing::info!(
                model = %common.name,
                "the latencies are drawn with the new seed {seed}; to draw the same ones again, set seed = {seed} in this [[model]]"
            );
            seed
        });
        let source = LatencySource { distribution, random: Mutex::new(SplitMix64::new(seed)) };
        Ok(Arc::new(Distribution {
            name: common.name.to_string(),
            source: Arc::new(source),
            inner,
            device: common.device.clone(),
            seed,
            data_hash: hash.transpose()?,
        }))
    }
}

impl DistributionConfig {
    /// Returns the configured distribution; reads the file.
    fn distribution(&self, common: &CommonSettings) -> Result<LatencyDistribution, LoadError> {
        let invalid_key = |key, reason| LoadError::InvalidKey { model: common.name.to_string(), key, reason };
        if self.std_ms.is_some() && self.mean_ms.is_none() {
            let reason =
                "only a log-normal distribution has this key; give mean_ms, too, or leave std_ms out";
            return Err(invalid_key("std_ms", reason.to_owned()));
        }
        match (&self.data, &self.histogram, self.mean_ms) {
            (Some(data), None, None) => {
                let recorded = read_latencies(&data_file(data)?, &self.column)?;
                Ok(LatencyDistribution::Empirical { recorded, columns: self.column.clone() })
            }
            (None, Some(histogram), None) => {
                histogram.check().map_err(|reason| invalid_key("histogram", reason))?;
                Ok(LatencyDistribution::Histogram(histogram.clone()))
            }
            (None, None, Some(mean_ms)) => {
                check_ms(mean_ms).map_err(|reason| invalid_key("mean_ms", reason))?;
                if mean_ms == 0.0 {
                    return Err(invalid_key(
                        "mean_ms",
                        "a log-normal distribution has a mean above 0".to_owned(),
                    ));
                }
                let std_ms = self.std_ms.ok_or_else(|| {
                    invalid_key("std_ms", "a log-normal distribution needs its standard deviation".to_owned())
                })?;
                check_ms(std_ms).map_err(|reason| invalid_key("std_ms", reason))?;
                if std_ms > MAX_RELATIVE_STD * mean_ms {
                    let reason = format!(
                        "{std_ms} is more than {MAX_RELATIVE_STD} times mean_ms; both are milliseconds"
                    );
                    return Err(invalid_key("std_ms", reason));
                }
                Ok(LatencyDistribution::LogNormal { mean_ms, std_ms })
            }
            _ => Err(invalid_key(
                "data",
                "it needs exactly one source of latencies: give one of data, histogram and mean_ms"
                    .to_owned(),
            )),
        }
    }

    /// Returns the configuration of the inner model, if one is configured.
    fn inner_model<'a>(
        &self,
        common: &CommonSettings,
        context: &LoadContext<'a>,
    ) -> Result<Option<&'a ModelConfig>, LoadError> {
        let Some(inner) = &self.inner else { return Ok(None) };
        let invalid_key =
            |reason| LoadError::InvalidKey { model: common.name.to_string(), key: "inner", reason };
        match context.models.iter().find(|model| model.name() == inner) {
            None => Err(invalid_key(format!("no [[model]] of this file is named {inner}"))),
            // Two models of this kind could name each other as inner models.
            Some(ModelConfig::Distribution(_)) => {
                Err(invalid_key(format!("{inner} draws its latencies, too; name a model that computes")))
            }
            Some(found) => Ok(Some(found)),
        }
    }
}

/// Source of latencies. All workers share one source, so that the sequence of latencies depends only on the seed, and
/// not on the number of workers.
struct LatencySource {
    distribution: LatencyDistribution,
    random: Mutex<SplitMix64>,
}

impl LatencySource {
    /// Returns the next latency.
    fn next_latency(&self) -> Span {
        let mut random = self.random.lock().unwrap_or_else(PoisonError::into_inner);
        Span::from_nanos((self.distribution.draw(&mut random) * 1e9).round() as i64)
    }
}

/// Model whose `inference` takes a time that is drawn from a distribution.
struct Distribution {
    name: String,
    source: Arc<LatencySource>,
    inner: Option<Arc<dyn Model>>,
    device: String,
    seed: u64,
    data_hash: Option<String>,
}

impl Model for Distribution {
    fn create_worker(&self) -> Result<Box<dyn Worker>, LoadError> {
        let inner = self.inner.as_ref().map(|inner| inner.create_worker()).transpose()?;
        Ok(Box::new(DistributionWorker { name: self.name.clone(), source: Arc::clone(&self.source), inner }))
    }

    fn device(&self) -> String {
        self.device.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let distribution = self.source.distribution.describe();
        let mut facts = vec![
            ("Model".to_owned(), "replayed latencies".to_owned()),
            (
                fact::REPLAYED.to_owned(),
                format!("inference is drawn from {distribution}, seed {}", self.seed),
            ),
        ];
        facts.extend(self.data_hash.iter().map(|hash| (format!("{} SHA-256", fact::REPLAYED), hash.clone())));
        // The inner model computes the answers, so this model also has the classes and the hash of the inner model.
        facts.extend(self.inner.iter().flat_map(|inner| inner.facts()).map(|(name, text)| match &*name {
            "Model" => ("Inner model".to_owned(), text),
            _ => (name, text),
        }));
        facts
    }
}

/// Requester that discards the inner model's partial answers: their times would be those of this machine, and not those
/// of the machine whose latencies are replayed.
struct WholeAnswerRequester<'a>(&'a dyn Requester);

impl Requester for WholeAnswerRequester<'_> {
    fn send_partial_answer(&self, _: Sample) -> Result<(), PartialAnswerError> {
        if self.cancellation().is_cancelled() { Err(Cancelled.into()) } else { Ok(()) }
    }

    fn cancellation(&self) -> CancellationToken {
        self.0.cancellation()
    }

    fn wait(&self, duration: Duration) -> Result<(), Cancelled> {
        self.0.wait(duration)
    }
}

struct DistributionWorker {
    name: String,
    source: Arc<LatencySource>,
    inner: Option<Box<dyn Worker>>,
}

impl Worker for DistributionWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let drawn_latency = self.source.next_latency();
        let started_at = recorder.clock().mono();
        let mut inference = recorder.time(stage::INFERENCE);
        inference.record_value(stage::DRAWN_LATENCY, drawn_latency.seconds(), Unit::SECONDS);
        let answer = match &mut self.inner {
            None => Sample::from_part(Description::bytes(), Bytes::new()),
            // The inner model's stages are below a node of their own, so that they do not count as stages of the
            // iteration.
            Some(inner) => {
                inner.infer(sample, &mut inference.time(INNER_MODEL), &WholeAnswerRequester(requester))?
            }
        };
        let remaining = started_at + drawn_latency - inference.clock().mono();
        requester
            .wait(Duration::from_nanos(u64::try_from(remaining.nanos()).unwrap_or(0)))
            .map_err(|_| InferenceError::Cancelled { model: self.name.clone() })?;
        // The overrun is measured after the wait, because on a busy host the wait may also end late.
        let overrun = (inference.clock().mono() - started_at - drawn_latency).max(Span::ZERO);
        inference.record_value(stage::OVERRUN, overrun.seconds(), Unit::SECONDS);
        drop(inference);
        if recorder.tree().find(&[&stage::INFERENCE, &INNER_MODEL, &stage::UNKNOWN_LABEL]).is_some() {
            // The edge looks for this node directly below the root.
            recorder.record_value(stage::UNKNOWN_LABEL, 1.0, Unit::NONE);
        }
        Ok(answer)
    }
}
