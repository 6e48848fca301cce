//! Worker that sends each sample to the server and returns the answer.

use std::sync::Arc;

use bytes::Bytes;
use peernet_logger::{Recorder, stage};
use peernet_sample::{Description, MediaType, Part, Sample};
use serde::Serialize;
use tokio::runtime::Runtime;

use super::answer::StreamedAnswer;
use super::{Openai, nodes, request};
use crate::{InferenceError, Requester, Worker};

/// Maximum length of the text of an invalid number of tokens in the log, characters.
const MAX_DEFECT_CHARS: usize = 100;

/// Worker with the runtime in which its thread waits for the server.
pub(super) struct OpenaiWorker {
    model: Arc<Openai>,
    runtime: Runtime,
}

/// Second part of an answer, as JSON: facts about the text of the first part.
#[derive(Serialize)]
struct AnswerDetails<'a> {
    finish_reason: Option<&'a str>,
    input_tokens: Option<u64>,
    output_tokens: Option<u64>,
    reasoning_tokens: Option<u64>,
    output_chunks: u64,
}

impl OpenaiWorker {
    pub(super) const fn new(model: Arc<Openai>, runtime: Runtime) -> Self {
        Self { model, runtime }
    }
}

impl Worker for OpenaiWorker {
    fn infer(
        &mut self,
        sample: &Sample,
        recorder: &mut Recorder,
        requester: &dyn Requester,
    ) -> Result<Sample, InferenceError> {
        let Openai { name, config, server, clock, .. } = &*self.model;
        let body = {
            let _preprocessing = recorder.time(stage::PREPROCESSING);
            request::body(config, sample).map_err(|reason| {
                let (model, sample) = (name.clone(), sample.source.clone());
                InferenceError::Input { model, sample, reason }
            })?
        };
        let mut inference = recorder.time(stage::INFERENCE);
        let mut answer = StreamedAnswer::new(clock.mono());
        let limits = config.time_limits();
        // This token is also cancelled when a partial answer cannot be sent.
        let cancellation = requester.cancellation().child_token();
        let mut send_error = None;
        // If the requester has too many unread partial answers, sending waits. Meanwhile this thread reads nothing from
        // the server.
        let send_text = |text: &str| {
            if send_error.is_none()
                && let Err(error) = requester.send_partial_answer(partial_answer(text))
            {
                send_error = Some(error);
                cancellation.cancel();
            }
        };
        let request = server.complete(body, &limits, clock, &mut answer, send_text);
        // Dropping the request closes the connection, so that the server can stop computing.
        let result = self.runtime.block_on(cancellation.run_until_cancelled(request));
        // The nodes of a failed answer are recorded, too, as far as they are known.
        nodes::record(&answer, &mut inference);
        drop(inference);
        if let Some(defect) = &answer.usage_defect {
            self.model.usage_warning.call_once(|| {
                let defect: String = defect.chars().take(MAX_DEFECT_CHARS).collect();
                tracing::warn!(
                    model = name, url = config.url, defect,
                    "the server reports an invalid number of tokens; the columns of such numbers stay empty; this warning is logged \
                     only once"
                );
            });
        }
        if let Some(error) = send_error {
            return Err(error.into_inference_error(name));
        }
        let result = result.ok_or_else(|| InferenceError::Cancelled { model: name.clone() })?;
        result.map_err(|error| InferenceError::Server {
            model: name.clone(),
            url: config.url.clone(),
            reason: error.message(server.secret()),
        })?;
        let _postprocessing = recorder.time(stage::POSTPROCESSING);
        Ok(into_sample(answer))
    }
}

/// Returns a partial answer: a text.
fn partial_answer(text: &str) -> Sample {
    Sample::from_part(Description::unshaped(MediaType::Text), Bytes::copy_from_slice(text.as_bytes()))
}

/// Returns the answer as a sample: the text, and its details as JSON.
fn into_sample(answer: StreamedAnswer) -> Sample {
    let usage = answer.usage.unwrap_or_default();
    let details = AnswerDetails {
        finish_reason: answer.finish_reason.as_deref(),
        input_tokens: usage.prompt_tokens,
        output_tokens: usage.completion_tokens,
        reasoning_tokens: usage.reasoning_tokens,
        output_chunks: answer.chunk_count(),
    };
    let details = serde_json::to_vec(&details).expect("texts and numbers can be written as JSON");
    let part =
        |media, bytes: Vec<u8>| Part { description: Description::unshaped(media), bytes: bytes.into() };
    let parts = vec![part(MediaType::Text, answer.text.into_bytes()), part(MediaType::Json, details)];
    Sample { parts, source: String::new(), label: None }
}
