//! Tokens that authenticate a person where a link requires no certificate, for example on the web
//! pages of a node.
//!
//! A token is a JSON Web Token (RFC 7519) in compact form, signed with the person's own key (EdDSA,
//! RFC 8037), with the person's certificate in its header (`x5c`, RFC 7515, 4.1.6). Every node that
//! trusts the fleet's authority can verify a token, and no list of tokens is needed. A token ends
//! at its own expiry, at the expiry of the certificate, or when the certificate is revoked. There
//! is a single algorithm and no choice: a token with another algorithm is rejected.
//!
//! ```text
//!  header.claims.signature~secret        claims: fleet, expiry, scope, SHA-256 of the secret
//!  └── forwarded part ────┘
//! ```
//!
//! A dashboard forwards requests without the secret, so a node that relays them cannot use the
//! token: pages ask for the secret, and only a node with the role `dashboard` may forward.

use super::keyring::{CertificateError, Keyring, VerifiedCertificate, format_span};
use base64::Engine as _;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use consort_protocol::ids::{FleetId, PersonId};
use consort_protocol::trust::{AccessScope, MissionRights, Principal};
use ring::digest::{SHA256, digest};
use ring::rand::{SystemRandom, generate};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Maximum length of a token, in bytes: more than a browser stores in a single cookie.
pub const TOKEN_MAX: usize = 4096;

/// Verified claims of a token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenClaims {
    /// Person that the token was issued to.
    pub name: PersonId,
    /// Scope of the token: at most that of the certificate.
    pub scope: AccessScope,
    /// Missions that the person may submit, by the certificate.
    pub missions: MissionRights,
    /// Expiry, in time since 1970.
    pub expires: Duration,
}

/// A token is rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// The text is not a token.
    #[error("malformed token: {0}; `consort token` makes a valid one")]
    Malformed(&'static str),
    /// Its certificate is invalid.
    #[error("invalid certificate in the token: {0}")]
    Certificate(#[from] CertificateError),
    /// The token was changed, or forged without the private key.
    #[error("the token was not signed with the key of its certificate")]
    Signature,
    /// The token was changed, or is the forwarded part of a token.
    #[error("the secret of the token, behind '~', is missing or wrong")]
    Secret,
    /// The system has no random numbers.
    #[error("the operating system gives no random numbers")]
    NoRandomness,
    /// The token has expired.
    #[error("the token expired {0} ago; `consort token` makes a new one")]
    Expired(String),
    /// The token was issued for another fleet.
    #[error("the token is for fleet {0}")]
    Fleet(FleetId),
    /// The token claims more than its certificate grants.
    #[error("the token claims scope {claimed}, but {name} has scope {has}")]
    Scope {
        /// Person that the token was issued to.
        name: PersonId,
        /// Scope claimed by the token.
        claimed: AccessScope,
        /// Scope granted by the certificate.
        has: AccessScope,
    },
    /// The certificate belongs to a node.
    #[error("the certificate belongs to {0}; tokens are for persons only")]
    Node(Principal),
}

const ALGORITHM: &str = "EdDSA";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    alg: String,
    x5c: [String; 1],
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claims {
    aud: FleetId,
    exp: u64,
    scope: String,
    secret_sha256: String,
}

/// Returns the part of a token that is forwarded with a request: the token without its secret.
pub fn forwarded_part(token: &str) -> &str {
    token.split_once('~').map_or(token, |(forwarded, _)| forwarded)
}

fn secret_hash(secret: &str) -> String {
    URL_SAFE_NO_PAD.encode(digest(&SHA256, secret.as_bytes()))
}

impl Keyring {
    /// Issues a token for this keyring's person, valid until the given time since 1970, with at
    /// most the given scope.
    ///
    /// # Errors
    /// [`TokenError`] if the principal is a node, or does not have the scope.
    pub fn issue_token(&self, scope: AccessScope, until: Duration) -> Result<String, TokenError> {
        let fleet = self.identity().fleet.clone();
        authorized_person(&self.identity().principal, scope)?;
        let header = Header { alg: ALGORITHM.to_owned(), x5c: [STANDARD.encode(self.own_certificate())] };
        let secret: [u8; 16] = generate(&SystemRandom::new()).map_err(|_| TokenError::NoRandomness)?.expose();
        let secret = URL_SAFE_NO_PAD.encode(secret);
        let secret_sha256 = secret_hash(&secret);
        let claims = Claims { aud: fleet, exp: until.as_secs(), scope: scope.to_string(), secret_sha256 };
        let signed = format!("{}.{}", encode_part(&header), encode_part(&claims));
        let signature = URL_SAFE_NO_PAD.encode(self.sign(signed.as_bytes()));
        Ok(format!("{signed}.{signature}~{secret}"))
    }

    /// Verifies a token at the given time since 1970.
    ///
    /// # Errors
    /// [`TokenError`]. No text causes a panic.
    pub fn verify_token(&self, token: &str, now: Duration) -> Result<TokenClaims, TokenError> {
        let (forwarded, secret) = token.split_once('~').unwrap_or((token, ""));
        let (claims, secret_sha256) = self.verify_signed_part(forwarded, now)?;
        match secret_hash(secret) == secret_sha256 {
            true => Ok(claims),
            false => Err(TokenError::Secret),
        }
    }

    /// Verifies the forwarded part of a token at the given time since 1970.
    ///
    /// # Errors
    /// [`TokenError`].
    pub(super) fn verify_forwarded_token(&self, token: &str, now: Duration) -> Result<TokenClaims, TokenError> {
        Ok(self.verify_signed_part(token, now)?.0)
    }

    /// Verifies the signed part of a token; returns its claims and the hash of its secret.
    fn verify_signed_part(&self, token: &str, now: Duration) -> Result<(TokenClaims, String), TokenError> {
        if token.len() > TOKEN_MAX {
            return Err(TokenError::Malformed("it is too long"));
        }
        let (signed, signature) =
            token.rsplit_once('.').ok_or(TokenError::Malformed("it does not consist of three parts"))?;
        let (header, claims) =
            signed.split_once('.').ok_or(TokenError::Malformed("it does not consist of three parts"))?;
        let header: Header = decode_part(header).ok_or(TokenError::Malformed("its header cannot be decoded"))?;
        if header.alg != ALGORITHM {
            return Err(TokenError::Malformed("its algorithm is not EdDSA"));
        }
        let [certificate] = header.x5c;
        let certificate =
            STANDARD.decode(certificate).map_err(|_| TokenError::Malformed("its certificate cannot be decoded"))?;
        let verified: VerifiedCertificate = self.verify_certificate(&certificate, now)?;
        let signature = URL_SAFE_NO_PAD.decode(signature).map_err(|_| TokenError::Signature)?;
        if !verified.verify(signed.as_bytes(), &signature) {
            return Err(TokenError::Signature);
        }
        let claims: Claims = decode_part(claims).ok_or(TokenError::Malformed("its claims cannot be decoded"))?;
        if claims.aud != self.identity().fleet {
            return Err(TokenError::Fleet(claims.aud));
        }
        if claims.exp <= now.as_secs() {
            return Err(TokenError::Expired(format_span(now.as_secs() - claims.exp)));
        }
        let scope = AccessScope::parse(&claims.scope).ok_or(TokenError::Malformed("its scope is unknown"))?;
        let (name, missions) = authorized_person(&verified.identity.principal, scope)?;
        let (name, missions, expires) = (name.clone(), missions.clone(), Duration::from_secs(claims.exp));
        Ok((TokenClaims { name, scope, missions, expires }, claims.secret_sha256))
    }
}

/// Returns the person and the missions that it may submit, if the principal may hold a token of the claimed
/// scope.
fn authorized_person(principal: &Principal, claimed: AccessScope) -> Result<(&PersonId, &MissionRights), TokenError> {
    match principal {
        Principal::Person { name, scope, missions } if claimed <= *scope => Ok((name, missions)),
        Principal::Person { name, scope, .. } => Err(TokenError::Scope { name: name.clone(), claimed, has: *scope }),
        node @ Principal::Node { .. } => Err(TokenError::Node(node.clone())),
    }
}

fn encode_part(value: &impl Serialize) -> String {
    URL_SAFE_NO_PAD.encode(serde_json::to_vec(value).expect("strings and numbers can be serialized"))
}

fn decode_part<T: for<'a> Deserialize<'a>>(part: &str) -> Option<T> {
    serde_json::from_slice(&URL_SAFE_NO_PAD.decode(part).ok()?).ok()
}
