//! Pages and API over a real aggregator with a real database.

mod api;
mod comparing;
mod controllers;
mod lengths;
mod metrics;
mod over_time;
mod pages;
mod problems;
mod retained;
mod serving;
mod storing;
mod stream;
mod test_dashboard;
mod test_site;
