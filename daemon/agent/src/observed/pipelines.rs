//! The observing pipelines of this host whose stamps peers can query.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use peernet_clock::{MonoTime, Span};
use peernet_logger::Slug;
use peernet_sample::Sample;
use thiserror::Error;

use super::messages::{MAX_KEYS, StampAnswer, StampMessageError, StampRequest};
use super::ring::{Side, StampRing};
use crate::config::{AgentConfig, PairBy, PipelineConfig, PlacementConfig, StartMode};
use crate::link::HostStamp;

/// Name by which stamps are requested in place of a model.
pub(crate) const STAMPS_MODEL: &str = "observed-stamps";

/// Number of messages of a pipeline whose stamps are kept: the messages of eight seconds at 1 kHz.
const CAPACITY: usize = 8192;

/// The observing pipelines of this host that start with the agent. Clones share the pipelines.
#[derive(Clone, Debug, Default)]
pub(crate) struct ObservedPipelines(Arc<BTreeMap<Slug, Arc<ObservedPipeline>>>);

/// Stamps of one observing pipeline.
#[derive(Debug)]
pub(crate) struct ObservedPipeline {
    pair_by: PairBy,
    ring: Mutex<StampRing>,
}

impl ObservedPipelines {
    /// Returns the observing pipelines of a host that serves. Without `[serve]` the result is empty, because no peer
    /// can query the host.
    pub(crate) fn from_config(config: &AgentConfig) -> Self {
        let pipeline = |pipeline: &PipelineConfig| match &pipeline.placement {
            PlacementConfig::Observe(observed) if pipeline.start == StartMode::Boot => {
                // Messages expire after the same time as in the pipeline's pairing. A key that is received again after
                // this time belongs to another message.
                let pipeline_stamps = ObservedPipeline::new(observed.pair_by, Span::from(pipeline.timeout()));
                Some((pipeline.name.clone(), Arc::new(pipeline_stamps)))
            }
            _ => None,
        };
        let served_pipelines = config.serve.iter().flat_map(|_| config.pipelines.iter().filter_map(pipeline));
        Self(Arc::new(served_pipelines.collect()))
    }

    /// Returns a pipeline, if peers can query it.
    pub(crate) fn find(&self, pipeline: &Slug) -> Option<Arc<ObservedPipeline>> {
        self.0.get(pipeline).cloned()
    }

    /// Returns the reason why peers cannot query this host; `None` if they can.
    pub(crate) fn refusal_reason(&self, host: &Slug) -> Option<String> {
        self.0.is_empty().then(|| {
            format!(
                "host {host} observes no topics; add a [[pipeline]] with placement = {{ kind = \"observe\", … }} to \
                 its agent; the pipeline must observe the same messages as the requesting pipeline"
            )
        })
    }

    /// Answers a request.
    ///
    /// # Errors
    /// When the request cannot be read, or does not match a pipeline of this host.
    pub(crate) fn answer(&self, sample: &Sample, host: &Slug) -> Result<Sample, AnswerError> {
        let request = StampRequest::read(sample).map_err(AnswerError::Request)?;
        let StampRequest { pipeline, pair_by, keys, .. } = request;
        let Some(pipeline_stamps) = self.0.get(&pipeline) else {
            let available = self.0.keys().cloned().collect();
            return Err(AnswerError::Unknown { host: host.clone(), pipeline, available });
        };
        if pipeline_stamps.pair_by != pair_by {
            let (host, configured) = (host.clone(), pipeline_stamps.pair_by);
            return Err(AnswerError::OtherPairing { host, pipeline, configured, requested: pair_by });
        }
        if keys.len() > MAX_KEYS {
            return Err(AnswerError::TooMany(keys.len()));
        }
        let ring = pipeline_stamps.ring.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = StampAnswer::new(keys.into_iter().map(|key| ring.find(key)).collect());
        // Encoding needs no lock. Under the lock, the pipeline could not record further stamps meanwhile.
        drop(ring);
        answer.to_sample().map_err(AnswerError::Answer)
    }
}

/// Reason why a request is not answered.
#[derive(Debug, Error)]
pub(crate) enum AnswerError {
    /// The request cannot be read.
    #[error("cannot read the request: {0}")]
    Request(#[source] StampMessageError),
    /// No observing pipeline has this name.
    #[error(
        "host {host} has no observing pipeline named {pipeline}; its observing pipelines: {}; set peer_pipeline to one of them",
        list_names(available)
    )]
    Unknown { host: Slug, pipeline: Slug, available: Vec<Slug> },
    /// The pipeline pairs its messages by another rule.
    #[error(
        "pipeline {pipeline} of host {host} pairs by {}, and the requesting pipeline by {}; set pair_by to the same \"stamp\" \
         or \"sequence\" in both",
        configured.describe(), requested.describe()
    )]
    OtherPairing { host: Slug, pipeline: Slug, configured: PairBy, requested: PairBy },
    /// The request has too many keys.
    #[error("{0} messages are too many for one request; at most {MAX_KEYS}")]
    TooMany(usize),
    /// The answer cannot be written.
    #[error("cannot write the answer: {0}")]
    Answer(#[source] StampMessageError),
}

fn list_names(available: &[Slug]) -> String {
    let names: Vec<&str> = available.iter().map(Slug::as_str).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl ObservedPipeline {
    fn new(pair_by: PairBy, lifetime: Span) -> Self {
        Self { pair_by, ring: Mutex::new(StampRing::new(CAPACITY, lifetime)) }
    }

    /// Records the stamp of a message that was received at `at`.
    pub(crate) fn record(&self, side: Side, key: i64, stamp: HostStamp, at: MonoTime) {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner).record(side, key, stamp, at);
    }
}

#[cfg(test)]
mod tests {
    use peernet_clock::{RawTime, WallTime};

    use super::*;

    const SERVE: &str = "[serve]\nlisten = \"tcp://127.0.0.1:1\"\n";
    const DETECTOR: &str = "[[pipeline]]\nname = \"detector\"\nplacement = { kind = \"observe\", input = \"/a\", output = \"/b\" }\n";

    fn pipelines(text: &str) -> ObservedPipelines {
        ObservedPipelines::from_config(&toml::from_str(text).expect("a configuration"))
    }

    fn slug(text: &str) -> Slug {
        text.parse().expect("a name")
    }

    fn query(pipelines: &ObservedPipelines, request: &StampRequest) -> Result<StampAnswer, AnswerError> {
        let answer = pipelines.answer(&request.to_sample().expect("it can be written"), &slug("rack"))?;
        Ok(StampAnswer::read(&answer).expect("it can be read"))
    }

    #[test]
    fn received_messages_are_found_by_key() {
        let pipelines = pipelines(&format!("{SERVE}{DETECTOR}"));
        let detector = pipelines.find(&slug("detector")).expect("it is there");
        let stamp = |nanos| HostStamp {
            wall: WallTime::from_unix_nanos(nanos),
            raw: RawTime::from_nanos(nanos),
            epoch: Some(0),
        };
        detector.record(Side::Input, 7, stamp(100), MonoTime::from_nanos(1));
        detector.record(Side::Output, 7, stamp(130), MonoTime::from_nanos(31));
        let request = StampRequest::new(slug("detector"), PairBy::Stamp, vec![8, 7]);
        let answer = query(&pipelines, &request).expect("it is answered");
        assert_eq!(answer.pairs.iter().map(|pair| pair.key).collect::<Vec<_>>(), [8, 7]);
        assert!(!answer.pairs[0].is_complete() && answer.pairs[1].is_complete());
        assert_eq!(answer.pairs[1].elapsed(), Some(Span::from_nanos(30)));
    }

    #[test]
    fn refused_request_names_next_step() {
        let pipelines = pipelines(&format!("{SERVE}{DETECTOR}"));
        let refused =
            |request: &StampRequest| query(&pipelines, request).expect_err("it is refused").to_string();
        let unknown = refused(&StampRequest::new(slug("planner"), PairBy::Stamp, Vec::new()));
        for part in ["host rack", "planner", "observing pipelines: detector", "peer_pipeline"] {
            assert!(unknown.contains(part), "{unknown}");
        }
        let other_pairing = refused(&StampRequest::new(slug("detector"), PairBy::Sequence, Vec::new()));
        for part in ["header.stamp", "sequence number", "pair_by"] {
            assert!(other_pairing.contains(part), "{other_pairing}");
        }
        let too_many = refused(&StampRequest::new(slug("detector"), PairBy::Stamp, vec![0; MAX_KEYS + 1]));
        assert!(too_many.contains("at most 256"), "{too_many}");
    }

    #[test]
    fn host_without_observing_pipelines_refuses_requests() {
        for text in [SERVE, DETECTOR] {
            let refusal = pipelines(text).refusal_reason(&slug("rack")).expect("nobody can query");
            assert!(refusal.contains("host rack") && refusal.contains("kind = \"observe\""), "{refusal}");
        }
        assert_eq!(pipelines(&format!("{SERVE}{DETECTOR}")).refusal_reason(&slug("rack")), None);
    }
}
