//! Parameters of queries and paths, refused with a message that names them.

use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use chrono::DateTime;
use peernet_clock::WallTime;
use peernet_logger::Slug;
use serde::de::DeserializeOwned;
use std::ops::RangeInclusive;

use crate::error::WebError;

/// The query of an address.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parameters<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Parameters<T> {
    type Rejection = WebError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, WebError> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(query)) => Ok(Self(query)),
            Err(rejection) => {
                let text = rejection.body_text();
                let text = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
                Err(WebError::BadRequest(format!("query parameter {text}")))
            }
        }
    }
}

/// A number within its limits, or its default.
pub(crate) fn bounded<N: PartialOrd + std::fmt::Display>(
    name: &str,
    value: Option<N>,
    default: N,
    range: RangeInclusive<N>,
) -> Result<N, WebError> {
    let value = value.unwrap_or(default);
    if range.contains(&value) {
        return Ok(value);
    }
    let (from, to) = range.into_inner();
    Err(WebError::BadRequest(format!("query parameter {name}: {value} is outside {from} to {to}")))
}

/// A name of a host or pipeline.
pub(crate) fn slug(name: &str, value: &str) -> Result<Slug, WebError> {
    value.parse().map_err(|error| WebError::BadRequest(format!("query parameter {name}: {error}")))
}

/// A moment in RFC 3339.
pub(crate) fn moment(name: &str, value: &str) -> Result<WallTime, WebError> {
    let parsed = DateTime::parse_from_rfc3339(value).ok().and_then(|time| time.timestamp_nanos_opt());
    parsed.map(WallTime::from_unix_nanos).ok_or_else(|| {
        WebError::BadRequest(format!(
            "query parameter {name}: {value:?} is not a time such as 2026-11-19T12:01:07Z (a + must be written %2B)"
        ))
    })
}

/// The values of a path.
pub(crate) fn path<T>(path: Result<Path<T>, PathRejection>) -> Result<T, WebError> {
    path.map(|Path(value)| value).map_err(|rejection| {
        let text = rejection.body_text();
        WebError::BadRequest(text.strip_prefix("Invalid URL: ").unwrap_or(&text).to_owned())
    })
}
