//! Moves the client of a relay to another relay when its own fails.
//!
//! Zenoh 1.10.2 can give a client several addresses, and reconnects it when its link closes. This is
//! slow when a relay's machine fails: the link ends after its lease, and then Zenoh tries all addresses
//! one after the other, each for as long as a link may take to open. So each session gets a single
//! address, and this module queries its relay. After two queries without a response, or when the link
//! has closed, it opens a session at another relay, checks that relay, and moves the declarations to it.
//! The former session stays until then: a node that reaches no relay at all keeps its session, and Zenoh
//! reconnects it.
//!
//! ```text
//!   relay responds ──▶ pause ──▶ query …
//!   the link has closed,
//!   or two queries have no response ──▶ open a session at the next relay ──▶ it responds: move
//!                                       none responds: keep the session ──▶ pause, query …
//! ```
//!
//! A client leaves a silent relay after at most three tenths of the lease: a pause, and two queries.

use super::session::{SessionManager, close};
use super::settings::{LINK_CHECK, ZenohSettings};
use super::transmission::zenoh_priority;
use consort_protocol::keys::Priority;
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::{Notify, mpsc};
use tokio::time::{Instant, sleep, timeout};
use tracing::{debug, info, warn};
use zenoh::Session;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::SampleKind;
use zenoh::session::TransportEvent;

/// Queries without a response, in a row, after which a relay counts as failed. A single one may be
/// lost with a link that closes and returns.
const UNANSWERED_MAX: u32 = 2;

/// Pause after an attempt in which no relay responded.
const RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Pause after an event, until the session has handled it, too.
const SHORT_PAUSE: Duration = Duration::from_millis(10);

/// Result of a query to the relay.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Response {
    /// The relay has ended the query.
    Received,
    /// The query has not ended in time.
    Missing,
    /// The session has no link.
    NoLink,
}

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
    /// Handles the result of a query that took a time. `limit` is the time that a response may take.
    fn queried(&mut self, response: Response, took: Duration, limit: Duration) -> Step {
        let step = match response {
            Response::Received => Step::Pause,
            Response::NoLink => Step::Move,
            // This process was stalled: the response may have arrived, and was not read.
            Response::Missing if took > limit * 2 => Step::QueryAgain,
            Response::Missing => {
                self.0 += 1;
                if self.0 < UNANSWERED_MAX { Step::QueryAgain } else { Step::Move }
            }
        };
        if step != Step::QueryAgain {
            self.0 = 0;
        }
        step
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
    let (mut unanswered, mut watched, closed) = (Unanswered::default(), None, Arc::new(Notify::new()));
    loop {
        let Some(manager) = manager.upgrade().filter(|manager| !manager.is_closed()) else { return };
        let (session, limit) = (manager.session(), manager.settings().response_limit());
        if watched != Some(session.zid()) {
            watch_link(&session, &closed).await;
            watched = Some(session.zid());
        }
        manager.report_vanished();
        let began = Instant::now();
        let response = query_relay(&session, limit).await;
        let pause = match unanswered.queried(response, began.elapsed(), limit) {
            Step::Pause => limit,
            Step::QueryAgain => SHORT_PAUSE,
            Step::Move if move_to_another_relay(&manager).await => SHORT_PAUSE,
            Step::Move => RETRY_PAUSE,
        };
        drop((session, manager)); // the session closes with its last user
        if timeout(pause, closed.notified()).await.is_ok() {
            sleep(SHORT_PAUSE).await;
        }
    }
}

/// Notifies `closed` when the link of a session closes.
async fn watch_link(session: &Session, closed: &Arc<Notify>) {
    let closed = Arc::clone(closed);
    let on_event = move |event: TransportEvent| {
        if event.kind() == SampleKind::Delete {
            closed.notify_one();
        }
    };
    if let Err(problem) = session.info().transport_events_listener().callback(on_event).background().await {
        warn!(%problem, "the link to the relay is checked by queries only");
    }
}

/// Moves the client to the first relay that responds. Returns false if there is none; the session then
/// stays.
async fn move_to_another_relay(manager: &Arc<SessionManager>) -> bool {
    let ZenohSettings { connect, .. } = manager.settings();
    let limit = manager.settings().response_limit();
    for number in candidates(manager.relay(), connect.len()) {
        let relay = &connect[number];
        let session = match manager.open_at(number).await {
            Ok(session) => session,
            Err(problem) => {
                debug!(%relay, %problem, "no session at the relay");
                continue;
            }
        };
        if query_relay(&session, limit).await == Response::Received {
            match manager.relay() {
                Some(former) => {
                    let former = &connect[former];
                    warn!(%former, %relay, "the former relay does not respond; moving to another");
                }
                None => info!(%relay, "found a relay"),
            }
            manager.move_to(session, number).await;
            return true;
        }
        debug!(%relay, "the relay does not respond");
        let _ = close(session).await;
    }
    false
}

/// Queries the relay of a session. A Zenoh router that is not a node ends the query without a reply.
async fn query_relay(session: &Session, limit: Duration) -> Response {
    if session.is_closed() {
        return Response::NoLink;
    }
    let Some(relay) = session.info().transports().await.next() else { return Response::NoLink };
    let selector = format!("{LINK_CHECK}/{}", relay.zid());
    let query = session.get(selector.as_str()).target(QueryTarget::All).consolidation(ConsolidationMode::None);
    // A query that waits for the link would block the thread, and a download would delay its response.
    let query = query.congestion_control(CongestionControl::Drop).priority(zenoh_priority(Priority::Liveness));
    // The callback is dropped when the query ends.
    let (mailbox, mut ended) = mpsc::unbounded_channel();
    let on_reply = move |_: zenoh::query::Reply| {
        let _ = mailbox.send(());
    };
    // Zenoh ends the query later than this function, so that its end is a response.
    match query.timeout(limit * 2).callback(on_reply).await {
        Ok(()) if timeout(limit, ended.recv()).await.is_ok() => Response::Received,
        Ok(()) | Err(_) => Response::Missing,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_millis(200);

    #[test]
    fn two_queries_in_a_row_without_a_response_move_the_client() {
        let mut unanswered = Unanswered::default();
        assert_eq!(unanswered.queried(Response::Missing, LIMIT, LIMIT), Step::QueryAgain);
        assert_eq!(unanswered.queried(Response::Received, LIMIT, LIMIT), Step::Pause);
        assert_eq!(unanswered.queried(Response::Missing, LIMIT, LIMIT), Step::QueryAgain);
        assert_eq!(unanswered.queried(Response::Missing, LIMIT, LIMIT), Step::Move);
        // After an attempt to move the count begins anew.
        assert_eq!(unanswered.queried(Response::Missing, LIMIT, LIMIT), Step::QueryAgain);
        assert_eq!(unanswered.queried(Response::Missing, LIMIT, LIMIT), Step::Move);
    }

    #[test]
    fn a_closed_link_moves_the_client_at_once() {
        assert_eq!(Unanswered::default().queried(Response::NoLink, Duration::ZERO, LIMIT), Step::Move);
    }

    #[test]
    fn a_stall_of_the_own_process_is_no_failure_of_the_relay() {
        let mut unanswered = Unanswered::default();
        for _ in 0..9 {
            assert_eq!(unanswered.queried(Response::Missing, LIMIT * 3, LIMIT), Step::QueryAgain);
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
