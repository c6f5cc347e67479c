//! Revocation of links: links to principals with revoked certificates are not opened, and open
//! links are closed.
//!
//! Zenoh's TLS checks only that the fleet's authority signed a certificate and that it has not
//! expired. Therefore the patched `zenoh-link-tls` passes the certificate of each link of this
//! process to a registered check, which reads the list of revoked certificates.

use super::keyring::Keyring;
use super::rejections::RejectionLog;
use crate::clock::Clock;
use std::sync::Arc;
use zenoh_link_tls::{LinkCheck, check_links};

/// Registers a check of all links against a keyring. The check is active until the returned guard
/// is dropped.
pub(super) fn register_link_check(keyring: &Arc<Keyring>, clock: Clock, rejections: Arc<RejectionLog>) -> LinkCheck {
    let keyring = Arc::downgrade(keyring);
    check_links(move |certificate| {
        let revoked = keyring.upgrade().and_then(|keyring| keyring.revoked_identity(certificate, clock.unix_time()));
        if let Some(identity) = &revoked {
            rejections.record(format!("link to {} rejected: its certificate has been revoked", identity.principal));
        }
        revoked.is_some()
    })
}
