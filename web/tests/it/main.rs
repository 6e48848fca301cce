//! Pages and API over a real aggregator with a real database.

mod api;
mod bed;
mod factory;
mod pages;
mod serving;
mod stream;
