//! End-to-end tests: the real programs, started as a user or systemd starts them.

mod calibrate;
mod chain;
mod clocks;
mod configuration;
mod documentation;
mod floors;
mod lifecycle;
mod maintenance;
mod stream;
mod trouble;
