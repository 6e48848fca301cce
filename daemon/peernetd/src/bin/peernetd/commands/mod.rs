//! What the commands do.

mod check;
mod run;

pub(crate) use check::check;
pub(crate) use run::run;
