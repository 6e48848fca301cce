//! The REST API, `/api/v1`: one file or folder per resource, which holds its handlers, its schema types and its part of
//! the OpenAPI document.
//!
//! This file registers the resources. A resource is named here twice, as a module and in `describe_routes`, and nowhere else in the program.

mod compare;
mod export;
mod health;
mod hosts;
mod incidents;
mod iterations;
mod links;
mod live;
mod openapi;
mod pin;
mod pipelines;
mod runs;
mod schema;
mod trust;

use axum::Router;
use axum::routing::get;
use utoipa_axum::router::OpenApiRouter;

use crate::metrics;
use crate::state::App;

/// Returns the routes of all resources with their OpenAPI descriptions.
fn describe_routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(openapi::document_head())
        .merge(hosts::routes())
        .merge(links::routes())
        .merge(pipelines::routes())
        .merge(live::routes())
        .merge(runs::routes())
        .merge(compare::routes())
        .merge(trust::routes())
        .merge(pin::routes())
        .merge(iterations::routes())
        .merge(export::routes())
        .merge(incidents::routes())
        .merge(health::routes())
        .merge(metrics::routes())
}

/// Returns the OpenAPI document.
#[cfg(test)]
fn document() -> utoipa::openapi::OpenApi {
    router_and_document().1
}

/// Returns the routes, and the complete OpenAPI document.
fn router_and_document() -> (Router<App>, utoipa::openapi::OpenApi) {
    let (router, mut document) = describe_routes().split_for_parts();
    openapi::add_common_responses(&mut document);
    (router, document)
}

pub(crate) fn routes() -> Router<App> {
    let (router, document) = router_and_document();
    router.route("/api/openapi.json", get(|| openapi::serve(document)))
}
