//! Memory of executed requests, so that each is executed once.

use consort_protocol::trust::{Fingerprint, REQUEST_SKEW_MAX_MS};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Maximum number of remembered requests: 200 a second, the default limit of a coordinator, for as
/// long as a request is valid. Beyond that further requests are put off.
const REMEMBERED_MAX: usize = 200 * 2 * REQUEST_SKEW_MAX_MS as usize / 1000;

/// A valid request is not executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum NotAccepted {
    #[error("too many requests; try again in {} s", REQUEST_SKEW_MAX_MS / 1000)]
    Full,
    /// Links may deliver a query twice, and an attacker may repeat it. The first copy is answered.
    #[error("the request was received before")]
    Repeated,
}

/// Requests that this node has executed, as long as they could be repeated: signer and number, with
/// the time from which their age rejects them.
#[derive(Default)]
pub(super) struct ExecutedRequests(Mutex<BTreeMap<(Fingerprint, u64), u64>>);

impl ExecutedRequests {
    /// Accepts a request once. `expires_ms` is the time from which its age rejects it, `now_ms` the
    /// present time; both in milliseconds since 1970.
    pub(super) fn accept(&self, id: (Fingerprint, u64), expires_ms: u64, now_ms: u64) -> Result<(), NotAccepted> {
        let mut executed = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if executed.contains_key(&id) {
            return Err(NotAccepted::Repeated);
        }
        if executed.len() >= REMEMBERED_MAX {
            executed.retain(|_, expires_ms| *expires_ms >= now_ms);
            if executed.len() >= REMEMBERED_MAX {
                return Err(NotAccepted::Full);
            }
        }
        executed.insert(id, expires_ms);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_accepted_once_and_remembered_requests_are_bounded() {
        let (executed, by) = (ExecutedRequests::default(), Fingerprint([7; 16]));
        assert_eq!(executed.accept((by, 1), 500, 0), Ok(()));
        assert_eq!(executed.accept((by, 1), 500, 0), Err(NotAccepted::Repeated));
        let full = (2..).find(|number| executed.accept((by, *number), 500, 0).is_err()).unwrap();
        assert_eq!(full as usize, REMEMBERED_MAX + 1);
        assert_eq!(executed.accept((by, full), 500, 0), Err(NotAccepted::Full));
        assert_eq!(executed.accept((by, full), 900, 501), Ok(()), "older requests are rejected by their time");
    }
}
