//! Added for Consort: rejection of links whose certificate is signed by the authority and not
//! expired.
//!
//! Zenoh reads no lists of revoked certificates, and its users learn only the common name at the
//! other end of a link. Therefore a program with such a list registers a check here. The check
//! receives the certificate at the other end of each link that is opened, from either side. When
//! the program reports a changed list, the check receives the certificates of all open links.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
};

use tokio_util::sync::CancellationToken;

/// Check that returns true if links to the principal of this certificate (DER) must be rejected.
pub type Judge = dyn Fn(&[u8]) -> bool + Send + Sync;

#[derive(Default)]
struct Known {
    next: u64,
    judges: BTreeMap<u64, Arc<Judge>>,
    links: Vec<Weak<Admitted>>,
}

static KNOWN: Mutex<Option<Known>> = Mutex::new(None);

fn with<T>(act: impl FnOnce(&mut Known) -> T) -> T {
    let mut known: MutexGuard<'_, Option<Known>> = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    act(known.get_or_insert_default())
}

/// Registration of a check; dropping it removes the check.
pub struct Judging(u64);

/// Registers a check of all links of this process, and applies it to the open links.
pub fn judge_by(judge: Arc<Judge>) -> Judging {
    let judging = with(|known| {
        known.next += 1;
        known.judges.insert(known.next, judge);
        Judging(known.next)
    });
    judging.again();
    judging
}

impl Judging {
    /// Applies the check to all open links again, and closes the rejected links.
    pub fn again(&self) {
        let (judge, links) = with(|known| {
            known.links.retain(|link| link.strong_count() > 0);
            (known.judges.get(&self.0).cloned(), known.links.clone())
        });
        let Some(judge) = judge else { return };
        // The lock is not held here: a check may take long, and links open and close meanwhile.
        for link in links.iter().filter_map(Weak::upgrade) {
            if link.certificate.as_deref().is_some_and(|certificate| judge(certificate)) {
                link.refused.cancel();
            }
        }
    }
}

impl Drop for Judging {
    fn drop(&mut self) {
        with(|known| known.judges.remove(&self.0));
    }
}

/// An open link, with the certificate at its other end.
pub(crate) struct Admitted {
    certificate: Option<Vec<u8>>,
    refused: CancellationToken,
}

impl Admitted {
    /// Registers a link, unless a check rejects its certificate.
    pub(crate) fn new(certificate: Option<&[u8]>) -> Option<Arc<Admitted>> {
        let admitted = Arc::new(Admitted {
            certificate: certificate.map(<[u8]>::to_vec),
            refused: CancellationToken::new(),
        });
        // Registered before the check: a check with a changed list meanwhile covers this link as
        // well.
        let judges: Vec<_> = with(|known| {
            known.links.retain(|link| link.strong_count() > 0);
            known.links.push(Arc::downgrade(&admitted));
            known.judges.values().cloned().collect()
        });
        let refused = admitted
            .certificate
            .as_deref()
            .is_some_and(|certificate| judges.iter().any(|judge| judge(certificate)));
        (!refused).then_some(admitted)
    }

    pub(crate) fn is_refused(&self) -> bool {
        self.refused.is_cancelled()
    }

    /// Waits until the link is rejected.
    pub(crate) async fn refused(&self) {
        self.refused.cancelled().await;
    }
}
