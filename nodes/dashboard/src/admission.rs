//! Authentication, authorization and rate limits of HTTP requests.
//!
//! An open fleet admits every client that reaches the address. In a closed fleet each request
//! carries a person's token: programs send it in the header `Authorization: Bearer …`, browsers in
//! a cookie. The page asks for the token once, and no script can read the cookie. The token's scope
//! decides which requests are allowed. No state is kept here.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use consort_bus::clock::Clock;
use consort_bus::trust::{Keyring, TokenClaims, TokenError, forwarded_part};
use consort_protocol::api::ErrorReply;
use consort_protocol::ids::FleetId;
use consort_protocol::trust::AccessScope;
use governor::clock::{Clock as _, MonotonicClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::Duration;

/// Maximum number of requests of a single person per second, sustained and burst. A page makes a
/// handful of requests when it is opened.
const READS_PER_S: (NonZeroU32, NonZeroU32) = (NonZeroU32::new(50).unwrap(), NonZeroU32::new(100).unwrap());

/// The same limit for requests that change something: more than a person makes, and too few to keep
/// a fleet busy.
const WRITES_PER_S: (NonZeroU32, NonZeroU32) = (NonZeroU32::new(10).unwrap(), NonZeroU32::new(50).unwrap());

type Limiter = RateLimiter<String, HashMapStateStore<String>, MonotonicClock>;

/// Decides which requests are admitted.
#[derive(Clone)]
pub struct Admission {
    closed: Option<ClosedFleet>,
    reads: Arc<Limiter>,
    writes: Arc<Limiter>,
}

#[derive(Clone)]
struct ClosedFleet {
    fleet: FleetId,
    keyring: Arc<Keyring>,
    clock: Clock,
}

/// A client that was admitted with a token.
#[derive(Debug, Clone)]
pub struct AuthenticatedClient {
    /// Verified claims of the token.
    pub claims: TokenClaims,
    token: String,
}

impl AuthenticatedClient {
    /// Returns the part of the token that is forwarded with a request.
    pub(crate) fn forwarded_token(&self) -> &str {
        forwarded_part(&self.token)
    }
}

/// Reason why a request is not admitted.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum AdmissionError {
    /// The request has no token.
    #[error(
        "this fleet is closed: send a token, as Authorization: Bearer TOKEN; `consort token --certs DIR` makes a token"
    )]
    MissingToken,
    /// The token is not valid.
    #[error("{0}")]
    InvalidToken(#[from] TokenError),
    /// The token's scope does not cover the request.
    #[error("the token of {} has scope {}; this request needs scope {needed}", claims.name, claims.scope)]
    InsufficientScope {
        /// Claims of the token.
        claims: TokenClaims,
        /// Scope that the request needs.
        needed: AccessScope,
    },
    /// Too many requests have come.
    #[error("too many requests; retry after {} s", after.as_secs() + 1)]
    RateLimited {
        /// Time until the next request is accepted.
        after: Duration,
    },
}

impl IntoResponse for AdmissionError {
    fn into_response(self) -> Response {
        let status = match &self {
            AdmissionError::MissingToken | AdmissionError::InvalidToken(_) => StatusCode::UNAUTHORIZED,
            AdmissionError::InsufficientScope { .. } => StatusCode::FORBIDDEN,
            AdmissionError::RateLimited { .. } => StatusCode::TOO_MANY_REQUESTS,
        };
        let kind = [(header::CONTENT_TYPE, "application/json")];
        let mut response = (
            status,
            kind,
            serde_json::to_string(&ErrorReply::rejected(self.to_string())).expect("a reply serializes to JSON"),
        )
            .into_response();
        let headers = response.headers_mut();
        match self {
            AdmissionError::MissingToken | AdmissionError::InvalidToken(_) => {
                headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"consort\""));
            }
            AdmissionError::RateLimited { after } => {
                headers.insert(header::RETRY_AFTER, HeaderValue::from(after.as_secs() + 1));
            }
            AdmissionError::InsufficientScope { .. } => {}
        }
        response
    }
}

impl Admission {
    /// Admits every client.
    pub fn open() -> Admission {
        Admission { closed: None, reads: Arc::new(limiter(READS_PER_S)), writes: Arc::new(limiter(WRITES_PER_S)) }
    }

    /// Admits clients with a token of this fleet. Without a keyring every client is admitted.
    pub fn for_fleet(fleet: &FleetId, keyring: Option<Arc<Keyring>>, clock: Clock) -> Admission {
        let closed = keyring.map(|keyring| ClosedFleet { fleet: fleet.clone(), keyring, clock });
        Admission { closed, ..Admission::open() }
    }

    /// Verifies a token and returns its client.
    ///
    /// # Errors
    /// [`AdmissionError::InvalidToken`]. An open fleet returns no error.
    pub(crate) fn verify_token(&self, token: &str) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let Some(ClosedFleet { keyring, clock, .. }) = &self.closed else { return Ok(None) };
        let claims = keyring.verify_token(token, Duration::from_millis(clock.wall_ms()))?;
        Ok(Some(AuthenticatedClient { claims, token: token.to_owned() }))
    }

    /// Returns the client that makes a request; `None` in an open fleet.
    ///
    /// # Errors
    /// [`AdmissionError`] without a valid token.
    pub fn authenticate(&self, headers: &HeaderMap) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let Some(ClosedFleet { fleet, .. }) = &self.closed else { return Ok(None) };
        self.verify_token(token_of(headers, &cookie_name(fleet)).ok_or(AdmissionError::MissingToken)?)
    }

    /// Checks whether an admitted client would still be admitted: tokens expire, and certificates
    /// are revoked.
    pub(crate) fn is_still_valid(&self, client: Option<&AuthenticatedClient>) -> bool {
        client.is_none_or(|client| self.verify_token(&client.token).is_ok())
    }

    /// Admits a request that needs this scope, if the token allows it and the rate limit is not
    /// exceeded.
    fn admit(&self, headers: &HeaderMap, needed: AccessScope) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let client = self.authenticate(headers)?;
        if let Some(AuthenticatedClient { claims, .. }) = &client
            && claims.scope < needed
        {
            return Err(AdmissionError::InsufficientScope { claims: claims.clone(), needed });
        }
        let limiter = if needed == AccessScope::Read { &self.reads } else { &self.writes };
        let name = client.as_ref().map(|client| client.claims.name.to_string()).unwrap_or_default();
        limiter.check_key(&name).map_err(|until| {
            let after = until.wait_time_from(limiter.clock().now());
            AdmissionError::RateLimited { after }
        })?;
        Ok(client)
    }

    /// Returns the header that makes a browser send this token with each request. An empty token
    /// removes the cookie.
    pub(crate) fn cookie(&self, token: &str, secure: bool) -> Option<(HeaderName, HeaderValue)> {
        let ClosedFleet { fleet, keyring, clock } = self.closed.as_ref()?;
        let now = Duration::from_millis(clock.wall_ms());
        let left = keyring.verify_token(token, now).map_or(Duration::ZERO, |claims| claims.expires.saturating_sub(now));
        let name = cookie_name(fleet);
        let secure = if secure { "; Secure" } else { "" };
        let cookie = format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}{secure}", left.as_secs());
        Some((header::SET_COOKIE, HeaderValue::from_str(&cookie).ok()?))
    }
}

fn limiter((steady, burst): (NonZeroU32, NonZeroU32)) -> Limiter {
    RateLimiter::hashmap_with_clock(Quota::per_second(steady).allow_burst(burst), MonotonicClock)
}

/// Returns the cookie name of a fleet. Browsers store cookies by host and not by port, so each
/// fleet needs its own name.
fn cookie_name(fleet: &FleetId) -> String {
    format!("consort-{fleet}")
}

/// Returns the token in the headers of a request.
fn token_of<'a>(headers: &'a HeaderMap, cookie: &str) -> Option<&'a str> {
    let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let bearer = text(header::AUTHORIZATION).and_then(|value| value.split_once(' '));
    let bearer = bearer.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer")).map(|(_, token)| token.trim());
    bearer.or_else(|| {
        let cookies = text(header::COOKIE)?.split(';').filter_map(|one| one.trim().split_once('='));
        cookies.filter(|(name, _)| *name == cookie).map(|(_, token)| token).find(|token| !token.is_empty())
    })
}

/// Middleware: passes requests that have the scope. The client is stored in the request's
/// extensions as `Option<AuthenticatedClient>`.
pub async fn admit(
    State((admission, needed)): State<(Admission, AccessScope)>,
    mut request: Request,
    next: Next,
) -> Response {
    match admission.admit(request.headers(), needed) {
        Ok(client) => {
            request.extensions_mut().insert(client);
            next.run(request).await
        }
        Err(refused) => refused.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(heads: &[(&'static str, &str)]) -> HeaderMap {
        let heads = heads.iter().map(|(name, value)| (HeaderName::from_static(name), value.parse().unwrap()));
        heads.collect()
    }

    #[test]
    fn a_token_is_read_from_the_header_or_from_the_fleets_cookie() {
        let token_of = |heads: &[(&'static str, &str)]| token_of(&headers(heads), "consort-ward").map(str::to_owned);
        assert_eq!(token_of(&[("authorization", "Bearer abc")]).as_deref(), Some("abc"));
        assert_eq!(token_of(&[("authorization", "bearer  abc ")]).as_deref(), Some("abc"));
        assert_eq!(token_of(&[("authorization", "Basic abc")]), None);
        assert_eq!(token_of(&[("cookie", "a=b; consort-ward=abc; c=d")]).as_deref(), Some("abc"));
        assert_eq!(token_of(&[("cookie", "consort-ward2=abc; consort-ward=")]), None);
        let both = [("authorization", "Bearer one"), ("cookie", "consort-ward=two")];
        assert_eq!(token_of(&both).as_deref(), Some("one"), "the explicit header prevails");
    }

    #[test]
    fn requests_above_the_rate_limit_are_rejected_until_time_passes() {
        let admission = Admission::open();
        let burst = WRITES_PER_S.1.get();
        let taken = (0..2 * burst).filter(|_| admission.admit(&HeaderMap::new(), AccessScope::Submit).is_ok()).count();
        assert!(taken >= burst as usize && taken < 2 * burst as usize, "{taken}");
        let refused = admission.admit(&HeaderMap::new(), AccessScope::Submit);
        assert!(matches!(refused, Err(AdmissionError::RateLimited { .. })), "{refused:?}");
        assert!(admission.admit(&HeaderMap::new(), AccessScope::Read).is_ok(), "read requests have their own limit");
        assert_eq!(refused.unwrap_err().into_response().headers()[header::RETRY_AFTER], "1");
    }
}
