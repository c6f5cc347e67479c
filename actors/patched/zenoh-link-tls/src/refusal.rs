//! Added for Consort: who is to have no link, though its certificate was signed by the authority and has not ended.
//!
//! Zenoh reads no lists of revoked certificates, and tells who uses it nothing of a link but the common name at its other end. So
//! whoever keeps such a list puts in a judge here: it is shown the certificate at the other end of each link that is opened, whichever
//! side opens it, and, when it says that it knows more than before, of each that is open.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
};

use tokio_util::sync::CancellationToken;

/// Whether the bearer of a certificate (DER) is to have no link.
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

/// A judge that was put in; it judges no more when this is dropped.
pub struct Judging(u64);

/// Puts in a judge of all links of this process, and has it judge those that are open.
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
    /// Judges all open links anew, and ends those of who is refused.
    pub fn again(&self) {
        let (judge, links) = with(|known| {
            known.links.retain(|link| link.strong_count() > 0);
            (known.judges.get(&self.0).cloned(), known.links.clone())
        });
        let Some(judge) = judge else { return };
        // Not while it is locked: a judge may take its time, and links come and go.
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

/// A link, for as long as it is open: by the certificate at its other end.
pub(crate) struct Admitted {
    certificate: Option<Vec<u8>>,
    refused: CancellationToken,
}

impl Admitted {
    /// A link to the bearer of a certificate, if nobody refuses it.
    pub(crate) fn new(certificate: Option<&[u8]>) -> Option<Arc<Admitted>> {
        let admitted = Arc::new(Admitted {
            certificate: certificate.map(<[u8]>::to_vec),
            refused: CancellationToken::new(),
        });
        // It is there before it is judged: a judge that learns more meanwhile judges it again.
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

    /// Waits until it is refused.
    pub(crate) async fn refused(&self) {
        self.refused.cancelled().await;
    }
}
