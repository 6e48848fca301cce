//! The dashboard and the REST API: thin handlers that query the aggregator and render its answers.
//!
//! `pages/` holds one file per page with its template next to it, and `api/` one file or folder per resource of
//! `/api/v1`. The `mod.rs` of each folder registers the files. `view/` holds the parts that several pages share.
//! `picture.rs` turns the layouts of the crate `figures` into HTML.
//!
//! Pages are complete without scripts: templates render tables and pictures on the server, and server-sent events replace parts of
//! them. Only charts that zoom or move are drawn in the browser.
//!
//! Handlers read snapshots of the live state, and query the store over read-only connections. Statistics come from the store's
//! roll-ups, so that no page reads all iterations of a run. The crate `analysis` computes comparisons, fits and findings, so that
//! pages, API and commands give the same answer to the same question.

mod access;
mod api;
mod assets;
mod config;
mod connections;
mod error;
mod fair_slots;
mod look;
mod metrics;
mod pages;
mod parameters;
mod picture;
mod router;
mod serve;
mod server_names;
mod state;
#[cfg(test)]
mod tests;
mod timeline;
mod view;
mod zone;

pub use config::{ConfigProblem, WarnConfig, WebConfig};
pub use serve::{RunningServer, ServerError, StartError, router, serve};
pub use zone::{InvalidZone, Zone};
