//! Same-origin check: requests are accepted from this page and from programs, not from pages of
//! other sites.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, SocketAddr};

/// Content security policy: the page loads its own files and connects to its own server, nothing
/// else.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Middleware: checks a request, and adds the security headers to each response.
pub(super) async fn check_origin(State(address): State<SocketAddr>, request: Request, next: Next) -> Response {
    let checked = check(address, request.method(), request.headers());
    let mut response = match checked {
        Ok(()) => next.run(request).await,
        Err(problem) => (StatusCode::FORBIDDEN, problem).into_response(),
    };
    let headers = response.headers_mut();
    let mut set = |name: HeaderName, value: &'static str| headers.insert(name, HeaderValue::from_static(value));
    set(header::CONTENT_SECURITY_POLICY, POLICY);
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::REFERRER_POLICY, "no-referrer");
    set(header::CACHE_CONTROL, "no-store");
    response
}

/// Checks whether a request is allowed.
fn check(address: SocketAddr, method: &Method, headers: &HeaderMap) -> Result<(), &'static str> {
    let text = |name: HeaderName| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST).ok_or("a request names its host")?;
    if address.ip().is_loopback() && !is_loopback(host) {
        return Err("this dashboard is bound to loopback: open it as localhost or 127.0.0.1");
    }
    // Browsers send the origin of a page with each change and WebSocket; other programs do not.
    let changes = method != Method::GET && method != Method::HEAD;
    let Some(origin) = text(header::ORIGIN) else {
        let site = text(HeaderName::from_static("sec-fetch-site"));
        let own = site.is_none_or(|site| site == "same-origin" || site == "none");
        return if own || !changes { Ok(()) } else { Err("requests are accepted from the dashboard's own page only") };
    };
    let own = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://")) == Some(host);
    if own { Ok(()) } else { Err("requests are accepted from the dashboard's own page only") }
}

/// Checks whether a host, as named by a browser, is the machine itself.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(rest),
        None => host.split(':').next().unwrap_or(host),
    };
    name == "localhost" || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_allowed(bound: &str, method: &Method, headers: &[(&'static str, &str)]) -> bool {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.insert(*name, HeaderValue::from_str(value).unwrap());
        }
        check(bound.parse().unwrap(), method, &map).is_ok()
    }

    #[test]
    fn only_the_page_itself_and_programs_may_make_changes() {
        let (bound, host) = ("127.0.0.1:8088", ("host", "127.0.0.1:8088"));
        let post = |more: &[(&'static str, &str)]| is_allowed(bound, &Method::POST, &[&[host], more].concat());
        assert!(post(&[("origin", "http://127.0.0.1:8088")]));
        assert!(post(&[]));
        assert!(!post(&[("origin", "http://127.0.0.1:9000")]));
        assert!(!post(&[("origin", "http://evil.example")]));
        assert!(!post(&[("origin", "null")]));
        assert!(!post(&[("sec-fetch-site", "cross-site")]));
        assert!(!is_allowed(bound, &Method::POST, &[]));
    }

    #[test]
    fn no_page_of_another_site_can_open_the_web_socket() {
        let get = |origin: &str| {
            is_allowed("127.0.0.1:8088", &Method::GET, &[("host", "localhost:8088"), ("origin", origin)])
        };
        assert!(get("http://localhost:8088"));
        assert!(!get("http://evil.example"));
    }

    #[test]
    fn a_loopback_address_answers_to_loopback_names_only() {
        let get = |bound: &str, host: &str| is_allowed(bound, &Method::GET, &[("host", host)]);
        for host in ["127.0.0.1:8088", "localhost:8088", "[::1]:8088", "localhost"] {
            assert!(get("127.0.0.1:8088", host), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example:8088", "192.0.2.1:8088", "127.0.0.1.evil.example"] {
            assert!(!get("127.0.0.1:8088", host), "{host}");
        }
        assert!(get("0.0.0.0:8088", "station-1:8088"));
    }
}
