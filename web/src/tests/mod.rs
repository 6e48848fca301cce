//! Test data that several modules share, and the test of the files that register pages and REST resources.

mod registration;
pub(crate) mod samples;
