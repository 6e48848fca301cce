//! The dashboard and the REST API: thin handlers that query the aggregator and render its answers.
//!
//! `pages/` holds one file per page with its template next to it, `api/` one file or folder per resource of `/api/v1`; the `mod.rs` of
//! either registers them. `view/` holds the parts that several pages share, `svg/` the pictures that the server draws. Pages are complete
//! when they arrive; scripts then update them.

mod access;
mod api;
mod assets;
mod config;
mod connections;
mod error;
mod fair_places;
mod look;
mod metrics;
mod pages;
mod parameters;
mod router;
mod serve;
mod server_names;
mod state;
mod svg;
#[cfg(test)]
mod tests;
mod timeline;
mod view;
mod zone;

pub use config::{Problem, WarnConfig, WebConfig};
pub use serve::{Failure, Running, StartError, router, serve};
pub use zone::{InvalidZone, Zone};
