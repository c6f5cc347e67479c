//! Signing and verification of knowledge records.

use consort_protocol::knowledge::{Proof, Record};
use std::sync::Arc;

/// Signs the own node's records, and verifies records that other nodes forward.
pub trait RecordSigner: Send + Sync {
    /// Returns the proof of the own record: the signature of its content and stamp.
    fn sign(&self, record: &Record) -> Proof;

    /// Verifies that a record was signed by its owner.
    fn verify(&self, record: &Record) -> ProofStatus;
}

/// Result of the verification of a forwarded record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProofStatus {
    /// Signed by its owner.
    Valid,
    /// Not verifiable yet: the proof is missing, or its certificate is unknown to this node.
    Unproven,
    /// Not signed by its owner, with the reason.
    Forged(String),
}

/// Signer shared by all publishers of a node.
pub type SharedRecordSigner = Arc<dyn RecordSigner>;
