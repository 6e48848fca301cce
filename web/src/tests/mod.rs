//! Test data that several modules share, and the test of the registries.

mod registration;
pub(crate) mod samples;
