//! The REST API, `/api/v1`: one file or folder per resource, which holds its handlers, its schema types and its part of
//! the OpenAPI document.
//!
//! This file registers them: a resource is named here twice, as a module and in `described`, and nowhere else in the program.

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

/// Returns all resources with their description.
fn described() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(openapi::head())
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
    parts().1
}

fn parts() -> (Router<App>, utoipa::openapi::OpenApi) {
    let (router, mut document) = described().split_for_parts();
    openapi::complete(&mut document);
    (router, document)
}

pub(crate) fn routes() -> Router<App> {
    let (router, document) = parts();
    router.route("/api/openapi.json", get(|| openapi::serve(document)))
}
