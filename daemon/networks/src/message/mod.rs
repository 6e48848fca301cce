//! What goes over the wire.
//!
//! | message | from | header (frame 0) | frame 1 | further frames |
//! | --- | --- | --- | --- | --- |
//! | open | edge | hello, limits | | |
//! | accepted, refused | cloud | session id and who serves, or the reason | | |
//! | request | edge | session, number, departure, description of the sample | tree | payload parts, untouched |
//! | reply | cloud | session, number, departure, outcome | growth of the tree | payload parts, untouched |
//! | clock | cloud | session, what is known of the cloud's clock | | |
//! | statistics | cloud | session, what was counted at the cloud's end of the connection | | |
//! | unknown-session | cloud | session, number | | |
//! | goodbye | either | session, reason; an edge whose run is over: how many iterations that was to have | | |
//!
//! The tree is encoded before the departure is stamped, and the header after: the transit node itself is not in
//! either tree, the receiver puts it there from the header. `tests/it/wire.rs` writes the form down a second time.

mod clock_socket;
mod header;
mod hello;
mod probe_key;
mod tree;

#[cfg(test)]
mod fixtures;
#[cfg(test)]
pub(crate) mod strategies;

pub use clock_socket::{ClockSocketName, NoClockSocketName};
pub(crate) use header::{
    Accepted, ClockNews, CountedAtCloud, Departure, Goodbye, Header, HeaderError, MAX_FRAMES, Open, Outcome,
    RefusalKind, Refused, Reply, Request, SampleHeader, UnknownSession,
};
pub(crate) use hello::STATISTICS_SINCE;
pub use hello::{
    MAX_CONDITIONS, PeerClock, RAW_STAMPS_SINCE, RawClock, SESSION_VERSIONS, SessionAccepted, SessionHello,
    SessionId,
};
pub use probe_key::ProbeKey;
pub(crate) use tree::{
    TreeFrameError, decode_tree, decode_tree_delta, encode_tree, encode_tree_delta, put_upload,
};

use peernet_sample::printable_line;
use serde::{Deserialize, Deserializer};

/// A peer's words, which end up on terminals and in logs: control characters become spaces.
fn words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    String::deserialize(deserializer).map(|text| printable(&text))
}

fn printable(text: &str) -> String {
    printable_line(text).into_owned()
}
