//! Who gets in, and what one who is not known may take.

mod arguments;
mod http;
mod permissions;
