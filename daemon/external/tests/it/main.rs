//! Tests of custom Python objects and programs in real processes.

mod examples;
mod processes;
mod python;
