//! Sessions: one protocol logic for all transports.
//!
//! `client` and `server` are the state machines of the protocol. They do no I/O; they return events and the messages
//! that must be sent. `edge` and `cloud` drive them over a transport.

mod announcer;
mod bind_error;
mod budget;
mod client;
mod cloud;
mod completed_request;
mod edge;
mod incoming;
mod open;
mod partial_answer_sender;
mod partial_answers;
mod receiving;
mod remarks;
mod request_control;
mod requests_in_flight;
mod server;
mod state;

pub use announcer::Announcer;
pub use bind_error::BindError;
pub use client::CloseReason;
pub use cloud::Listener;
pub use completed_request::{AwaitedEvent, CompletedRequest, RequestError};
pub use edge::{Session, StatisticsReader};
pub use incoming::{Failure, Incoming, IncomingRequest, OpenRequest, Responder};
pub use open::OpenError;
pub use partial_answer_sender::{PartialAnswerError, PartialAnswerSender};
pub use partial_answers::{FIRST_PART, FIRST_PART_DOWNLOAD, PARTS, PARTS_SENT, PartialAnswerHandler};
pub use request_control::RequestCancelled;
