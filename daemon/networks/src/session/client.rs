//! State machine of a session at the edge, without I/O.

use std::collections::HashMap;
use std::fmt;

use peernet_stream::{ConnectionStatistics, VersionMismatch, VersionRange};

use crate::message::{
    Accepted, Header, PartialReply, PeerClock, RefusalKind, Refused, Reply, SESSION_VERSIONS, SessionId,
};

/// Reason for the end of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CloseReason {
    /// The session was closed on this side.
    Local,
    /// The cloud said goodbye, with this reason.
    Goodbye(String),
    /// The cloud does not know the session: it was restarted, or it ended the session.
    UnknownSession,
    /// The connection broke, for this reason.
    Broken(String),
}

impl fmt::Display for CloseReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Local => f.write_str("the session was closed here"),
            Self::Goodbye(reason) => write!(f, "the cloud closed the session: {reason}"),
            Self::UnknownSession => f.write_str("the cloud does not know the session any more"),
            Self::Broken(reason) => write!(f, "the connection broke: {reason}"),
        }
    }
}

/// Meaning of a message from the cloud for a session that is being opened.
#[derive(Debug)]
pub(crate) enum HelloOutcome {
    /// The cloud accepted the session.
    Accepted(Box<Accepted>),
    /// The cloud refused the session, for this reason.
    Refused(String),
    /// The cloud speaks none of our versions of the protocol.
    Incompatible(VersionMismatch),
    /// The message does not answer the hello. The answer may still come.
    Unrelated,
}

/// Classifies a message that arrives while a session opens.
pub(crate) fn classify_hello_answer(header: Header) -> HelloOutcome {
    match header {
        Header::Accepted(accepted) => {
            match SESSION_VERSIONS.highest_common(&VersionRange::single(accepted.protocol)) {
                Ok(_) => HelloOutcome::Accepted(accepted),
                Err(mismatch) => HelloOutcome::Incompatible(mismatch),
            }
        }
        // The versions decide, not the kind of the refusal: if a common version exists, a cloud that calls itself
        // incompatible refuses for another reason.
        Header::Refused(Refused { versions, kind: RefusalKind::Incompatible, reason }) => {
            match SESSION_VERSIONS.highest_common(&versions) {
                Ok(_) => HelloOutcome::Refused(reason),
                Err(mismatch) => HelloOutcome::Incompatible(mismatch),
            }
        }
        Header::Refused(refused) => HelloOutcome::Refused(refused.reason),
        _ => HelloOutcome::Unrelated,
    }
}

/// An open session at the edge. A waiter, of type `W`, is the caller's value for a request in flight. The session
/// stores the waiter and returns it when the request ends, unless the request is cancelled.
#[derive(Debug)]
pub(crate) struct ClientSession<W> {
    session: SessionId,
    next_request: u64,
    waiters: HashMap<u64, W>,
    close_reason: Option<CloseReason>,
}

/// Effect of a message from the cloud on the session.
#[derive(Debug, PartialEq)]
pub(crate) enum CloudMessage<W> {
    /// The answer for this waiter.
    Answer(W, Reply),
    /// A partial answer to a request in flight.
    PartialAnswer(PartialReply),
    /// An answer to a request that was cancelled or has ended.
    LateAnswer,
    /// A partial answer to a request that was cancelled or has ended.
    LatePartialAnswer,
    /// New state of the cloud's clocks.
    Clock(PeerClock),
    /// Statistics of the cloud's end of the connection.
    Statistics(Box<ConnectionStatistics>),
    /// The message is not valid in this session, for this reason.
    Malformed(&'static str),
    /// The cloud ended the session for this reason; these waiters get no answer.
    SessionEnded(CloseReason, Vec<W>),
}

impl<W> ClientSession<W> {
    pub(crate) fn new(session: SessionId) -> Self {
        Self { session, next_request: 0, waiters: HashMap::new(), close_reason: None }
    }

    /// Starts a request and returns its number.
    ///
    /// # Errors
    /// If the session is over.
    pub(crate) fn start_request(&mut self, waiter: W) -> Result<u64, CloseReason> {
        if let Some(reason) = &self.close_reason {
            return Err(reason.clone());
        }
        // Numbers are not reused, so that a late answer cannot be taken for the answer to another request.
        let request = self.next_request;
        self.next_request += 1;
        self.waiters.insert(request, waiter);
        Ok(request)
    }

    /// Stops waiting for the answer to a request. Returns whether the request was still in flight.
    pub(crate) fn cancel_request(&mut self, request: u64) -> bool {
        self.waiters.remove(&request).is_some()
    }

    /// Returns the waiter of a request in flight.
    pub(crate) fn waiter_mut(&mut self, request: u64) -> Option<&mut W> {
        self.waiters.get_mut(&request)
    }

    /// Handles a message from the cloud.
    pub(crate) fn receive(&mut self, header: Header) -> CloudMessage<W> {
        match header {
            Header::Reply(reply) if reply.session != self.session => {
                CloudMessage::Malformed("an answer of another session")
            }
            Header::Reply(reply) if reply.request >= self.next_request => {
                CloudMessage::Malformed("an answer to a request that was never sent")
            }
            Header::Reply(reply) => match self.waiters.remove(&reply.request) {
                Some(waiter) => CloudMessage::Answer(waiter, reply),
                // The answer may arrive after its request timed out. Such an answer is late and not invalid.
                None => CloudMessage::LateAnswer,
            },
            Header::PartialReply(partial_answer) if partial_answer.session != self.session => {
                CloudMessage::Malformed("a partial answer of another session")
            }
            Header::PartialReply(partial_answer) if partial_answer.request >= self.next_request => {
                CloudMessage::Malformed("a partial answer to a request that was never sent")
            }
            Header::PartialReply(partial_answer) if self.waiters.contains_key(&partial_answer.request) => {
                CloudMessage::PartialAnswer(partial_answer)
            }
            Header::PartialReply(_) => CloudMessage::LatePartialAnswer,
            Header::Clock(update) if update.session == self.session => CloudMessage::Clock(update.clock),
            Header::Clock(_) => CloudMessage::Malformed("the clock state of another session"),
            Header::Statistics(report) if report.session == self.session => {
                CloudMessage::Statistics(Box::new(report.statistics))
            }
            Header::Statistics(_) => CloudMessage::Malformed("the statistics of another session"),
            Header::UnknownSession(unknown) if unknown.session == self.session => {
                self.end_by_cloud(CloseReason::UnknownSession)
            }
            Header::Goodbye(goodbye) if goodbye.session == self.session => {
                self.end_by_cloud(CloseReason::Goodbye(goodbye.reason))
            }
            Header::UnknownSession(_) | Header::Goodbye(_) => {
                CloudMessage::Malformed("the end of another session")
            }
            Header::Open(_)
            | Header::Accepted(_)
            | Header::Refused(_)
            | Header::Request(_)
            | Header::PartialAnswersRead(_)
            | Header::Cancel(_) => CloudMessage::Malformed("a message that an open session never receives"),
        }
    }

    /// Ends a request that was lost on the way, or whose answer was lost. Returns the request's waiter unless the
    /// request has ended already.
    pub(crate) fn remove_lost_request(&mut self, request: u64) -> Option<W> {
        self.waiters.remove(&request)
    }

    /// Ends the session. If the session has ended already, the first reason is kept. Returns the waiters that get no
    /// answer.
    pub(crate) fn end(&mut self, reason: CloseReason) -> Vec<W> {
        // Later reasons are consequences of the first one.
        self.close_reason.get_or_insert(reason);
        self.waiters.drain().map(|(_, waiter)| waiter).collect()
    }

    fn end_by_cloud(&mut self, reason: CloseReason) -> CloudMessage<W> {
        let waiters = self.end(reason.clone());
        CloudMessage::SessionEnded(reason, waiters)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use proptest::prelude::*;

    use super::*;
    use crate::message::{Goodbye, Outcome, UnknownSession, strategies};

    fn reply(session: SessionId, request: u64) -> Header {
        Header::Reply(Reply {
            session,
            request,
            departure: None,
            arrival_epoch: 0,
            outcome: Outcome::Failed(String::new()),
            arrived_raw: None,
        })
    }

    #[test]
    fn repeated_answer_to_a_request_is_late() {
        let session = SessionId::random();
        let mut client = ClientSession::new(session);
        let (a, b) = (client.start_request('a').expect("open"), client.start_request('b').expect("open"));
        assert!(matches!(client.receive(reply(session, b)), CloudMessage::Answer('b', _)));
        assert_eq!(client.receive(reply(session, b)), CloudMessage::LateAnswer);
        assert!(client.cancel_request(a) && !client.cancel_request(a));
        assert_eq!(client.receive(reply(session, a)), CloudMessage::LateAnswer);
        assert!(matches!(client.receive(reply(session, b + 1)), CloudMessage::Malformed(_)));
        assert!(matches!(client.receive(reply(SessionId::random(), a)), CloudMessage::Malformed(_)));
    }

    #[test]
    fn first_end_reason_is_kept() {
        let session = SessionId::random();
        let mut client = ClientSession::new(session);
        client.start_request('a').expect("open");
        let effect = client.receive(Header::UnknownSession(UnknownSession { session, request: 0 }));
        assert_eq!(effect, CloudMessage::SessionEnded(CloseReason::UnknownSession, vec!['a']));
        assert_eq!(client.end(CloseReason::Broken("later".into())), Vec::<char>::new());
        assert_eq!(client.start_request('b'), Err(CloseReason::UnknownSession));
        let foreign_goodbye =
            Goodbye { session: SessionId::random(), reason: String::new(), planned_iterations: None };
        assert!(matches!(client.receive(Header::Goodbye(foreign_goodbye)), CloudMessage::Malformed(_)));
    }

    #[derive(Clone, Debug)]
    enum Step {
        StartRequest,
        CancelRequest(u64),
        LoseRequest(u64),
        Receive(Header),
        End,
    }

    fn steps(session: SessionId) -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            6 => Just(Step::StartRequest),
            2 => (0..16_u64).prop_map(Step::CancelRequest),
            2 => (0..16_u64).prop_map(Step::LoseRequest),
            8 => strategies::header(vec![session]).prop_map(Step::Receive),
            1 => Just(Step::End),
        ];
        proptest::collection::vec(step, 0..60)
    }

    proptest! {
        #[test]
        fn every_request_ends_once(
            (session, steps) in any::<()>().prop_map(|()| SessionId::random()).prop_flat_map(|s| (Just(s), steps(s)))
        ) {
            let mut client = ClientSession::new(session);
            // In this test the waiter of a request is the request's number.
            let (mut started_count, mut ended, mut is_over) = (0, HashSet::new(), false);
            for step in steps {
                match step {
                    Step::StartRequest => match client.start_request(started_count) {
                        Ok(request) => {
                            prop_assert!(!is_over);
                            prop_assert_eq!(request, started_count);
                            started_count += 1;
                        }
                        Err(_) => prop_assert!(is_over),
                    },
                    Step::CancelRequest(request) => {
                        if client.cancel_request(request) {
                            prop_assert!(request < started_count && ended.insert(request));
                        }
                    }
                    Step::LoseRequest(request) => {
                        if let Some(waiter) = client.remove_lost_request(request) {
                            prop_assert_eq!(waiter, request);
                            prop_assert!(ended.insert(waiter));
                        }
                    }
                    Step::Receive(header) => match client.receive(header) {
                        CloudMessage::Answer(waiter, reply) => {
                            prop_assert_eq!(waiter, reply.request);
                            prop_assert!(ended.insert(waiter));
                        }
                        CloudMessage::SessionEnded(_, waiters) => {
                            is_over = true;
                            for waiter in waiters {
                                prop_assert!(ended.insert(waiter));
                            }
                        }
                        CloudMessage::PartialAnswer(partial_answer) => prop_assert!(!ended.contains(&partial_answer.request)),
                        CloudMessage::LatePartialAnswer
                        | CloudMessage::Clock(_)
                        | CloudMessage::Statistics(_)
                        | CloudMessage::LateAnswer
                        | CloudMessage::Malformed(_) => {}
                    },
                    Step::End => {
                        is_over = true;
                        for waiter in client.end(CloseReason::Local) {
                            prop_assert!(ended.insert(waiter));
                        }
                    }
                }
                prop_assert!(!is_over || ended.len() as u64 == started_count);
            }
            for waiter in client.end(CloseReason::Local) {
                prop_assert!(ended.insert(waiter));
            }
            prop_assert_eq!(ended.len() as u64, started_count);
        }

        #[test]
        fn session_opens_only_if_accepted_in_known_version(header in strategies::header(Vec::new())) {
            let known_versions = SESSION_VERSIONS.oldest()..=SESSION_VERSIONS.newest();
            let is_valid = matches!(&header, Header::Accepted(accepted) if known_versions.contains(&accepted.protocol));
            prop_assert_eq!(matches!(classify_hello_answer(header), HelloOutcome::Accepted(_)), is_valid);
        }
    }
}
