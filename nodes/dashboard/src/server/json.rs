//! JSON requests and replies of the server.

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use consort_protocol::api::ErrorReply;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Headers of a JSON reply.
pub(super) const JSON_HEADERS: [(header::HeaderName, &str); 1] = [(header::CONTENT_TYPE, "application/json")];

/// Reply to an invalid body.
pub(super) type Rejection = (StatusCode, [(header::HeaderName, &'static str); 1], String);

/// Parses the JSON body of a request.
pub(super) fn parse_body<T: DeserializeOwned>(headers: &HeaderMap, body: &[u8]) -> Result<T, Rejection> {
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or("");
    if kind.split(';').next().map(str::trim) != Some("application/json") {
        return Err(rejection(StatusCode::UNSUPPORTED_MEDIA_TYPE, "a request must be application/json"));
    }
    serde_json::from_slice(body)
        .map_err(|mistake| rejection(StatusCode::BAD_REQUEST, &format!("the request is not valid: {mistake}")))
}

/// Returns the rejection of a request.
pub(super) fn rejection(status: StatusCode, what: &str) -> Rejection {
    (status, JSON_HEADERS, json(&ErrorReply::rejected(what)))
}

/// Returns an error reply.
pub(super) fn error_reply(status: StatusCode, what: &str) -> Response {
    rejection(status, what).into_response()
}

/// Returns a JSON reply.
pub(super) fn json_reply(status: StatusCode, value: &impl Serialize) -> Response {
    (status, JSON_HEADERS, json(value)).into_response()
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("a reply serializes to JSON")
}
