//! The configuration: one TOML file for all roles. A role is on if its table exists.

mod data_files;
mod load;
mod locator;
mod mistakes;

pub(crate) use data_files::{DataFiles, data_files};
pub(crate) use load::{Configuration, Problem, load};
pub(crate) use locator::Locator;
