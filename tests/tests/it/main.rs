//! End-to-end tests: the real programs, started as a user or systemd starts them.

mod access;
mod calibrate;
mod chain;
mod clocks;
mod configuration;
mod connections;
mod documentation;
mod documented;
mod durability;
mod experiments;
mod extension_points;
mod external;
mod figures;
mod fixtures;
mod layers;
mod lifecycle;
mod limits;
mod maintenance;
mod models;
mod ownership;
mod promises;
mod published;
mod python;
mod results;
mod stream;
mod trouble;
