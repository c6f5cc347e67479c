//! Tokens of persons.

use crate::fixture::*;
use consort_bus::trust::{Keyring, TOKEN_MAX, TokenError, forwarded_part};
use consort_protocol::trust::AccessScope;
use pki_types::PrivatePkcs8KeyDer;
use pki_types::pem::PemObject as _;
use std::time::Duration;

/// Returns the keyring of a person with this scope.
fn person(fixture: &Fixture, scope: &str) -> Keyring {
    let identity = format!("consort://ward/person/kim?scope={scope}").parse().unwrap();
    let issued = fixture.authority().issue(&identity, &[], LONG).unwrap();
    fixture.files("kim", &issued).open(&ward(), NOW, 1).unwrap()
}

const HOUR: Duration = Duration::from_secs(3600);

#[test]
fn a_token_is_valid_for_its_scope_and_time() {
    let fixture = Fixture::new();
    let (kim, ada) = (person(&fixture, "submit"), verifier(&fixture));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let claims = ada.verify_token(&token, NOW).unwrap();
    assert_eq!((claims.name.as_str(), claims.scope, claims.expires), ("kim", AccessScope::Read, NOW + HOUR));
    assert_eq!(ada.verify_token(&token, NOW + HOUR), Err(TokenError::Expired("0 s".to_owned())));
    assert!(kim.issue_token(AccessScope::Submit, NOW + HOUR).is_ok());
    assert!(matches!(kim.issue_token(AccessScope::Operate, NOW + HOUR), Err(TokenError::Scope { .. })));
    assert!(matches!(ada.issue_token(AccessScope::Read, NOW + HOUR), Err(TokenError::Node(_))));
    // The token ends with the certificate.
    let late = kim.issue_token(AccessScope::Read, LONG.until + 2 * HOUR).unwrap();
    assert!(matches!(ada.verify_token(&late, LONG.until + HOUR), Err(TokenError::Certificate(_))));
}

#[test]
fn a_changed_token_is_rejected() {
    let fixture = Fixture::new();
    let (kim, ada) = (person(&fixture, "read"), verifier(&fixture));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    for (at, was) in token.bytes().enumerate() {
        for other in [b'A', b'x', b'.', b'=', b'~'] {
            let mut changed = token.clone().into_bytes();
            changed[at] = other;
            let changed = String::from_utf8(changed).unwrap();
            assert!(other == was || ada.verify_token(&changed, NOW).is_err(), "at {at}");
        }
        assert!(ada.verify_token(&token[..at], NOW).is_err(), "cut at {at}");
    }
    let longer = format!("{}{token}", "A".repeat(TOKEN_MAX));
    assert_eq!(ada.verify_token(&longer, NOW), Err(TokenError::Malformed("it is too long")));
}

#[test]
fn a_token_with_excessive_claims_is_rejected() {
    use base64::Engine as _;
    use base64::engine::general_purpose::URL_SAFE_NO_PAD;
    use ring::digest::{SHA256, digest};
    let fixture = Fixture::new();
    let identity = "consort://ward/person/kim?scope=read".parse().unwrap();
    let issued = fixture.authority().issue(&identity, &[], LONG).unwrap();
    let files = fixture.files("kim", &issued);
    let (kim, ada) = (files.open(&ward(), NOW, 1).unwrap(), verifier(&fixture));
    let key = PrivatePkcs8KeyDer::from_pem_file(&files.key).unwrap();
    let key = ring::signature::Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.secret_pkcs8_der()).unwrap();
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let head = token.split('.').next().unwrap().to_owned();
    let forged_with = |head: &str, claims: &serde_json::Value| {
        let mut claims = claims.clone();
        claims["secret_sha256"] = URL_SAFE_NO_PAD.encode(digest(&SHA256, b"s")).into();
        let signed = format!("{head}.{}", URL_SAFE_NO_PAD.encode(claims.to_string()));
        format!("{signed}.{}~s", URL_SAFE_NO_PAD.encode(key.sign(signed.as_bytes())))
    };
    let forged = |claims: serde_json::Value| forged_with(&head, &claims);
    let until = (NOW + HOUR).as_secs();
    let valid_claims = serde_json::json!({ "aud": "ward", "exp": until, "scope": "read" });
    assert!(ada.verify_token(&forged(valid_claims.clone()), NOW).is_ok(), "the forged token is signed like a real one");
    let mut other: serde_json::Value = serde_json::from_slice(&URL_SAFE_NO_PAD.decode(&head).unwrap()).unwrap();
    other["alg"] = "HS256".into();
    let other = forged_with(&URL_SAFE_NO_PAD.encode(other.to_string()), &valid_claims);
    assert_eq!(ada.verify_token(&other, NOW), Err(TokenError::Malformed("its algorithm is not EdDSA")));
    let more = serde_json::json!({ "aud": "ward", "exp": until, "scope": "operate" });
    let refused = ada.verify_token(&forged(more), NOW).unwrap_err();
    assert_eq!(refused.to_string(), "the token claims scope operate, but kim has scope read");
    let other_fleet = serde_json::json!({ "aud": "clinic", "exp": until, "scope": "read" });
    assert_eq!(ada.verify_token(&forged(other_fleet), NOW).unwrap_err().to_string(), "the token is for fleet clinic");
}

#[test]
fn the_forwarded_part_of_a_token_opens_no_page() {
    let fixture = Fixture::new();
    let (kim, ada) = (person(&fixture, "read"), verifier(&fixture));
    let token = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let forwarded = forwarded_part(&token);
    assert_eq!(ada.verify_token(forwarded, NOW), Err(TokenError::Secret));
    assert_eq!(ada.verify_token(&format!("{forwarded}~guessed"), NOW), Err(TokenError::Secret));
    let other = kim.issue_token(AccessScope::Read, NOW + HOUR).unwrap();
    let (_, secret) = other.split_once('~').unwrap();
    assert_eq!(ada.verify_token(&format!("{forwarded}~{secret}"), NOW), Err(TokenError::Secret));
}
