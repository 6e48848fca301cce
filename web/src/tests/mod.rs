//! Test data that several modules share, and the test of what they register.

mod registration;
pub(crate) mod samples;
