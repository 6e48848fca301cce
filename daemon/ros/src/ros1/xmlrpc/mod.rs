//! XML-RPC as ROS 1 uses it: calls and answers as texts, without I/O.

mod parse;
mod value;
mod write;

pub use parse::{ParseError, parse_call, parse_response};
pub use value::{Call, Response, Value};
pub use write::{write_call, write_response};

#[cfg(test)]
mod tests;
