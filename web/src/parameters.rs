//! Parsing of query and path parameters. An invalid value is rejected with a message that names its parameter.

use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use chrono::DateTime;
use peernet_clock::WallTime;
use peernet_logger::{Name, Slug};
use serde::de::DeserializeOwned;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::error::WebError;

/// Maximum number of node names in one request.
const MAX_NAMES: usize = 20;

/// The query string of a URL, deserialised.
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
                // The standard library's message for a letter in a number does not say what to do.
                let text = text.replace("invalid digit found in string", "give a whole number");
                Err(WebError::BadRequest(format!("query parameter {text}")))
            }
        }
    }
}

/// Parses a whole number within `range`; returns `default` if the parameter is absent.
pub(crate) fn parse_bounded<N: PartialOrd + Display + FromStr>(
    name: &str,
    value: Option<&str>,
    default: N,
    range: RangeInclusive<N>,
) -> Result<N, WebError> {
    let Some(text) = value else { return Ok(default) };
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| {
        let (from, to) = range.into_inner();
        WebError::BadRequest(format!(
            "query parameter {name}: {text:?} is not a whole number from {from} to {to}"
        ))
    })
}

/// Parses 1 to [`MAX_NAMES`] node names that are separated by commas.
pub(crate) fn parse_names(parameter: &str, text: &str) -> Result<Vec<Name>, WebError> {
    let names: Vec<Name> = text.split(',').filter(|name| !name.is_empty()).map(Name::from).collect();
    if names.is_empty() || names.len() > MAX_NAMES {
        let text = format!("query parameter {parameter}: give 1 to {MAX_NAMES} names, separated by commas");
        return Err(WebError::BadRequest(text));
    }
    Ok(names)
}

/// Parses the name of a host or pipeline.
pub(crate) fn parse_slug(name: &str, value: &str) -> Result<Slug, WebError> {
    value.parse().map_err(|error| WebError::BadRequest(format!("query parameter {name}: {error}")))
}

/// Parses a time in RFC 3339.
pub(crate) fn parse_time(name: &str, value: &str) -> Result<WallTime, WebError> {
    let parsed = DateTime::parse_from_rfc3339(value).ok().and_then(|time| time.timestamp_nanos_opt());
    parsed.map(WallTime::from_unix_nanos).ok_or_else(|| {
        WebError::BadRequest(format!(
            "query parameter {name}: {value:?} is not a time such as 2026-11-19T12:01:07Z (a + must be written %2B)"
        ))
    })
}

/// Returns the parameters of a path.
///
/// # Errors
/// `BadRequest` when a parameter is invalid; the text names the parameter.
pub(crate) fn path<T>(path: Result<Path<T>, PathRejection>) -> Result<T, WebError> {
    path.map(|Path(value)| value).map_err(|rejection| {
        let text = rejection.body_text();
        WebError::BadRequest(text.strip_prefix("Invalid URL: ").unwrap_or(&text).to_owned())
    })
}
