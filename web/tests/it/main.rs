//! Pages and API over a real aggregator with a real database.

mod api;
mod bed;
mod comparing;
mod controllers;
mod factory;
mod metrics;
mod pages;
mod retained;
mod serving;
mod storing;
mod stream;
