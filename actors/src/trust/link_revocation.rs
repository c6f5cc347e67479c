//! Links to bearers of revoked certificates: none is opened, and those that are open end.
//!
//! Zenoh's TLS sees to it that the fleet's authority signed a certificate and that it has not ended, and no more; so each link of this
//! process is shown to a judge (`zenoh-link-tls`, in the edition beside this crate), who knows the list of what is revoked.

use super::certificates::unix_time;
use super::keyring::Keyring;
use super::rejections::RejectionLog;
use crate::clock::Clock;
use std::sync::Arc;
use zenoh_link_tls::{Judging, judge_by};

/// Judges links by a keyring, for as long as what is returned lives.
pub(super) fn register_link_check(keyring: &Arc<Keyring>, clock: Clock, refusals: Arc<RejectionLog>) -> Judging {
    let keyring = Arc::downgrade(keyring);
    judge_by(Arc::new(move |certificate| {
        let revoked = keyring.upgrade().and_then(|keyring| keyring.revoked_identity(certificate, unix_time(clock)));
        if let Some(identity) = &revoked {
            refusals.record(format!("a link to {}: its certificate has been revoked", identity.principal));
        }
        revoked.is_some()
    }))
}
