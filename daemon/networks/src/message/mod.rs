//! Messages of the session protocol.
//!
//! | message | from | header (frame 0) | frame 1 | further frames |
//! | --- | --- | --- | --- | --- |
//! | open | edge | hello, limits | | |
//! | accepted, refused | cloud | session id and acceptance, or the reason | | |
//! | request | edge | session, request number, departure, description of the sample | tree | payload parts, unchanged |
//! | reply | cloud | session, request number, departure, outcome | tree delta | payload parts, unchanged |
//! | partial-reply | cloud | session, request number, number of the partial answer, departure, description of the partial answer | empty | payload parts, unchanged |
//! | parts-read | edge | session, request number, how many partial answers (not payload parts) were read | | |
//! | cancel | edge | session, request number | | |
//! | clock | cloud | session, state of the cloud's clocks | | |
//! | statistics | cloud | session, statistics of the cloud's end of the connection | | |
//! | unknown-session | cloud | session, request number | | |
//! | goodbye | either | session, reason; from an edge whose run is over, also the planned number of iterations | | |
//!
//! The tree is encoded first, then the departure is stamped, then the small header is encoded. `upload` and `download`
//! therefore contain the time on the network, and of the encoding only the time for the small header. The transit node
//! is not part of the tree or tree delta that is sent; the receiver makes the node from the header. `tests/it/wire.rs`
//! contains an independent description of the wire form.
//!
//! All messages come from untrusted peers. The limits are 64 payload parts, 64 KiB of header, the limits of the logger
//! for trees, and the configured size of a message.

mod clock_socket;
mod header;
mod hello;
mod probe_key;
mod tree;

#[cfg(test)]
mod fixtures;
#[cfg(test)]
pub(crate) mod strategies;

pub use clock_socket::{ClockSocketName, InvalidClockSocketName};
pub(crate) use header::{
    Accepted, Cancel, ClockUpdate, Departure, Goodbye, Header, HeaderError, MAX_FRAMES, MAX_UNREAD_BYTES,
    MAX_UNREAD_PARTIAL_ANSWERS, Open, Outcome, PartialAnswersRead, PartialReply, RefusalKind, Refused, Reply,
    Request, SampleHeader, StatisticsReport, UnknownSession,
};
pub use hello::{
    MAX_CONDITIONS, PeerClock, RAW_STAMPS_SINCE, RawClock, SESSION_VERSIONS, SessionAccepted, SessionHello,
    SessionId,
};
pub(crate) use hello::{PARTIAL_REPLIES_SINCE, STATISTICS_SINCE};
pub use probe_key::ProbeKey;
pub(crate) use tree::{
    TreeFrameError, add_upload, decode_tree, decode_tree_delta, encode_tree, encode_tree_delta,
};

use peernet_sample::printable_line;
use serde::{Deserialize, Deserializer};

/// Deserializes a peer's text. Control characters become spaces, because the text is shown on terminals and in logs.
fn deserialize_text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    String::deserialize(deserializer).map(|text| to_printable(&text))
}

fn to_printable(text: &str) -> String {
    printable_line(text).into_owned()
}
