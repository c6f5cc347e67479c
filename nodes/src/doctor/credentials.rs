//! Certificates: whether they belong together, to whom, and for how long.

use super::{DiagnosisTarget, Finding};
use crate::certs::{CertificateEntry, CertificateState as Good, unix_time};
use crate::config::trust_files;
use consort_protocol::trust::Principal;
use std::os::unix::fs::PermissionsExt;

/// Below so many days it is time to renew.
const SOON: u64 = 14;

/// Whether addresses fit to whether there are certificates.
pub(super) fn check_addresses(patient: &DiagnosisTarget) -> Vec<Finding> {
    let wrong = |problem: String| {
        Finding::error("addresses", problem, "with certificates all are written tls/…, without all tcp/…")
    };
    patient.bus.validate().into_iter().map(wrong).collect()
}

/// What the folder with certificates holds.
pub(super) fn check_certificates(patient: &DiagnosisTarget) -> Vec<Finding> {
    let Some(folder) = &patient.bus.certs else { return vec![] };
    let about = format!("certificates {}", folder.display());
    let files = trust_files(folder);
    let mut findings = Vec::new();
    match files.identity(&patient.fleet, unix_time()) {
        Ok(identity) => {
            let other = match (&identity.principal, &patient.node) {
                (Principal::Node { name, .. }, Some(own)) if name != own => Some(own),
                (Principal::Person { .. }, Some(own)) => Some(own),
                _ => None,
            };
            findings.push(match other {
                None => Finding::ok(&about, format!("they are {}'s, of fleet {}", identity.principal, identity.fleet)),
                Some(own) => {
                    let says = format!("they are {}'s, and this is node {own}", identity.principal);
                    Finding::error(&about, says, format!("consort cert node {own} --roles … makes the right ones"))
                }
            });
        }
        Err(problem) => {
            let advice =
                "copy the folder again from where `consort cert` made it; `consort cert renew NAME` makes it anew";
            findings.push(Finding::error(&about, problem, advice));
        }
    }
    if let Ok(holder) = CertificateEntry::read(&files.certificate, &[])
        && let Good::Valid { days } = holder.state
    {
        findings.push(match days {
            0..SOON => Finding::warning(
                &about,
                format!("they end in {days} days"),
                "consort cert renew NAME, and restart the node",
            ),
            _ => Finding::ok(&about, format!("they are good for {days} days")),
        });
    }
    if let Ok(key) = std::fs::metadata(&files.key)
        && key.permissions().mode() & 0o077 != 0
    {
        let says = format!("others on this machine can read {}, and be who it is", files.key.display());
        findings.push(Finding::warning(&about, says, format!("chmod 600 {}", files.key.display())));
    }
    findings
}
