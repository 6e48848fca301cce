//! What tests of several modules are made of.

pub(crate) mod samples;
