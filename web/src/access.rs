//! Checks of each request: the host name by which the request addresses this server, and the site of the page that sends
//! the request.
//!
//! There is no login: everyone who reaches the server's address may use the server. Without a
//! configuration that allows other addresses, the server therefore listens on loopback addresses only.

use std::net::Ipv6Addr;

use axum::extract::{Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, Method};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::error::WebError;
use crate::server_names::has_host_name_syntax;
use crate::state::App;

/// Returns the host of `HOST[:PORT]`, where `HOST` is a name, an IPv4 address or an IPv6 address in brackets. Returns `None` for any
/// other form.
fn parse_host(authority: &str) -> Option<&str> {
    // Every other form is an error: a text that this parser and another program read differently could pass the check of the name.
    let host_end = authority
        .find(']')
        .map_or_else(|| authority.find(':').unwrap_or(authority.len()), |bracket| bracket + 1);
    let (host, port) = authority.split_at(host_end);
    let is_host_valid = match host.strip_prefix('[') {
        Some(rest) => rest.strip_suffix(']')?.parse::<Ipv6Addr>().is_ok(),
        None => has_host_name_syntax(host),
    };
    let is_port_valid = port.is_empty() || port.strip_prefix(':').is_some_and(is_port);
    (is_host_valid && is_port_valid).then_some(host)
}

/// Returns whether a text is a number from 0 to 65535 without a sign.
fn is_port(text: &str) -> bool {
    // `parse` alone would accept a plus sign.
    text.bytes().all(|digit| digit.is_ascii_digit()) && text.parse::<u16>().is_ok()
}

/// Returns the host that a request addresses.
///
/// # Errors
/// `BadRequest` unless exactly one valid Host header is present, and it agrees with the request's target.
fn requested_host(request: &Request) -> Result<&str, WebError> {
    let bad_request = |text: &str| WebError::BadRequest(text.to_owned());
    let mut host_headers = request.headers().get_all(HOST).iter();
    let host_header = match (host_headers.next(), host_headers.next()) {
        (Some(host_header), None) => host_header,
        (None, _) => return Err(bad_request("the request has no Host header; send one")),
        (Some(_), Some(_)) => return Err(bad_request("the request has several Host headers; send one")),
    };
    let parsed_host = host_header.to_str().ok().and_then(|text| Some((text, parse_host(text)?)));
    let (authority, host) = parsed_host
        .ok_or_else(|| bad_request("the Host header is not a name or address with an optional port"))?;
    // A request to a proxy names the server in its target, too (RFC 9112, 3.2.2). Only the name in the Host header is
    // checked later, so the two names must be equal.
    match request.uri().authority() {
        Some(target) if !target.as_str().eq_ignore_ascii_case(authority) => {
            Err(bad_request("the Host header and the request's target name different servers"))
        }
        _ => Ok(host),
    }
}

/// Rejects requests that address a host name other than the names of this server ([`crate::server_names::ServerNames`]).
pub(crate) async fn reject_unknown_host_names(
    State(app): State<App>,
    request: Request,
    next: Next,
) -> Response {
    match requested_host(&request) {
        Ok(host) if !app.server_names.contains(host) => WebError::OtherHost(host.to_owned()).into_response(),
        Ok(_) => next.run(request).await,
        Err(error) => error.into_response(),
    }
}

/// Rejects requests that change data and come from a page of another site.
///
/// Such a page could otherwise send the request through the browser of a user who opens it (cross-site request forgery). Browsers report
/// the origin of a request in `Sec-Fetch-Site` (Fetch Metadata) and `Origin`, which no page can change. Programs send neither header.
pub(crate) async fn reject_cross_site_changes(request: Request, next: Next) -> Response {
    let only_reads = matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS);
    if only_reads || is_own_page_or_program(request.headers()) {
        return next.run(request).await;
    }
    let origin = request.headers().get(ORIGIN).and_then(|origin| origin.to_str().ok());
    WebError::OtherSite(origin.unwrap_or("another site").to_owned()).into_response()
}

fn is_own_page_or_program(headers: &HeaderMap) -> bool {
    let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    let site = text(HeaderName::from_static("sec-fetch-site"));
    // `none`: the user entered the address or opened a bookmark.
    if site.is_some_and(|site| !matches!(site, "same-origin" | "none")) {
        return false;
    }
    // Browsers send `Sec-Fetch-Site` only over HTTPS and to their own machine. For all other requests, the origin is
    // checked. A program sends no origin, and a browser sends one with every request that changes data.
    let Some(origin) = text(ORIGIN) else { return true };
    let authority = origin.split_once("://").map(|(_, authority)| authority);
    authority.is_some_and(|authority| text(HOST).is_some_and(|host| authority.eq_ignore_ascii_case(host)))
}

#[cfg(test)]
mod tests {
    use axum::http::{HeaderValue, Version};

    use super::*;

    #[test]
    fn only_own_pages_and_programs_may_change_data() {
        let is_accepted = |pairs: &[(&'static str, &'static str)]| {
            let host = ("host", "localhost:8040");
            let pairs = pairs.iter().copied().chain([host]);
            is_own_page_or_program(
                &pairs
                    .map(|(name, value)| (HeaderName::from_static(name), HeaderValue::from_static(value)))
                    .collect(),
            )
        };
        assert!(is_accepted(&[]), "a program sends neither header");
        assert!(is_accepted(&[("sec-fetch-site", "same-origin"), ("origin", "http://localhost:8040")]));
        assert!(is_accepted(&[("sec-fetch-site", "none")]), "the user entered the address");
        assert!(is_accepted(&[("origin", "http://LOCALHOST:8040")]), "a browser without Sec-Fetch-Site");
        for site in ["cross-site", "same-site", ""] {
            assert!(!is_accepted(&[("sec-fetch-site", site), ("origin", "http://localhost:8040")]), "{site}");
        }
        assert!(!is_accepted(&[("sec-fetch-site", "same-origin"), ("origin", "http://evil.example")]));
        for origin in ["http://evil.example", "http://localhost:9999", "null", "localhost:8040"] {
            assert!(!is_accepted(&[("origin", origin)]), "{origin}");
        }
    }

    #[test]
    fn host_has_a_name_or_address_and_optional_port() {
        for (authority, host) in [
            ("a.example", "a.example"),
            ("a.example:0", "a.example"),
            ("127.0.0.1:65535", "127.0.0.1"),
            ("[::1]", "[::1]"),
            ("[2001:db8::1]:8040", "[2001:db8::1]"),
            ("robot_7.local.:8040", "robot_7.local."),
        ] {
            assert_eq!(parse_host(authority), Some(host), "{authority}");
        }
        for wrong in [
            "",
            ":8040",
            "[::1]evil.example",
            "[::1].evil.example",
            "[::1]]",
            "[[::1]]",
            "[::1",
            "::1",
            "::1]",
            "evil.example[::1]",
            "[evil.example]",
            "[127.0.0.1]",
            "[fe80::1%25eth0]",
            "localhost:",
            "localhost:65536",
            "localhost:99999999",
            "localhost:+80",
            "localhost:80:80",
            "localhost:80/",
            "localhost:http",
            "localhost/",
            "localhost?",
            "localhost,evil.example",
            "evil.example@localhost",
            "a b",
            "%6cocalhost",
            "localhost\\evil.example",
        ] {
            assert_eq!(parse_host(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn request_names_exactly_one_host() {
        let host = |request: axum::http::request::Builder| {
            let request = request.body(axum::body::Body::empty()).expect("a request");
            requested_host(&request).map(str::to_owned)
        };
        let get = |target: &str| Request::get(target);
        assert_eq!(host(get("/").header(HOST, "a.example:8040")).expect("one Host header"), "a.example");
        assert_eq!(host(get("http://[::1]:80/").header(HOST, "[::1]:80")).expect("equal names"), "[::1]");
        assert_eq!(
            host(get("http://A.example/").header(HOST, "a.example")).expect("equal names"),
            "a.example"
        );
        for wrong in [
            get("/"),
            get("/").version(Version::HTTP_10),
            get("/").header(HOST, "a.example").header(HOST, "a.example"),
            get("/").header(HOST, "a b"),
            get("/").header(HOST, ""),
            get("/").header(HOST, "a.example@127.0.0.1"),
            get("http://127.0.0.1/"),
            get("http://127.0.0.1/").header(HOST, "evil.example"),
            get("http://evil.example/").header(HOST, "127.0.0.1"),
            get("http://127.0.0.1:80/").header(HOST, "127.0.0.1:81"),
            get("http://evil.example@127.0.0.1/").header(HOST, "127.0.0.1"),
        ] {
            assert!(matches!(host(wrong), Err(WebError::BadRequest(_))));
        }
    }
}
