//! Who vouches for what is handed on of third ones.

use consort_protocol::knowledge::{Proof, Record};
use std::sync::Arc;

/// Signs what the own node says of itself, and judges what others hand on of third ones.
pub trait RecordSigner: Send + Sync {
    /// The proof that this is the own record: the signature of what it says, with its stamp.
    fn sign(&self, record: &Record) -> Proof;

    /// Whether its owner said this.
    fn verify(&self, record: &Record) -> ProofStatus;
}

/// What is thought of a record that was handed on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProofStatus {
    /// Its owner said it.
    Valid,
    /// Nobody can tell yet: it has no proof, or one by a certificate that is not known here.
    Unproven,
    /// Its owner did not say it, and what is wrong, in words.
    Forged(String),
}

/// Shared by all that a node says.
pub type SharedRecordSigner = Arc<dyn RecordSigner>;
