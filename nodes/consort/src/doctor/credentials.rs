//! Checks of the certificates: their match, principal and expiry.

use super::{DiagnosisTarget, Finding};
use crate::certs::{CertificateEntry, CertificateState, unix_time};
use crate::config::trust_files;
use consort_protocol::trust::Principal;
use std::os::unix::fs::PermissionsExt;

/// Days before expiry at which a renewal is due.
const RENEW_BELOW_DAYS: u64 = 14;

/// Checks that the protocols of addresses match the use of certificates.
pub(super) fn check_addresses(target: &DiagnosisTarget) -> Vec<Finding> {
    let wrong = |problem: String| {
        Finding::error("addresses", problem, "with certificates all addresses start with tls/, without with tcp/")
    };
    target.bus.validate().into_iter().map(wrong).collect()
}

/// Checks the folder with certificates.
pub(super) fn check_certificates(target: &DiagnosisTarget) -> Vec<Finding> {
    let Some(folder) = &target.bus.certs else { return vec![] };
    let about = format!("certificates {}", folder.display());
    let files = trust_files(folder);
    let mut findings = Vec::new();
    match files.identity(&target.fleet, unix_time()) {
        Ok(identity) => {
            let other = match (&identity.principal, &target.node) {
                (Principal::Node { name, .. }, Some(own)) if name != own => Some(own),
                (Principal::Person { .. }, Some(own)) => Some(own),
                _ => None,
            };
            findings.push(match other {
                None => {
                    Finding::ok(&about, format!("they belong to {}, of fleet {}", identity.principal, identity.fleet))
                }
                Some(own) => {
                    let text = format!("they belong to {}, and this is node {own}", identity.principal);
                    Finding::error(
                        &about,
                        text,
                        format!("make the right certificate with consort cert node {own} --roles …"),
                    )
                }
            });
        }
        Err(problem) => {
            let advice =
                "copy the folder again from the authority's machine, or renew it with `consort cert renew NAME`";
            findings.push(Finding::error(&about, problem, advice));
        }
    }
    if let Ok(holder) = CertificateEntry::read(&files.certificate, &[])
        && let CertificateState::Valid { days } = holder.state
    {
        findings.push(match days {
            0..RENEW_BELOW_DAYS => Finding::warning(
                &about,
                format!("they expire in {days} days"),
                "consort cert renew NAME, and restart the node",
            ),
            _ => Finding::ok(&about, format!("they are valid for {days} days")),
        });
    }
    if let Ok(key) = std::fs::metadata(&files.key)
        && key.permissions().mode() & 0o077 != 0
    {
        let text =
            format!("other users of this machine can read {}, and can impersonate this identity", files.key.display());
        findings.push(Finding::warning(&about, text, format!("chmod 600 {}", files.key.display())));
    }
    findings
}
