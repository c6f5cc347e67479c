//! Signatures of knowledge records: a forwarding node can neither change nor forge a record.

use super::certificates::CertificateExchange;
use super::keyring::Keyring;
use crate::record_signer::{ProofStatus, RecordSigner};
use consort_protocol::knowledge::{Proof, Record};
use consort_protocol::trust::Principal;
use std::sync::Arc;

/// Signs with the node's own key, and verifies with the certificates of other nodes.
pub(super) struct KeyringSigner {
    pub(super) keyring: Arc<Keyring>,
    pub(super) certificates: Arc<CertificateExchange>,
}

impl RecordSigner for KeyringSigner {
    fn sign(&self, record: &Record) -> Proof {
        let fleet = &self.keyring.identity().fleet;
        let signature = self.keyring.sign(&record.signed_part(fleet));
        Proof::new(self.keyring.fingerprint(), &signature).expect("an Ed25519 signature has 64 bytes")
    }

    fn verify(&self, record: &Record) -> ProofStatus {
        let Some(proof) = &record.proof else { return ProofStatus::Unproven };
        let Some(certificate) = self.keyring.certificate(proof.by()) else {
            self.certificates.request(proof.by());
            return ProofStatus::Unproven;
        };
        let owner = &record.owner;
        match &certificate.identity.principal {
            Principal::Node { name, .. } if name == owner => {}
            principal => return ProofStatus::Forged(format!("record of {owner} is signed by {principal}")),
        }
        match certificate.verify(&record.signed_part(&certificate.identity.fleet), &proof.signature()) {
            true => ProofStatus::Valid,
            false => ProofStatus::Forged(format!("signature of the record of {owner} is invalid")),
        }
    }
}
