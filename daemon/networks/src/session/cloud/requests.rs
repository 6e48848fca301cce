//! Handles the messages of edges.

use std::sync::Arc;

use bytes::Bytes;
use peernet_clock::Stamp;
use peernet_logger::{Recorder, TreeError};

use super::ListenerState;
use crate::message::{
    Departure, Header, HeaderError, MAX_FRAMES, Request, TreeFrameError, add_upload, decode_tree,
};
use crate::session::completed_request::MessageSizes;
use crate::session::incoming::{
    ArrivalStamp, Failure, Incoming, IncomingRequest, OpenRequest, RequestKey, Responder,
};
use crate::session::partial_answer_sender::PartialAnswerSender;
use crate::session::server::{EdgeMessageEffect, Server};
use crate::transport::{Frames, Peer};

/// Handles a message that arrived. `received` is the time of the arrival, and the part of it that a reply repeats.
/// Returns the event that [`Listener::next`](super::Listener::next) returns, if the message causes an event.
pub(super) fn handle_message(
    shared: &Arc<ListenerState>,
    peer: &Peer,
    frames: Frames,
    received: (Stamp, ArrivalStamp),
) -> Option<Incoming> {
    let bytes = MessageSizes::from_frames(&frames).total();
    shared.output.counters.count_received(bytes);
    // A message with more frames cannot be valid, so it is not decoded.
    if frames.len() > MAX_FRAMES {
        shared.report_malformed(peer, "too many frames");
        return None;
    }
    let header = match Header::decode(frames.first().map_or(&[], |frame| frame)) {
        Ok(header) => header,
        Err(HeaderError::NoCommonVersion(mismatch)) => {
            shared.send_message(peer, &Server::version_refusal(&mismatch));
            return None;
        }
        Err(error) => {
            shared.report_malformed(peer, &error.to_string());
            return None;
        }
    };
    // This is a separate statement, so that the lock is released before the branches below take it.
    let effect = shared.lock_server().receive(peer, header);
    // A message that is refused or that ends its session counts for the port only.
    let counters = match &effect {
        EdgeMessageEffect::Open(session, _) | EdgeMessageEffect::Request(Request { session, .. }) => {
            shared.lock_server().session_counters(*session)
        }
        EdgeMessageEffect::Handled => shared.lock_server().connection_counters(peer.connection),
        EdgeMessageEffect::AnswerWith(_)
        | EdgeMessageEffect::Closed(..)
        | EdgeMessageEffect::Malformed(_) => None,
    };
    if let Some(counters) = counters {
        counters.count_received(bytes);
    }
    match effect {
        EdgeMessageEffect::Open(session, hello) => {
            shared.update_admission(peer.connection);
            let open = OpenRequest::new(*hello, session, peer.address, Arc::downgrade(shared));
            Some(Incoming::Open(open))
        }
        EdgeMessageEffect::Request(request) => incoming_request(shared, peer, request, frames, received),
        EdgeMessageEffect::AnswerWith(header) => {
            shared.send_message(peer, &header);
            None
        }
        EdgeMessageEffect::Handled => None,
        EdgeMessageEffect::Closed(session, planned_iterations) => {
            shared.update_admission(peer.connection);
            Some(Incoming::Closed { session, said_goodbye: true, planned_iterations })
        }
        EdgeMessageEffect::Malformed(problem) => {
            shared.report_malformed(peer, problem);
            None
        }
    }
}

/// Handles a request that arrived. Counts its bytes in the budget and continues its tree. If either fails, answers with
/// the reason and returns `None`.
fn incoming_request(
    shared: &Arc<ListenerState>,
    peer: &Peer,
    request: Request,
    frames: Frames,
    (received, arrival): (Stamp, ArrivalStamp),
) -> Option<Incoming> {
    let key = RequestKey { session: request.session, request: request.request, arrival };
    // The session may have ended in the meantime. The answer then has no destination, and no control is needed.
    let control = shared.lock_server().request_control(key.session, key.request).unwrap_or_default();
    let frames = match shared.budget.reserve_frames(frames) {
        Ok(frames) => frames,
        Err(exceeded) => {
            shared.answer(key, None, Err(Failure::Overloaded(exceeded.to_string())));
            return None;
        }
    };
    // Frame 0 is the header, frame 1 the tree.
    let recorder = resume_tree(shared, frames.get(1), request.departure, received);
    let sample = request.sample.into_sample(frames.into_iter().skip(2)).map_err(InvalidRequest::from);
    match (recorder, sample) {
        (Ok(recorder), Ok(sample)) => {
            let reply = Responder::new(key, Arc::downgrade(shared));
            let partial_answers =
                PartialAnswerSender::new(key, received.mono, control, Arc::downgrade(shared));
            let session = key.session;
            Some(Incoming::Request(IncomingRequest {
                session,
                sample,
                recorder,
                received,
                partial_answers,
                reply,
            }))
        }
        (Err(problem), _) | (_, Err(problem)) => {
            shared.report_malformed(peer, &problem.to_string());
            let failure = Failure::Failed(format!("the request is invalid: {problem}"));
            shared.answer(key, None, Err(failure));
            None
        }
    }
}

/// Continues an edge's tree here: adds `upload` to it and closes that node at `received`.
fn resume_tree(
    shared: &ListenerState,
    tree: Option<&Bytes>,
    departure: Departure,
    received: Stamp,
) -> Result<Recorder, InvalidRequest> {
    let mut tree = decode_tree(tree.ok_or(InvalidRequest::NoTree)?)?;
    let upload = add_upload(&mut tree, departure);
    Ok(Recorder::resume(shared.clock.clone(), shared.host, tree, upload, received)?)
}

/// Error: the tree or the sample of a request is invalid.
#[derive(Debug, thiserror::Error)]
enum InvalidRequest {
    #[error("the tree is missing")]
    NoTree,
    #[error(transparent)]
    Frame(#[from] TreeFrameError),
    #[error(transparent)]
    Tree(#[from] TreeError),
    #[error(transparent)]
    Sample(#[from] HeaderError),
}
