//! The configuration file: one TOML file for all roles; a role is on when its table is there.

mod load;
mod locate;
mod mistakes;
mod places;

pub(crate) use load::{Configuration, Problem, load};
pub(crate) use locate::Locator;
pub(crate) use places::{Places, places};
