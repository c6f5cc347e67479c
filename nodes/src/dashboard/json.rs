//! What is sent to the server and answered by it, in JSON.

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// The head of an answer.
pub(super) const JSON_HEADERS: [(header::HeaderName, &str); 1] = [(header::CONTENT_TYPE, "application/json")];

/// Why a body is not taken.
pub(super) type Rejection = (StatusCode, [(header::HeaderName, &'static str); 1], String);

/// What somebody sends, which is JSON.
pub(super) fn parse_body<T: DeserializeOwned>(headers: &HeaderMap, body: &[u8]) -> Result<T, Rejection> {
    let refusal = |status, what: &str| (status, JSON_HEADERS, json!({ "error": what }).to_string());
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or("");
    if kind.split(';').next().map(str::trim) != Some("application/json") {
        return Err(refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, "a request is application/json"));
    }
    serde_json::from_slice(body)
        .map_err(|mistake| refusal(StatusCode::BAD_REQUEST, &format!("the request is not as it should be: {mistake}")))
}

/// An answer of what is wrong.
pub(super) fn error_reply(status: StatusCode, what: &str) -> Response {
    json_reply(status, &json!({ "error": what }))
}

/// An answer.
pub(super) fn json_reply(status: StatusCode, value: &Value) -> Response {
    (status, JSON_HEADERS, value.to_string()).into_response()
}
