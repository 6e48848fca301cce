//! The protocol itself: packets, authentication, and what the two roles decide. No sockets, no timers.

pub mod auth;
pub mod figures;
pub mod kernel;
pub mod limiter;
pub mod packet;
mod recent;
pub mod reflector;
mod request_packet;
pub mod sender;
pub mod timestamp;
pub mod tlv;
pub mod uncertainty;
