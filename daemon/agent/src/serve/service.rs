//! The service that a session of a peer uses.

use std::sync::Arc;
use std::time::Duration;

use peernet_inference::{Bank, Cancelled, FinishedJob, Job, LoadError, PartialAnswerError, Pool, Requester};
use peernet_logger::Slug;
use peernet_networks::{
    self as networks, Failure, IncomingRequest, PartialAnswerSender, RequestCancelled, SessionHello,
};
use peernet_sample::Sample;
use tokio_util::sync::CancellationToken;

use super::{ServeContext, failure_from_error};
use crate::host::Host;
use crate::observed::{ObservedPipelines, STAMPS_MODEL};

/// A service that answers the requests of a session.
pub(super) enum Service {
    /// Inference by a model.
    Model(Arc<Pool>),
    /// Stamps of the messages that this host's pipelines observe.
    Stamps(ObservedPipelines, Host),
}

/// Reason why a peer gets no session.
pub(super) struct Refusal {
    /// Text for this host's log and incidents.
    pub(super) reason: String,
    /// Text for the peer.
    pub(super) to_peer: String,
}

impl Service {
    /// Prepares the service that a peer requests. Blocks while a model loads.
    ///
    /// # Errors
    /// When the requested model does not exist or cannot be loaded, or when the peer requests stamps and this host
    /// observes no topics.
    pub(super) fn prepare(hello: &SessionHello, context: &ServeContext) -> Result<Self, Refusal> {
        if hello.model.as_ref().is_some_and(|model| is_request_for_stamps(model, &context.bank)) {
            return match context.observed.refusal_reason(&context.host.name) {
                None => Ok(Self::Stamps(context.observed.clone(), context.host.clone())),
                Some(reason) => Err(Refusal { to_peer: reason.clone(), reason }),
            };
        }
        let model = hello.model.clone().map_or_else(|| context.bank.default_model(), Ok);
        let pool = model.and_then(|model| context.bank.load(&model, hello.device.as_deref()));
        pool.map(Self::Model).map_err(|error: LoadError| {
            // A peer that named no model reads "model that is offered cannot be loaded".
            let requested =
                hello.model.as_ref().map_or_else(|| "that is offered".to_owned(), Slug::to_string);
            Refusal {
                reason: error.to_string(),
                to_peer: error.to_peer(&requested, context.host.name.as_str()),
            }
        })
    }

    pub(super) fn name(&self) -> Slug {
        match self {
            Self::Model(pool) => pool.name().clone(),
            Self::Stamps(..) => STAMPS_MODEL.parse().unwrap_or_else(|_| Slug::observed()),
        }
    }

    pub(super) fn device(&self) -> String {
        match self {
            Self::Model(pool) => pool.device(),
            Self::Stamps(..) => "cpu".to_owned(),
        }
    }

    pub(super) fn facts(&self) -> Vec<(String, String)> {
        match self {
            Self::Model(pool) => pool.facts(),
            Self::Stamps(..) => Vec::new(),
        }
    }

    /// Answers a request, now or when the model has finished. If a model answers, calls `on_result` with its result
    /// before the answer is sent.
    pub(super) fn answer(
        &self,
        request: IncomingRequest,
        on_result: impl FnOnce(&FinishedJob) + Send + 'static,
    ) {
        let IncomingRequest { sample, recorder, received, partial_answers, reply, .. } = request;
        match self {
            Self::Model(pool) => {
                let reply = Box::new(move |finished_job: FinishedJob| {
                    on_result(&finished_job);
                    let FinishedJob { recorder, result } = finished_job;
                    reply.send(recorder, result.map_err(|error| failure_from_error(&error)));
                });
                let requester = Arc::new(PeerRequester(partial_answers));
                let job = Job { sample, recorder, received_at: received.mono, requester, reply };
                // A refusal is answered as well, so that the edge does not wait for its timeout.
                if let Err(refused) = pool.submit(job) {
                    let Job { recorder, reply, .. } = *refused.job;
                    reply(FinishedJob { recorder, result: Err(refused.reason) });
                }
            }
            Self::Stamps(observed, host) => {
                reply.send(
                    recorder,
                    observed.answer(&sample, &host.name).map_err(|error| Failure::Failed(error.to_string())),
                );
            }
        }
    }
}

/// A peer that requested an answer of a model.
struct PeerRequester(PartialAnswerSender);

impl Requester for PeerRequester {
    fn send_partial_answer(&self, partial_answer: Sample) -> Result<(), PartialAnswerError> {
        self.0.send(&partial_answer).map_err(|error| match error {
            networks::PartialAnswerError::Cancelled(RequestCancelled) => Cancelled.into(),
            error => PartialAnswerError::Refused(error.to_string()),
        })
    }

    fn cancellation(&self) -> CancellationToken {
        self.0.cancellation()
    }

    fn wait(&self, duration: Duration) -> Result<(), Cancelled> {
        self.0.wait(duration).map_err(|RequestCancelled| Cancelled)
    }
}

/// Returns whether a request for this model is a request for the stamps of observed messages. A configured model of the
/// same name takes precedence.
fn is_request_for_stamps(model: &Slug, bank: &Bank) -> bool {
    model.as_str() == STAMPS_MODEL && !bank.names().contains(model)
}
