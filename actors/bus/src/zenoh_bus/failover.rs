//! Moves the client of a relay to another relay when its own fails.
//!
//! Zenoh 1.10.2 can give a client several addresses, and reconnects it when its link closes. This is
//! slow when a relay's machine fails: the link ends after its lease, and then Zenoh tries all addresses
//! one after the other, each for as long as a link may take to open. So each session gets a single
//! address, and this module queries its relay. After two queries without a response it opens a session
//! at another relay, checks that relay, and moves the declarations to it. The former session stays until
//! then: a node that reaches no relay at all keeps its session, and Zenoh reconnects it.
//!
//! ```text
//!   relay responds ──▶ pause ──▶ query …
//!   two queries without a response ──▶ open a session at the next relay ──▶ it responds: move
//!                                       none responds: keep the session ──▶ pause, query …
//! ```
//!
//! With a lease of 2 s a client has moved after at most 0.6 s, and the time to connect: a pause and two
//! queries of a tenth of the lease each.

use super::session::SessionManager;
use super::settings::{LINK_CHECK, ZenohSettings};
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, timeout_at};
use tracing::{debug, info, warn};
use zenoh::Session;
use zenoh::query::{ConsolidationMode, QueryTarget};

/// Queries without a response, in a row, after which a relay counts as failed. A single one may be
/// lost with a link that closes and returns.
const UNANSWERED_MAX: u32 = 2;

/// Pause after an attempt in which no relay responded.
const RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Interval of checks for a link.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// What the client does after a query.
#[derive(Debug, PartialEq, Eq)]
enum Step {
    /// Queries again after a pause: the relay responds.
    Pause,
    /// Queries again at once.
    QueryAgain,
    /// Moves to another relay.
    Move,
}

/// Queries in a row to which the relay has not responded.
#[derive(Debug, Default)]
struct Unanswered(u32);

impl Unanswered {
    /// Handles the end of a query. `limit` is the time that a response may take, `took` that of the query.
    fn queried(&mut self, responds: bool, took: Duration, limit: Duration) -> Step {
        if responds {
            self.0 = 0;
            return Step::Pause;
        }
        if took > limit * 2 {
            // This process was stalled: the response may have arrived, and was not read.
            return Step::QueryAgain;
        }
        self.0 = (self.0 + 1).min(UNANSWERED_MAX);
        if self.0 == UNANSWERED_MAX { Step::Move } else { Step::QueryAgain }
    }
}

/// Returns the numbers of the relays in the order in which a client tries them: those after the present
/// one, and the present one last, since a new link to it may work.
fn candidates(present: Option<usize>, relays: usize) -> impl Iterator<Item = usize> {
    let first = present.map_or(0, |present| present + 1);
    (0..relays).map(move |step| (first + step) % relays)
}

/// Queries the relay of a client until the bus is closed, and moves the client when the relay fails.
pub(super) async fn run(manager: Weak<SessionManager>) {
    let mut unanswered = Unanswered::default();
    loop {
        let Some(manager) = manager.upgrade().filter(|manager| !manager.is_closed()) else { return };
        let limit = manager.settings().response_limit();
        manager.report_vanished();
        let began = Instant::now();
        let responds = relay_responds(&manager.session(), limit).await;
        let pause = match unanswered.queried(responds, began.elapsed(), limit) {
            Step::Pause => limit,
            Step::QueryAgain => POLL_INTERVAL,
            Step::Move if move_to_another_relay(&manager).await => POLL_INTERVAL,
            Step::Move => RETRY_PAUSE,
        };
        drop(manager); // the session closes with its last user
        sleep(pause).await;
    }
}

/// Moves the client to the first relay that responds. Returns false if there is none; the session then
/// stays.
async fn move_to_another_relay(manager: &Arc<SessionManager>) -> bool {
    let ZenohSettings { connect, .. } = manager.settings();
    for number in candidates(manager.relay(), connect.len()) {
        let relay = &connect[number];
        let session = match manager.open_at(number).await {
            Ok(session) => session,
            Err(problem) => {
                debug!(%relay, %problem, "the relay cannot be reached");
                continue;
            }
        };
        if relay_responds(&session, manager.settings().response_limit()).await {
            warn!(to = %relay, "the relay of this node does not respond; moving to another");
            manager.move_to(session, number).await;
            info!(%relay, "moved to a relay");
            return true;
        }
        debug!(%relay, "the relay does not respond");
        let _ = session.close().await;
    }
    false
}

/// Checks whether the relay of a session ends a query within `limit`. A Zenoh router that is not a node
/// ends it without a reply.
async fn relay_responds(session: &Session, limit: Duration) -> bool {
    let end = Instant::now() + limit;
    let relay = loop {
        if session.is_closed() {
            return false;
        }
        if let Some(relay) = session.info().transports().await.next() {
            break *relay.zid();
        }
        if Instant::now() >= end {
            return false;
        }
        sleep(POLL_INTERVAL).await;
    };
    let selector = format!("{LINK_CHECK}/{relay}");
    let query = session.get(selector.as_str()).target(QueryTarget::All);
    // Zenoh ends the query later than this function, so that its end is a response.
    let query = query.consolidation(ConsolidationMode::None).timeout(limit * 2);
    // The callback is dropped when the query ends.
    let (mailbox, mut ended) = mpsc::unbounded_channel();
    let on_reply = move |_: zenoh::query::Reply| {
        let _ = mailbox.send(());
    };
    query.callback(on_reply).await.is_ok() && timeout_at(end, ended.recv()).await.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_millis(200);

    #[test]
    fn two_queries_in_a_row_without_a_response_move_the_client() {
        let mut unanswered = Unanswered::default();
        assert_eq!(unanswered.queried(false, LIMIT, LIMIT), Step::QueryAgain);
        assert_eq!(unanswered.queried(true, LIMIT, LIMIT), Step::Pause);
        assert_eq!(unanswered.queried(false, LIMIT, LIMIT), Step::QueryAgain);
        assert_eq!(unanswered.queried(false, LIMIT, LIMIT), Step::Move);
        assert_eq!(unanswered.queried(false, LIMIT, LIMIT), Step::Move, "no relay was reached");
    }

    #[test]
    fn a_stall_of_the_own_process_is_no_failure_of_the_relay() {
        let mut unanswered = Unanswered::default();
        for _ in 0..9 {
            assert_eq!(unanswered.queried(false, LIMIT * 3, LIMIT), Step::QueryAgain);
        }
    }

    #[test]
    fn the_present_relay_is_tried_last() {
        let order = |present| candidates(present, 3).collect::<Vec<_>>();
        assert_eq!(order(None), [0, 1, 2]);
        assert_eq!(order(Some(0)), [1, 2, 0]);
        assert_eq!(order(Some(2)), [0, 1, 2]);
        assert_eq!(candidates(Some(0), 1).collect::<Vec<_>>(), [0]);
        assert_eq!(candidates(None, 0).count(), 0);
    }
}
