//! The protocol: packets, authentication, and the state machines of the two roles, without sockets and timers.

pub mod auth;
pub mod counters;
pub mod kernel;
pub mod limiter;
pub mod packet;
mod recent_map;
pub mod reflector;
mod request_packet;
pub mod sender;
pub mod timestamp;
pub mod tlv;
pub mod uncertainty;
