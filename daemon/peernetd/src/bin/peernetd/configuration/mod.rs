//! The configuration file: one TOML file for all roles; a role is on when its table is there.

mod load;
mod locate;

pub(crate) use load::{Configuration, load};
pub(crate) use locate::Locator;
