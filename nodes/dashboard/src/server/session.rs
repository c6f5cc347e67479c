//! Sessions of browsers: the page sends the token once, and gets a cookie that no script can read.

use super::json::{Rejection, json_reply, parse_body};
use super::state::DashboardState;
use crate::admission::{AdmissionError, AuthenticatedClient};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use consort_protocol::ids::PersonId;
use serde::{Deserialize, Serialize};

/// Body of a sign-in request.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SignIn {
    token: String,
}

/// The session of a client, for the page.
#[derive(Serialize)]
struct Session {
    /// True if the dashboard requires a token.
    closed: bool,
    #[serde(flatten)]
    client: Option<SessionClient>,
}

/// The person of a session.
#[derive(Serialize)]
struct SessionClient {
    name: PersonId,
    scope: &'static str,
    /// End of the token's validity, in seconds since 1970.
    until_s: u64,
}

impl Session {
    fn of(client: Option<&AuthenticatedClient>) -> Session {
        let person = client.map(|AuthenticatedClient { claims, .. }| SessionClient {
            name: claims.name.clone(),
            scope: claims.scope.as_str(),
            until_s: claims.expires.as_secs(),
        });
        Session { closed: person.is_some(), client: person }
    }
}

/// Returns the current session.
pub(super) async fn current(State(shared): State<DashboardState>, headers: HeaderMap) -> Response {
    match shared.admission.authenticate(&headers) {
        Ok(client) => json_reply(StatusCode::OK, &Session::of(client.as_ref())),
        Err(refused) => refused.into_response(),
    }
}

/// Begins a session with a token.
pub(super) async fn begin(
    State(shared): State<DashboardState>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Rejection> {
    let SignIn { token } = parse_body(&headers, &body)?;
    let token = token.trim();
    Ok(match shared.admission.verify_token(token) {
        Ok(client) => {
            let answered = json_reply(StatusCode::OK, &Session::of(client.as_ref()));
            with_cookie(&shared, token, &headers, answered)
        }
        Err(refused) => refused.into_response(),
    })
}

/// Ends a session: the browser deletes the cookie.
pub(super) async fn end(State(shared): State<DashboardState>, headers: HeaderMap) -> Response {
    with_cookie(&shared, "", &headers, AdmissionError::MissingToken.into_response())
}

/// Sets the cookie with a token. If the page was loaded over HTTPS, from a proxy, the cookie is
/// sent over nothing else.
fn with_cookie(shared: &DashboardState, token: &str, headers: &HeaderMap, mut response: Response) -> Response {
    let origin = headers.get(header::ORIGIN).and_then(|origin| origin.to_str().ok());
    let secure = origin.is_some_and(|origin| origin.starts_with("https://"));
    response.headers_mut().extend(shared.admission.cookie(token, secure));
    response
}
