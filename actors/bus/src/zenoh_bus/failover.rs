//! Moves the client of a relay to another relay when its own fails.
//!
//! Zenoh 1.10.2 can give a client several addresses, and reconnects it when its link closes. This is
//! slow when a relay's machine fails: the link ends after its lease, and then Zenoh tries all addresses
//! one after the other, each for as long as a link may take to open. So each session gets a single
//! address, and this module queries its relay. After two queries without a response, or when the link
//! has closed, it opens a session at another relay, checks that relay, and moves the declarations to it.
//! The attempts at further relays begin without waiting for the end of an attempt at a silent one (as
//! RFC 8305 does with addresses). The former session stays until then: a node that reaches no relay at all
//! keeps its session, and Zenoh reconnects it.
//!
//! ```text
//!   relay responds ──▶ pause ──▶ query …
//!   the link has closed,
//!   or two queries have no response ──▶ open a session at the next relay ──▶ it responds: move
//!                                       none responds: keep the session ──▶ pause, query …
//! ```
//!
//! A client leaves a silent relay after at most three tenths of the lease: a pause, and two queries. Another
//! silent relay, or an attempt that is lost, costs another tenth. With the default lease of 2 s a client has moved
//! within a second; with the lease of 5 s of the timing `wifi` within two. There links stall for a second: a client
//! that moved earlier would move whenever its own link stalls.

use super::session::{SessionManager, close};
use super::settings::{LINK_CHECK, ZenohSettings};
use super::transmission::zenoh_priority;
use consort_protocol::keys::Priority;
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::{Notify, mpsc};
use tokio::task::JoinSet;
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

/// Returns the numbers of the relays in the order in which a client tries them: those after the present one, twice, and the
/// present one last, since a new link to it may work. A lost packet may end the first attempt at a relay: Linux repeats the
/// first packet of a connection after a second only.
fn candidates(present: Option<usize>, relays: usize) -> impl Iterator<Item = usize> {
    let first = present.map_or(0, |present| present + 1);
    let others = move || {
        let all = (0..relays).map(move |step| (first + step) % relays);
        all.filter(move |number| Some(*number) != present)
    };
    others().chain(others()).chain(present)
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
    let numbers = candidates(manager.relay(), connect.len());
    let attempts: Vec<_> = numbers.map(|number| open_and_check(Arc::clone(manager), number)).collect();
    let (found, left) = first_result(attempts, manager.settings().response_limit()).await;
    close_all(left);
    let Some((session, number)) = found else { return false };
    let relay = &connect[number];
    match manager.relay() {
        Some(former) => {
            let former = &connect[former];
            warn!(%former, %relay, "the former relay does not respond; moving to another");
        }
        None => info!(%relay, "found a relay"),
    }
    manager.move_to(session, number).await;
    true
}

/// Opens a session at the relay with a number. Returns both if the relay responds.
async fn open_and_check(manager: Arc<SessionManager>, number: usize) -> Option<(Session, usize)> {
    let relay = &manager.settings().connect[number];
    let session = match manager.open_at(number).await {
        Ok(session) => session,
        Err(problem) => {
            debug!(%relay, %problem, "no session at the relay");
            return None;
        }
    };
    if query_relay(&session, manager.settings().response_limit()).await == Response::Received {
        return Some((session, number));
    }
    debug!(%relay, "the relay does not respond");
    let _ = close(session).await;
    None
}

/// Runs attempts that begin one after the other: each when one has failed, or `pause` after the one before. Returns the first
/// result, and the attempts that have not ended.
async fn first_result<T: Send + 'static>(
    attempts: Vec<impl Future<Output = Option<T>> + Send + 'static>,
    pause: Duration,
) -> (Option<T>, JoinSet<Option<T>>) {
    let mut begun = JoinSet::new();
    for attempt in attempts {
        begun.spawn(attempt);
        if let Ok(Some(Ok(Some(found)))) = timeout(pause, begun.join_next()).await {
            return (Some(found), begun);
        }
    }
    while let Some(ended) = begun.join_next().await {
        if let Ok(Some(found)) = ended {
            return (Some(found), begun);
        }
    }
    (None, begun)
}

/// Closes the sessions of attempts that have not ended.
fn close_all(mut attempts: JoinSet<Option<(Session, usize)>>) {
    tokio::spawn(async move {
        while let Some(ended) = attempts.join_next().await {
            if let Ok(Some((session, _))) = ended {
                let _ = close(session).await;
            }
        }
    });
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
        let order = |present, relays| candidates(present, relays).collect::<Vec<_>>();
        assert_eq!(order(None, 3), [0, 1, 2, 0, 1, 2]);
        assert_eq!(order(Some(0), 3), [1, 2, 1, 2, 0]);
        assert_eq!(order(Some(2), 3), [0, 1, 0, 1, 2]);
        assert_eq!(order(Some(0), 1), [0]);
        assert_eq!(candidates(None, 0).count(), 0);
    }

    /// An attempt that ends after a time.
    async fn attempt(ms: u64, result: Option<u32>) -> Option<u32> {
        sleep(Duration::from_millis(ms)).await;
        result
    }

    #[tokio::test(start_paused = true)]
    async fn a_silent_relay_and_a_lost_attempt_do_not_delay_the_others() {
        for (attempts, expected, took_ms) in [
            (vec![attempt(400, None), attempt(20, Some(2)), attempt(0, Some(3))], Some(2), 220),
            (vec![attempt(5, None), attempt(20, Some(2))], Some(2), 25), // the first relay is refused
            (vec![attempt(230, Some(1)), attempt(400, Some(2))], Some(1), 230),
            (vec![attempt(400, None), attempt(400, None)], None, 600),
            (vec![], None, 0),
        ] {
            let began = Instant::now();
            let (found, _) = first_result(attempts, LIMIT).await;
            let took = began.elapsed().as_millis();
            assert_eq!(found, expected);
            assert!((took_ms..took_ms + 10).contains(&took), "{took} instead of {took_ms} ms");
        }
    }

    #[test]
    fn a_client_moves_within_a_second_although_the_next_relay_is_silent_too() {
        let limit = ZenohSettings::default().response_limit();
        let left = limit * (1 + UNANSWERED_MAX) + SHORT_PAUSE * UNANSWERED_MAX;
        let connecting = limit / 2;
        assert!(left + limit + connecting < Duration::from_secs(1), "{left:?}");
    }
}
