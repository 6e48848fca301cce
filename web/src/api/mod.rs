//! The REST API, `/api/v1`: one file per resource, the OpenAPI document generated from them.

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
mod run;
mod runs;
mod schema;
mod trust;

use axum::Router;
use axum::routing::get;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::metrics;
use crate::state::App;

/// All resources with their description.
fn described() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(openapi::head())
        .routes(routes!(hosts::list))
        .routes(routes!(hosts::one))
        .routes(routes!(links::list))
        .routes(routes!(links::one))
        .routes(routes!(links::clock))
        .routes(routes!(pipelines::list))
        .routes(routes!(pipelines::one))
        .routes(routes!(live::stream))
        .routes(routes!(runs::list))
        .routes(routes!(compare::experiments))
        .routes(routes!(compare::compare))
        .routes(routes!(run::one))
        .routes(routes!(run::stages))
        .routes(routes!(run::series))
        .routes(routes!(run::histogram))
        .routes(routes!(run::recomputed))
        .routes(routes!(trust::one))
        .routes(routes!(pin::put, pin::delete))
        .routes(routes!(iterations::list))
        .routes(routes!(iterations::one))
        .routes(routes!(export::table))
        .routes(routes!(incidents::list))
        .routes(routes!(health::alive))
        .routes(routes!(health::ready))
        .routes(routes!(metrics::serve))
}

/// The OpenAPI document.
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
