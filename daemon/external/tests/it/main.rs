//! Users' Python objects and programs, run for real.

mod processes;
mod python;
