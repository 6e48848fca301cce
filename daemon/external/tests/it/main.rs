//! Users' Python objects and programs, run for real.

mod examples;
mod processes;
mod python;
