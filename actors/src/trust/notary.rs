//! The owner's signature of a record of knowledge: whoever hands it on cannot change it, nor make one up.

use super::cards::Cards;
use super::keyring::Keyring;
use crate::gossip::{Notary, Verdict};
use consort_protocol::knowledge::{Proof, Record};
use consort_protocol::trust::Bearer;
use std::sync::Arc;

/// Signs with the bearer's key, and judges by the certificates that bearers show.
pub(super) struct Signatory {
    pub(super) keyring: Arc<Keyring>,
    pub(super) cards: Arc<Cards>,
}

impl Notary for Signatory {
    fn sign(&self, record: &Record) -> Proof {
        let fleet = &self.keyring.identity().fleet;
        let signature = self.keyring.sign(&record.signed_part(fleet));
        Proof::new(self.keyring.fingerprint(), &signature).expect("an Ed25519 signature has 64 bytes")
    }

    fn judge(&self, record: &Record) -> Verdict {
        let Some(proof) = &record.proof else { return Verdict::Unproven };
        let Some(card) = self.keyring.card(proof.by()) else {
            self.cards.want(proof.by());
            return Verdict::Unproven;
        };
        let owner = &record.owner;
        match &card.identity.bearer {
            Bearer::Node { name, .. } if name == owner => {}
            bearer => return Verdict::Forged(format!("a record of {owner} is signed by {bearer}")),
        }
        match card.signed(&record.signed_part(&card.identity.fleet), &proof.signature()) {
            true => Verdict::Genuine,
            false => Verdict::Forged(format!("a record of {owner} is not as {owner} signed it")),
        }
    }
}
