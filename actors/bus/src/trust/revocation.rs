//! The list of revoked certificates. A node never returns to an earlier list.

use x509_parser::prelude::{CertificateRevocationList, FromDer as _};

/// A list of revoked certificates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RevocationList {
    der: Vec<u8>,
    /// Greater than the numbers of all earlier lists of the authority.
    number: u64,
}

/// A list of revoked certificates cannot be used. The former list stays in use.
#[derive(Debug, thiserror::Error)]
pub(super) enum RevocationListError {
    #[error("not a list of revoked certificates: {0}")]
    Malformed(String),
    #[error("{0}")]
    NotSigned(String),
    #[error(
        "its number is {number}, and the list in use has the number {known}: an earlier list may lack revoked certificates"
    )]
    Outdated { number: u64, known: u64 },
}

impl RevocationList {
    /// Decodes a list. Its signature is not checked.
    pub(super) fn decode(der: Vec<u8>) -> Result<RevocationList, RevocationListError> {
        let malformed = |problem: &dyn std::fmt::Display| RevocationListError::Malformed(problem.to_string());
        let number = {
            let (_, list) = CertificateRevocationList::from_der(&der).map_err(|problem| malformed(&problem))?;
            let number = list.crl_number().ok_or_else(|| malformed(&"it has no number"))?;
            u64::try_from(number).map_err(|problem| malformed(&problem))?
        };
        Ok(RevocationList { der, number })
    }

    /// Returns the list in DER.
    pub(super) fn der(&self) -> &[u8] {
        &self.der
    }

    /// Checks that this list may replace `known`.
    pub(super) fn check_replaces(&self, known: Option<&RevocationList>) -> Result<(), RevocationListError> {
        match known.filter(|known| known.number > self.number) {
            Some(known) => Err(RevocationListError::Outdated { number: self.number, known: known.number }),
            None => Ok(()),
        }
    }
}
