//! What a session of a peer is for.

use std::sync::Arc;

use peernet_inference::{Bank, Done, Job, LoadError, Pool};
use peernet_logger::Slug;
use peernet_networks::{Failure, IncomingRequest, SessionHello};

use super::{ServeContext, failure};
use crate::host::Host;
use crate::observed::{MODEL, ObservedPipelines};

/// What answers the requests of a session.
pub(super) enum Service {
    /// A model.
    Model(Arc<Pool>),
    /// What is known of the messages that this host's pipelines observe.
    Stamps(ObservedPipelines, Host),
}

/// Why a peer gets no session.
pub(super) struct Refusal {
    /// For this host's log and incidents.
    pub(super) reason: String,
    /// What the peer is told.
    pub(super) to_peer: String,
}

impl Service {
    /// Gets ready what a peer asks for. Blocks while a model loads.
    ///
    /// # Errors
    /// There is no such model or it cannot be loaded, or no topics are observed here.
    pub(super) fn prepare(hello: &SessionHello, context: &ServeContext) -> Result<Self, Refusal> {
        if hello.model.as_ref().is_some_and(|model| is_stamps(model, &context.bank)) {
            return match context.observed.refusal(&context.host.name) {
                None => Ok(Self::Stamps(context.observed.clone(), context.host.clone())),
                Some(reason) => Err(Refusal { to_peer: reason.clone(), reason }),
            };
        }
        let model = hello.model.clone().map_or_else(|| context.bank.only(), Ok);
        let pool = model.and_then(|model| context.bank.load(&model, hello.device.as_deref()));
        pool.map(Self::Model).map_err(|error: LoadError| {
            let asked = hello.model.as_ref().map_or_else(|| "that is offered".to_owned(), Slug::to_string);
            Refusal { reason: error.to_string(), to_peer: error.to_peer(&asked) }
        })
    }

    pub(super) fn name(&self) -> Slug {
        match self {
            Self::Model(pool) => pool.name().clone(),
            Self::Stamps(..) => MODEL.parse().unwrap_or_else(|_| Slug::observed()),
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

    /// Answers a request, now or when the model has computed; `answered` is told of its end first.
    pub(super) fn answer(&self, request: IncomingRequest, answered: impl FnOnce(&Done) + Send + 'static) {
        let IncomingRequest { sample, log, received, reply, .. } = request;
        match self {
            Self::Model(pool) => {
                let reply = Box::new(move |done: Done| {
                    answered(&done);
                    let Done { log, result } = done;
                    reply.send(log, result.map_err(|error| failure(&error)));
                });
                if let Err(refused) = pool.submit(Job { sample, log, received: received.mono, reply }) {
                    let Job { log, reply, .. } = *refused.job;
                    reply(Done { log, result: Err(refused.reason) });
                }
            }
            Self::Stamps(observed, host) => {
                reply.send(
                    log,
                    observed.answer(&sample, &host.name).map_err(|error| Failure::Failed(error.to_string())),
                );
            }
        }
    }
}

/// Whether the name is that of the stamps: a configured model of the name goes first.
fn is_stamps(model: &Slug, bank: &Bank) -> bool {
    model.as_str() == MODEL && !bank.names().contains(model)
}
