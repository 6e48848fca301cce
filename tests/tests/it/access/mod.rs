//! Tests of access: permissions, secrets, and limits for unauthenticated clients.

mod arguments;
mod http;
mod permissions;
