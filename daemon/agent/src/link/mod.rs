//! What is known of the hosts at the other end.

mod correction;

pub(crate) use correction::correct;
