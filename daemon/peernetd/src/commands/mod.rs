//! Implementations of the commands.

mod backup;
mod check;
mod database_argument;
mod doctor;
mod rebuild;
mod run;
mod secrets;

pub(crate) use backup::backup;
pub(crate) use check::check;
pub(crate) use database_argument::DatabaseArgument;
pub(crate) use doctor::{Arguments as DoctorArguments, doctor};
pub(crate) use rebuild::rebuild;
pub(crate) use run::run;
pub(crate) use secrets::clear_secret;
