//! The configuration: one TOML file for all roles. A role is on if its table exists.

mod load;
mod locate;
mod mistakes;
mod places;

pub(crate) use load::{Configuration, Problem, load};
pub(crate) use locate::Locator;
pub(crate) use places::{Places, places};
