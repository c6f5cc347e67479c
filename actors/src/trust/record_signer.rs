//! The owner's signature of a record of knowledge: whoever hands it on cannot change it, nor make one up.

use super::certificates::CertificateExchange;
use super::keyring::Keyring;
use crate::gossip::{ProofStatus, RecordSigner};
use consort_protocol::knowledge::{Proof, Record};
use consort_protocol::trust::Principal;
use std::sync::Arc;

/// Signs with the bearer's key, and judges by the certificates that bearers show.
pub(super) struct KeyringSigner {
    pub(super) keyring: Arc<Keyring>,
    pub(super) cards: Arc<CertificateExchange>,
}

impl RecordSigner for KeyringSigner {
    fn sign(&self, record: &Record) -> Proof {
        let fleet = &self.keyring.identity().fleet;
        let signature = self.keyring.sign(&record.signed_part(fleet));
        Proof::new(self.keyring.fingerprint(), &signature).expect("an Ed25519 signature has 64 bytes")
    }

    fn verify(&self, record: &Record) -> ProofStatus {
        let Some(proof) = &record.proof else { return ProofStatus::Unproven };
        let Some(card) = self.keyring.certificate(proof.by()) else {
            self.cards.request(proof.by());
            return ProofStatus::Unproven;
        };
        let owner = &record.owner;
        match &card.identity.principal {
            Principal::Node { name, .. } if name == owner => {}
            bearer => return ProofStatus::Forged(format!("a record of {owner} is signed by {bearer}")),
        }
        match card.verify(&record.signed_part(&card.identity.fleet), &proof.signature()) {
            true => ProofStatus::Valid,
            false => ProofStatus::Forged(format!("a record of {owner} is not as {owner} signed it")),
        }
    }
}
