//! Who is let in over HTTP, and how often.
//!
//! An open fleet lets in whoever reaches the address. In a closed one whoever comes shows a token of a person's: programs in
//! the head `Authorization: Bearer …`, browsers in a cookie, which the page asks for once and no script can read. What a token lets its
//! bearer do is its scope; nothing is remembered of it here.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use consort_actors::clock::Clock;
use consort_actors::trust::{Keyring, TokenClaims, TokenError};
use consort_protocol::ids::FleetId;
use consort_protocol::trust::AccessScope;
use governor::clock::{Clock as _, MonotonicClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};
use serde_json::json;
use std::num::NonZeroU32;
use std::sync::Arc;
use std::time::Duration;

/// How many requests of one person's are taken in a second, in the long run and at once. A page asks for a handful when it is opened.
const LOOKS: (NonZeroU32, NonZeroU32) = (NonZeroU32::new(50).unwrap(), NonZeroU32::new(100).unwrap());

/// The same of requests that change something: more than a person makes, and fewer than would keep a fleet busy.
const CHANGES: (NonZeroU32, NonZeroU32) = (NonZeroU32::new(10).unwrap(), NonZeroU32::new(50).unwrap());

type Limiter = RateLimiter<String, HashMapStateStore<String>, MonotonicClock>;

/// Decides who is let in.
#[derive(Clone)]
pub struct Admission {
    closed: Option<Closed>,
    looks: Arc<Limiter>,
    changes: Arc<Limiter>,
}

#[derive(Clone)]
struct Closed {
    fleet: FleetId,
    keyring: Arc<Keyring>,
    clock: Clock,
}

/// Somebody who has been let in, by a token.
#[derive(Debug, Clone)]
pub struct AuthenticatedClient {
    /// Who it is.
    pub claims: TokenClaims,
    token: String,
}

/// Why somebody is not let in.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum AdmissionError {
    /// There is no token.
    #[error(
        "this fleet is closed: show a token, as Authorization: Bearer TOKEN; `consort token --certs DIR` makes one"
    )]
    MissingToken,
    /// The token is no good.
    #[error("{0}")]
    InvalidToken(#[from] TokenError),
    /// The token is good for less.
    #[error("{} may {}, and this takes scope {needed}", visitor.name, visitor.scope)]
    InsufficientScope {
        /// Whose it is.
        visitor: TokenClaims,
        /// What it takes.
        needed: AccessScope,
    },
    /// Too many requests have come.
    #[error("too many requests; the next one is taken in {} s", after.as_secs() + 1)]
    RateLimited {
        /// After how long one is taken.
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
        let mut response = (status, kind, json!({ "error": self.to_string() }).to_string()).into_response();
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
    /// Lets in everybody.
    pub fn open() -> Admission {
        Admission { closed: None, looks: Arc::new(limiter(LOOKS)), changes: Arc::new(limiter(CHANGES)) }
    }

    /// Lets in who shows a token of this fleet's; if there is no keyring to judge by, everybody.
    pub fn for_fleet(fleet: &FleetId, keyring: Option<Arc<Keyring>>, clock: Clock) -> Admission {
        let closed = keyring.map(|keyring| Closed { fleet: fleet.clone(), keyring, clock });
        Admission { closed, ..Admission::open() }
    }

    /// Whose token this is.
    ///
    /// # Errors
    /// [`NotAdmitted::Token`]; in an open fleet there are none.
    pub fn verify_token(&self, token: &str) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let Some(Closed { keyring, clock, .. }) = &self.closed else { return Ok(None) };
        let visitor = keyring.verify_token(token, Duration::from_millis(clock.wall_ms()))?;
        Ok(Some(AuthenticatedClient { claims: visitor, token: token.to_owned() }))
    }

    /// Who makes a request; nobody in particular in an open fleet.
    ///
    /// # Errors
    /// [`NotAdmitted`] without a token that is good.
    pub fn authenticate(&self, headers: &HeaderMap) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let Some(Closed { fleet, .. }) = &self.closed else { return Ok(None) };
        self.verify_token(shown(headers, &cookie_name(fleet)).ok_or(AdmissionError::MissingToken)?)
    }

    /// Whether a guest who was let in still would be: tokens end, and certificates are revoked.
    pub fn is_still_valid(&self, guest: Option<&AuthenticatedClient>) -> bool {
        guest.is_none_or(|guest| self.verify_token(&guest.token).is_ok())
    }

    /// Lets in a request that takes this scope, if it may be made and not too many have come.
    fn admit(&self, headers: &HeaderMap, needed: AccessScope) -> Result<Option<AuthenticatedClient>, AdmissionError> {
        let guest = self.authenticate(headers)?;
        if let Some(AuthenticatedClient { claims: visitor, .. }) = &guest
            && visitor.scope < needed
        {
            return Err(AdmissionError::InsufficientScope { visitor: visitor.clone(), needed });
        }
        let limiter = if needed == AccessScope::Read { &self.looks } else { &self.changes };
        let name = guest.as_ref().map(|guest| guest.claims.name.to_string()).unwrap_or_default();
        limiter.check_key(&name).map_err(|until| {
            let after = until.wait_time_from(limiter.clock().now());
            AdmissionError::RateLimited { after }
        })?;
        Ok(guest)
    }

    /// The head that has a browser show this token with each request, or none any more if it is empty.
    pub fn cookie(&self, token: &str, secure: bool) -> Option<(HeaderName, HeaderValue)> {
        let Closed { fleet, keyring, clock } = self.closed.as_ref()?;
        let now = Duration::from_millis(clock.wall_ms());
        let left =
            keyring.verify_token(token, now).map_or(Duration::ZERO, |visitor| visitor.expires.saturating_sub(now));
        let name = cookie_name(fleet);
        let secure = if secure { "; Secure" } else { "" };
        let cookie = format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}{secure}", left.as_secs());
        Some((header::SET_COOKIE, HeaderValue::from_str(&cookie).ok()?))
    }
}

fn limiter((steady, burst): (NonZeroU32, NonZeroU32)) -> Limiter {
    RateLimiter::hashmap_with_clock(Quota::per_second(steady).allow_burst(burst), MonotonicClock)
}

/// Browsers know cookies by host and not by port: each fleet has one of its own.
fn cookie_name(fleet: &FleetId) -> String {
    format!("consort-{fleet}")
}

/// The token in the heads of a request.
fn shown<'a>(headers: &'a HeaderMap, cookie: &str) -> Option<&'a str> {
    let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let bearer = text(header::AUTHORIZATION).and_then(|value| value.split_once(' '));
    let bearer = bearer.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer")).map(|(_, token)| token.trim());
    bearer.or_else(|| {
        let cookies = text(header::COOKIE)?.split(';').filter_map(|one| one.trim().split_once('='));
        cookies.filter(|(name, _)| *name == cookie).map(|(_, token)| token).find(|token| !token.is_empty())
    })
}

/// Lets a request through to what takes a scope; a guest is in its extensions, as `Option<Guest>`.
pub async fn admit(
    State((admission, needed)): State<(Admission, AccessScope)>,
    mut request: Request,
    next: Next,
) -> Response {
    match admission.admit(request.headers(), needed) {
        Ok(guest) => {
            request.extensions_mut().insert(guest);
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
    fn a_token_is_in_the_head_for_it_or_in_the_fleets_own_cookie() {
        let shown = |heads: &[(&'static str, &str)]| shown(&headers(heads), "consort-ward").map(str::to_owned);
        assert_eq!(shown(&[("authorization", "Bearer abc")]).as_deref(), Some("abc"));
        assert_eq!(shown(&[("authorization", "bearer  abc ")]).as_deref(), Some("abc"));
        assert_eq!(shown(&[("authorization", "Basic abc")]), None);
        assert_eq!(shown(&[("cookie", "a=b; consort-ward=abc; c=d")]).as_deref(), Some("abc"));
        assert_eq!(shown(&[("cookie", "consort-ward2=abc; consort-ward=")]), None);
        let both = [("authorization", "Bearer one"), ("cookie", "consort-ward=two")];
        assert_eq!(shown(&both).as_deref(), Some("one"), "who says it on purpose means it");
    }

    #[test]
    fn beyond_its_share_nobody_is_served_until_time_has_passed() {
        let admission = Admission::open();
        let burst = CHANGES.1.get();
        let taken = (0..2 * burst).filter(|_| admission.admit(&HeaderMap::new(), AccessScope::Submit).is_ok()).count();
        assert!(taken >= burst as usize && taken < 2 * burst as usize, "{taken}");
        let refused = admission.admit(&HeaderMap::new(), AccessScope::Submit);
        assert!(matches!(refused, Err(AdmissionError::RateLimited { .. })), "{refused:?}");
        assert!(admission.admit(&HeaderMap::new(), AccessScope::Read).is_ok(), "who looks is not in its way");
        assert_eq!(refused.unwrap_err().into_response().headers()[header::RETRY_AFTER], "1");
    }
}
