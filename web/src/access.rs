//! Who may ask. So far everyone who reaches the address, which is why that is this machine alone unless the
//! configuration says otherwise. Tokens with roles will be checked here, in front of every route.

use std::net::{IpAddr, SocketAddr};

use axum::extract::{Request, State};
use axum::http::header::{HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, Method};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::config::{Problem, WebConfig};
use crate::error::WebError;
use crate::state::App;

/// The address to listen on, if the configuration allows it.
pub(crate) fn listen_address(config: &WebConfig) -> Result<SocketAddr, Problem> {
    let problem = |message| Problem { key: "listen", message };
    let address: SocketAddr = config.listen.parse().map_err(|_| {
        problem(format!(
            "{:?} is not an address with a port: write it like 127.0.0.1:8040 or [::1]:8040",
            config.listen
        ))
    })?;
    if address.ip().is_loopback() || config.allow_unauthenticated {
        return Ok(address);
    }
    Err(problem(format!(
        "{address} can be reached from other machines, and access is not restricted yet: everyone who reaches \
         it could read all hosts, configurations and measurements; listen on 127.0.0.1, or set \
         allow_unauthenticated = true if that is intended"
    )))
}

/// Whether a request's host names this machine.
fn is_this_machine(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => host.split(':').next().unwrap_or(host),
    };
    let address = name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    address || name.eq_ignore_ascii_case("localhost") || name.to_ascii_lowercase().ends_with(".localhost")
}

/// Answers only to names of this machine while access is not restricted: a page from elsewhere whose name was made
/// to point here (DNS rebinding) would otherwise read everything through the browser of whoever opened it.
pub(crate) async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let host = request.headers().get(HOST).and_then(|host| host.to_str().ok()).map(str::to_owned);
    match host {
        Some(host) if app.this_machine_alone && !is_this_machine(&host) => {
            WebError::OtherHost(host).into_response()
        }
        _ => next.run(request).await,
    }
}

/// Lets only this dashboard's own pages and programs change something. A page from elsewhere could otherwise send the
/// request from the browser of whoever opened it (cross-site request forgery). Browsers say where a request comes from
/// (`Sec-Fetch-Site`, Fetch Metadata; older ones `Origin`) and no page can change that; programs say neither.
pub(crate) async fn own_site(request: Request, next: Next) -> Response {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS);
    if reads || is_own(request.headers()) {
        return next.run(request).await;
    }
    let origin = request.headers().get(ORIGIN).and_then(|origin| origin.to_str().ok());
    WebError::OtherSite(origin.unwrap_or("another site").to_owned()).into_response()
}

fn is_own(headers: &HeaderMap) -> bool {
    let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    if let Some(site) = text(HeaderName::from_static("sec-fetch-site")) {
        return matches!(site, "same-origin" | "none");
    }
    let Some(origin) = text(ORIGIN) else { return true };
    let authority = origin.split_once("://").map(|(_, authority)| authority);
    authority.is_some_and(|authority| text(HOST).is_some_and(|host| authority.eq_ignore_ascii_case(host)))
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn changes_come_from_this_site_or_from_programs() {
        let own = |pairs: &[(&'static str, &'static str)]| {
            let host = ("host", "localhost:8040");
            let pairs = pairs.iter().copied().chain([host]);
            is_own(
                &pairs
                    .map(|(name, value)| (HeaderName::from_static(name), HeaderValue::from_static(value)))
                    .collect(),
            )
        };
        assert!(own(&[]), "a program");
        assert!(own(&[("sec-fetch-site", "same-origin"), ("origin", "http://localhost:8040")]));
        assert!(own(&[("sec-fetch-site", "none")]), "typed by the user");
        assert!(own(&[("origin", "http://LOCALHOST:8040")]), "an old browser");
        for site in ["cross-site", "same-site", ""] {
            assert!(!own(&[("sec-fetch-site", site), ("origin", "http://localhost:8040")]), "{site}");
        }
        for origin in ["http://evil.example", "http://localhost:9999", "null", "localhost:8040"] {
            assert!(!own(&[("origin", origin)]), "{origin}");
        }
    }

    #[test]
    fn names_of_this_machine_are_known() {
        for host in
            ["127.0.0.1:8040", "localhost", "LOCALHOST:8040", "demo.localhost:1", "[::1]:8040", "127.9.9.9"]
        {
            assert!(is_this_machine(host), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example:8040", "192.0.2.7", "[2001:db8::1]:8040", ""] {
            assert!(!is_this_machine(host), "{host}");
        }
    }
}
