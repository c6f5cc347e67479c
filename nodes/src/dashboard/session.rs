//! How a browser comes to show a token with each request: the page hands it over once, and gets a cookie that no script can read.

use super::json::{json_reply, parse_body};
use super::routes::DashboardState;
use crate::admission::{AdmissionError, AuthenticatedClient};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};

/// What the page hands over.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Shown {
    token: String,
}

/// Who is asking, as the page shows it: whom it takes for whom, and what that lets them do.
fn described(guest: Option<&AuthenticatedClient>) -> Value {
    match guest {
        None => json!({ "closed": false }),
        Some(AuthenticatedClient { claims: visitor, .. }) => json!({
            "closed": true, "name": visitor.name, "scope": visitor.scope.as_str(), "until_s": visitor.expires.as_secs(),
        }),
    }
}

/// Whose session it is, if anybody's.
pub(super) async fn current(State(shared): State<DashboardState>, headers: HeaderMap) -> Response {
    match shared.admission.authenticate(&headers) {
        Ok(guest) => json_reply(StatusCode::OK, &described(guest.as_ref())),
        Err(refused) => refused.into_response(),
    }
}

/// Begins a session with a token.
pub(super) async fn begin(State(shared): State<DashboardState>, headers: HeaderMap, body: Bytes) -> Response {
    let Shown { token } = match parse_body(&headers, &body) {
        Ok(shown) => shown,
        Err(refusal) => return refusal.into_response(),
    };
    let token = token.trim();
    match shared.admission.verify_token(token) {
        Ok(guest) => {
            let answered = json_reply(StatusCode::OK, &described(guest.as_ref()));
            with_cookie(&shared, token, &headers, answered)
        }
        Err(refused) => refused.into_response(),
    }
}

/// Ends a session: the browser forgets the token.
pub(super) async fn end(State(shared): State<DashboardState>, headers: HeaderMap) -> Response {
    with_cookie(&shared, "", &headers, AdmissionError::MissingToken.into_response())
}

/// Has the browser keep a token. Where the page was had over HTTPS, from a proxy, it is shown over nothing else.
fn with_cookie(shared: &DashboardState, token: &str, headers: &HeaderMap, mut response: Response) -> Response {
    let origin = headers.get(header::ORIGIN).and_then(|origin| origin.to_str().ok());
    let secure = origin.is_some_and(|origin| origin.starts_with("https://"));
    response.headers_mut().extend(shared.admission.cookie(token, secure));
    response
}
