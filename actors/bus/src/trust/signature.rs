//! Signature schemes.

use consort_protocol::trust::Fingerprint;
use ring::signature::Ed25519KeyPair;

/// Length of a signature in bytes, in every scheme.
pub(super) const SIGNATURE: usize = 64;

/// Scheme of the signatures of messages, records and tokens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SignatureScheme {
    /// Ed25519, with the key of the certificate.
    Ed25519,
    /// A hash of the message, keyed with the fingerprint of the signer's certificate. Everyone can
    /// compute it, so it is for virtual fleets, whose nodes sign with their own keyrings only. It takes
    /// a hundredth of the time.
    #[cfg(feature = "test-util")]
    Simulated,
}

impl SignatureScheme {
    /// Signs a message with a key, in the name of the certificate with this fingerprint.
    #[cfg_attr(not(feature = "test-util"), expect(unused_variables, reason = "for simulated signatures"))]
    pub(super) fn sign(self, key: &Ed25519KeyPair, signer: Fingerprint, message: &[u8]) -> [u8; SIGNATURE] {
        match self {
            SignatureScheme::Ed25519 => {
                key.sign(message).as_ref().try_into().expect("an Ed25519 signature has 64 bytes")
            }
            #[cfg(feature = "test-util")]
            SignatureScheme::Simulated => simulated(signer, message),
        }
    }
}

/// Returns the simulated signature of a message.
#[cfg(feature = "test-util")]
pub(super) fn simulated(signer: Fingerprint, message: &[u8]) -> [u8; SIGNATURE] {
    use siphasher::sip128::SipHasher13;
    let hash = SipHasher13::new_with_key(&signer.0).hash(message).as_bytes();
    std::array::from_fn(|place| hash[place % hash.len()])
}
