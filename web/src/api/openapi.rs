//! `GET /api/openapi.json`.

use axum::Json;
use utoipa::OpenApi;
use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, HeaderBuilder, Ref, RefOr, Response, ResponseBuilder};

/// Title and description of the document, and the schema of errors.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "PEERNet",
        description = "Live and stored latency measurements of all hosts of edge-cloud control loops. Values are in units without prefixes (seconds, bytes, bits per second), times in RFC 3339 and UTC. Errors are problem+json (RFC 9457). A request has exactly one Host header. It names the server by an IP address, localhost, the machine's host name, or one of server_names in the table [web]. The request line and all headers together are limited to 64 KiB, and there may be at most 100 headers."
    ),
    components(schemas(crate::error::ProblemDetails))
)]
struct DocumentHead;

pub(crate) fn document_head() -> utoipa::openapi::OpenApi {
    DocumentHead::openapi()
}

pub(crate) async fn serve(document: utoipa::openapi::OpenApi) -> Json<utoipa::openapi::OpenApi> {
    Json(document)
}

/// Error responses of every operation: status, name of the component, description.
const ERRORS: [(&str, &str, &str); 4] = [
    ("400", "BadRequest", "a parameter or the Host header is invalid; the detail names it"),
    ("421", "MisdirectedRequest", "the Host header names another server"),
    (
        "500",
        "InternalServerError",
        "internal error; the aggregator's log has the cause under the id in the field `id`",
    ),
    (
        "503",
        "ServiceUnavailable",
        "the answer timed out, or there are too many concurrent queries or live streams; try again",
    ),
];
/// Error response of operations that change something: status, name, description.
const FORBIDDEN: (&str, &str, &str) = ("403", "Forbidden", "the request comes from a page of another site");
/// Error response of operations on one item: status, name, description.
const NOT_FOUND: (&str, &str, &str) = ("404", "NotFound", "the requested item does not exist");
/// Error response that the server sends before it has read a request, without a body: status, name, description.
const TOO_LARGE: (&str, &str, &str) = (
    "431",
    "RequestHeaderFieldsTooLarge",
    "the request line and headers exceed 64 KiB, or there are more than 100 headers",
);

/// Adds the error responses that do not depend on the operation.
pub(crate) fn add_common_responses(document: &mut utoipa::openapi::OpenApi) {
    let components = document.components.get_or_insert_default();
    for (_, name, description) in ERRORS.into_iter().chain([FORBIDDEN, NOT_FOUND]) {
        components.responses.insert(name.to_owned(), problem_response(name, description).into());
    }
    let (_, name, description) = TOO_LARGE;
    components
        .responses
        .insert(name.to_owned(), ResponseBuilder::new().description(description).build().into());
    for (path, item) in &mut document.paths.paths {
        // Only the API answers errors with these responses.
        if !path.starts_with("/api/") {
            continue;
        }
        let reads = [&mut item.get, &mut item.head, &mut item.options, &mut item.trace];
        let changes = [&mut item.put, &mut item.post, &mut item.delete, &mut item.patch];
        let reads = reads.into_iter().flatten().map(|operation| (operation, false));
        let changes = changes.into_iter().flatten().map(|operation| (operation, true));
        for (operation, changes_data) in reads.chain(changes) {
            ERRORS.into_iter().chain([TOO_LARGE]).for_each(|error| add_response(operation, error));
            if changes_data {
                add_response(operation, FORBIDDEN);
            }
            if path.contains('{') {
                add_response(operation, NOT_FOUND);
            }
        }
    }
}

fn add_response(operation: &mut Operation, (status, name, _): (&str, &str, &str)) {
    let reference = RefOr::Ref(Ref::new(format!("#/components/responses/{name}")));
    operation.responses.responses.entry(status.to_owned()).or_insert(reference);
}

fn problem_response(name: &str, description: &str) -> Response {
    let content = Content::new(Some(Ref::from_schema_name("ProblemDetails")));
    let response =
        ResponseBuilder::new().description(description).content("application/problem+json", content);
    if name == "ServiceUnavailable" {
        let header = HeaderBuilder::new().description(Some("seconds after which to try again")).build();
        return response.header("Retry-After", header).build();
    }
    response.build()
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    /// Appends every `$ref` of a document.
    fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
        match value {
            Value::Object(fields) => {
                found.extend(fields.get("$ref").and_then(Value::as_str));
                fields.values().for_each(|value| references(value, found));
            }
            Value::Array(items) => items.iter().for_each(|value| references(value, found)),
            _ => {}
        }
    }

    #[test]
    fn every_reference_of_the_document_resolves() {
        let document = serde_json::to_value(super::super::document()).expect("JSON");
        let mut found = Vec::new();
        references(&document, &mut found);
        assert!(found.len() > 100, "{}", found.len());
        for reference in found {
            let pointer = reference.strip_prefix('#').expect("a reference into the document");
            assert!(document.pointer(pointer).is_some(), "{reference} does not resolve");
        }
    }

    #[test]
    fn every_operation_documents_the_standard_errors() {
        let mut document = super::super::document();
        let item = document.paths.paths.get_mut("/api/v1/runs").expect("a resource");
        // Operations that the document does not have yet.
        (item.post, item.patch) = (item.get.clone(), item.get.clone());
        super::add_common_responses(&mut document);
        let document = serde_json::to_value(document).expect("JSON");
        let paths = document["paths"].as_object().expect("paths");
        for (path, item) in paths.iter().filter(|(path, _)| path.starts_with("/api/")) {
            for (method, operation) in item.as_object().expect("operations") {
                let answers = &operation["responses"];
                for (status, ..) in super::ERRORS {
                    assert!(answers[status].is_object(), "{method} {path} lacks {status}");
                }
                let changes = ["put", "post", "delete", "patch"].contains(&method.as_str());
                assert_eq!(answers["403"].is_object(), changes, "{method} {path}");
            }
        }
    }

    #[test]
    fn every_count_parameter_documents_its_limits() {
        let document = serde_json::to_value(super::super::document()).expect("JSON");
        let paths = document["paths"].as_object().expect("paths");
        for (path, item) in paths {
            for parameter in item["get"]["parameters"].as_array().into_iter().flatten() {
                let (name, schema) = (&parameter["name"], &parameter["schema"]);
                let is_count = ["limit", "points", "bins"].iter().any(|known| name == known);
                assert!(
                    !is_count || (schema["minimum"] == 1 && schema["maximum"].is_u64()),
                    "{path}: {parameter}"
                );
            }
        }
    }
}
