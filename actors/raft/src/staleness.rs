//! Staleness of a follower's state: the time since it contained all that the leader had committed.

use consort_bus::BootInstant;
use consort_protocol::lease::Epoch;
use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Maximum number of commits that wait to be applied. Later commits are not recorded until some are
/// applied, and the state counts as older meanwhile.
const PENDING_MAX: usize = 256;

/// Commits that leaders have announced to this node, each with the time of arrival.
///
/// A leader knows the last commit only after it has committed an entry of its own term. Earlier
/// announcements do not count, because the leader before may have committed more.
#[derive(Debug, Default)]
pub(super) struct AnnouncedCommits(Mutex<Commits>);

#[derive(Debug, Default)]
struct Commits {
    /// Latest announced commit.
    latest: Epoch,
    /// Latest arrival of a commit that is applied.
    applied_at: Option<BootInstant>,
    /// Commits that may not be applied yet, in ascending order, each with its latest arrival.
    pending: VecDeque<(Epoch, BootInstant)>,
}

impl AnnouncedCommits {
    /// Records that a leader of the term of `committed` announced it in a message that arrived at
    /// `at`.
    pub(super) fn record(&self, committed: Epoch, at: BootInstant) {
        let mut commits = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if committed < commits.latest {
            return; // a later message has overtaken this one
        }
        commits.latest = committed;
        if let Some((last, arrived_at)) = commits.pending.back_mut()
            && *last == committed
        {
            *arrived_at = at;
        } else if commits.pending.len() < PENDING_MAX {
            commits.pending.push_back((committed, at));
        }
    }

    /// Returns the staleness of the state with the last entry `applied`; `None` if no leader has
    /// announced a commit that the state contains.
    pub(super) fn staleness(&self, applied: Epoch) -> Option<Duration> {
        let mut commits = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some((committed, at)) = commits.pending.front().copied()
            && committed <= applied
        {
            commits.pending.pop_front();
            commits.applied_at = Some(at);
        }
        commits.applied_at.map(|at| at.elapsed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn epoch(index: u64) -> Epoch {
        Epoch { term: 3, index }
    }

    #[tokio::test(start_paused = true)]
    async fn the_state_is_as_old_as_the_last_announcement_that_it_contains() {
        let commits = AnnouncedCommits::default();
        assert_eq!(commits.staleness(epoch(7)), None);
        commits.record(epoch(5), BootInstant::now());
        tokio::time::advance(SECOND).await;
        commits.record(epoch(7), BootInstant::now());
        tokio::time::advance(SECOND).await;
        assert_eq!(commits.staleness(epoch(4)), None);
        assert_eq!(commits.staleness(epoch(6)), Some(SECOND * 2), "it contains the first only");
        assert_eq!(commits.staleness(epoch(7)), Some(SECOND));
        commits.record(epoch(7), BootInstant::now());
        assert_eq!(commits.staleness(epoch(7)), Some(Duration::ZERO), "repeated by a heartbeat");
        tokio::time::advance(SECOND).await;
        commits.record(epoch(5), BootInstant::now());
        assert_eq!(commits.staleness(epoch(7)), Some(SECOND), "an overtaken message is no news");
    }

    #[tokio::test(start_paused = true)]
    async fn commits_that_are_never_applied_take_a_bounded_space() {
        let commits = AnnouncedCommits::default();
        for index in 0..10 * PENDING_MAX as u64 {
            commits.record(epoch(index), BootInstant::now());
        }
        assert_eq!(commits.0.lock().unwrap().pending.len(), PENDING_MAX);
    }
}
