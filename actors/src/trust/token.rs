//! Tokens: what a person shows where a link asks for no certificate, as to a page that a node serves.
//!
//! A token is a JSON Web Token (RFC 7519) in compact form, signed with the person's own key (EdDSA, RFC 8037), with the person's
//! certificate in its head (`x5c`, RFC 7515, 4.1.6). So whoever trusts the fleet's authority can check one, nobody keeps a list of
//! them, and a token ends with its own time, with the certificate, or when that is revoked. There is one algorithm and nothing to be
//! chosen: a token that says anything else of itself is none.

use super::keyring::{CertificateError, Keyring, VerifiedCertificate, format_span};
use base64::Engine as _;
use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
use consort_protocol::ids::{FleetId, PersonId};
use consort_protocol::trust::{AccessScope, Principal};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The longest token that is looked at, in bytes: more than a browser keeps as one cookie.
pub const TOKEN_MAX: usize = 4096;

/// Who shows a token, and what that lets them do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenClaims {
    /// Whose it is.
    pub name: PersonId,
    /// What the bearer may do: at most what the certificate says.
    pub scope: AccessScope,
    /// Until when, in time since 1970.
    pub expires: Duration,
}

/// Why a token lets nobody do anything.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// It is none.
    #[error("it is no token: {0}; `consort token` makes one")]
    Malformed(&'static str),
    /// Its certificate is not believed.
    #[error("its certificate is not believed: {0}")]
    Certificate(#[from] CertificateError),
    /// It was changed, or made by somebody who has seen the certificate and not the key.
    #[error("it was not signed with the key of its certificate")]
    Signature,
    /// It has ended.
    #[error("it ended {0} ago; `consort token` makes a new one")]
    Expired(String),
    /// It is for the pages of another fleet.
    #[error("it is for fleet {0}")]
    Fleet(FleetId),
    /// It claims more than the certificate gives.
    #[error("it claims scope {claimed}, where {name} has scope {has}")]
    Scope {
        /// Whose it is.
        name: PersonId,
        /// What the token says.
        claimed: AccessScope,
        /// What the certificate says.
        has: AccessScope,
    },
    /// The certificate is a node's.
    #[error("it is {0}'s, and tokens are people's")]
    Node(Principal),
}

const ALGORITHM: &str = "EdDSA";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    alg: String,
    x5c: [String; 1],
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claims {
    aud: FleetId,
    exp: u64,
    scope: String,
}

impl Keyring {
    /// A token of its bearer's, good until an instant since 1970 and for no more than this scope.
    ///
    /// # Errors
    /// [`TokenError`] if the bearer is a node, or has not that scope.
    pub fn issue_token(&self, scope: AccessScope, until: Duration) -> Result<String, TokenError> {
        let fleet = self.identity().fleet.clone();
        may(&self.identity().principal, scope)?;
        let head = Head { alg: ALGORITHM.to_owned(), x5c: [STANDARD.encode(self.own_certificate())] };
        let claims = Claims { aud: fleet, exp: until.as_secs(), scope: scope.to_string() };
        let signed = format!("{}.{}", part(&head), part(&claims));
        let signature = URL_SAFE_NO_PAD.encode(self.sign(signed.as_bytes()));
        Ok(format!("{signed}.{signature}"))
    }

    /// Whose token a text is, at an instant since 1970.
    ///
    /// # Errors
    /// [`TokenError`]; whatever the text is, this does not panic.
    pub fn verify_token(&self, token: &str, now: Duration) -> Result<TokenClaims, TokenError> {
        if token.len() > TOKEN_MAX {
            return Err(TokenError::Malformed("it is too long"));
        }
        let (signed, signature) = token.rsplit_once('.').ok_or(TokenError::Malformed("it has not three parts"))?;
        let (head, claims) = signed.split_once('.').ok_or(TokenError::Malformed("it has not three parts"))?;
        let head: Head = read(head).ok_or(TokenError::Malformed("its head cannot be read"))?;
        if head.alg != ALGORITHM {
            return Err(TokenError::Malformed("it is signed by another algorithm"));
        }
        let [certificate] = head.x5c;
        let certificate =
            STANDARD.decode(certificate).map_err(|_| TokenError::Malformed("its certificate cannot be read"))?;
        let card: VerifiedCertificate = self.verify_certificate(&certificate, now)?;
        let signature = URL_SAFE_NO_PAD.decode(signature).map_err(|_| TokenError::Signature)?;
        if !card.verify(signed.as_bytes(), &signature) {
            return Err(TokenError::Signature);
        }
        let claims: Claims = read(claims).ok_or(TokenError::Malformed("what it claims cannot be read"))?;
        if claims.aud != self.identity().fleet {
            return Err(TokenError::Fleet(claims.aud));
        }
        if claims.exp <= now.as_secs() {
            return Err(TokenError::Expired(format_span(now.as_secs() - claims.exp)));
        }
        let scope = AccessScope::parse(&claims.scope).ok_or(TokenError::Malformed("its scope is none"))?;
        let name = may(&card.identity.principal, scope)?.clone();
        Ok(TokenClaims { name, scope, expires: Duration::from_secs(claims.exp) })
    }
}

/// Whose token one of this scope would be.
fn may(bearer: &Principal, claimed: AccessScope) -> Result<&PersonId, TokenError> {
    match bearer {
        Principal::Person { name, scope } if claimed <= *scope => Ok(name),
        Principal::Person { name, scope } => Err(TokenError::Scope { name: name.clone(), claimed, has: *scope }),
        node @ Principal::Node { .. } => Err(TokenError::Node(node.clone())),
    }
}

fn part(of: &impl Serialize) -> String {
    URL_SAFE_NO_PAD.encode(serde_json::to_vec(of).expect("words and numbers can be written"))
}

fn read<T: for<'a> Deserialize<'a>>(part: &str) -> Option<T> {
    serde_json::from_slice(&URL_SAFE_NO_PAD.decode(part).ok()?).ok()
}
