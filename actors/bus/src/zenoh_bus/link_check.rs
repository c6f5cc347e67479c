//! Checks that a node and its neighbours receive each other's messages.
//!
//! An open link is no proof of delivery. Zenoh 1.10.2 sends a node's subscriptions, services and
//! tokens to a neighbour when that neighbour is new in its routes. It recomputes routes at most
//! every 100 ms and compares them by positions in a graph. If a link breaks and returns within that
//! time, or a node joins while another leaves, the new node takes a position that counts as known.
//! It then receives no declarations, neither at once nor later, and all its publications and
//! queries are lost.
//!
//! Therefore the node that opened a link queries the neighbour through it, until a reply confirms
//! that messages pass in both directions. If none does, only a new session helps. That session
//! stays away long enough to be new to every neighbour.

use super::current_session::CurrentSession;
use super::error::failed;
use super::settings::{LINK_CHECK, Mode, ZenohSettings};
use super::transmission::zenoh_priority;
use crate::bus::BusError;
use consort_protocol::keys::Priority;
use std::collections::BTreeSet;
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::time::sleep;
use tracing::{debug, warn};
use zenoh::Session;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::SampleKind;
use zenoh::session::ZenohId;

const PASSED: &str = "passed";
const FAILED: &str = "failed";

/// Timeout of a link-check query.
const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// Pause before each query, the first included: routes exist 100 ms after a link opens.
const PAUSE: Duration = Duration::from_millis(400);

/// Failed queries after which the link counts as broken, rather than slow.
const CHECKS_MAX: u32 = 6;

/// Maximum number of sessions opened for a neighbour: it may not support the link check at all.
const SESSIONS_MAX: u32 = 3;

/// Replies to the link checks of neighbours, and checks each link that this session opens.
///
/// Does nothing for a client with a certificate: that is a person, and the access rules of its
/// links reject replies. Every check would fail, and sessions would be reopened for nothing. Does
/// nothing for a node that is the client of a relay: it queries its relay for as long as it runs.
pub(super) async fn start(current: &Arc<CurrentSession>, settings: &ZenohSettings) -> Result<(), BusError> {
    match settings.mode {
        Mode::NodeClient => return Ok(()),
        Mode::Client if settings.link_trust.is_some() => return Ok(()),
        Mode::Client | Mode::Router | Mode::Peer => {}
    }
    let (session, runtime) = (current.session(), Handle::current());
    let own = session.zid();
    let key = format!("{LINK_CHECK}/{own}");
    let (own_key, weak, spawner) = (key.clone(), Arc::downgrade(current), runtime.clone());
    let reply = move |query: zenoh::query::Query| {
        let (own_key, weak) = (own_key.clone(), weak.clone());
        spawner.spawn(async move {
            let passed = match (query.parameters().get("back"), weak.upgrade()) {
                (None, _) => true,
                (Some(back), _) if !is_node_id(back) => return,
                (Some(back), Some(current)) => {
                    first_reply(&current.session(), &format!("{LINK_CHECK}/{back}")).await.is_some()
                }
                (Some(_), None) => return,
            };
            // The requester may be gone: ignore the error.
            let _ = query.reply(own_key, if passed { PASSED } else { FAILED }).await;
        });
    };
    session.declare_queryable(key).callback(reply).background().await.map_err(|problem| failed("serve", problem))?;

    let weak = Arc::downgrade(current);
    let accepting: BTreeSet<String> = settings.listen.iter().filter_map(|address| port(address)).collect();
    let linked = move |event: zenoh::session::LinkEvent| {
        let (link, opened) = (event.link(), event.kind() == SampleKind::Put);
        if opened && port(link.src().as_str()).is_some_and(|port| !accepting.contains(&port)) {
            runtime.spawn(check_link(weak.clone(), own, *link.zid(), link.dst().to_string()));
        }
    };
    let listener = session.info().link_events_listener().history(true).callback(linked).background().await;
    listener.map_err(|problem| failed("watch links", problem))
}

/// Checks whether a text is the id of a single node on the bus. Any other text would be forwarded
/// as a query to all matching nodes.
fn is_node_id(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Returns the port of an address such as `tcp/127.0.0.1:7447`.
fn port(address: &str) -> Option<String> {
    address.rsplit_once(':').map(|(_, port)| port.to_owned())
}

/// Queries a neighbour until a reply confirms delivery in both directions. Requests a new session
/// if none does.
async fn check_link(current: Weak<CurrentSession>, own: ZenohId, neighbour: ZenohId, address: String) {
    for _ in 0..CHECKS_MAX {
        sleep(PAUSE).await;
        let Some(current) = current.upgrade() else { return };
        let session = current.session();
        if session.zid() != own || !is_linked(&session, neighbour).await {
            return;
        }
        let passed = match first_reply(&session, &format!("{LINK_CHECK}/{neighbour}?back={own}")).await {
            Some(reply) => reply == PASSED,
            // A stock Zenoh router replies on the admin space, if that is enabled.
            None => first_reply(&session, &format!("@/{neighbour}/router")).await.is_some(),
        };
        if passed {
            current.reset_attempts(&address);
            return;
        }
        debug!(%neighbour, "link check failed");
    }
    let Some(current) = current.upgrade() else { return };
    if !is_linked(&current.session(), neighbour).await {
        return;
    }
    match current.count_attempt(&address) {
        count if count <= SESSIONS_MAX => {
            warn!(%neighbour, "link is up, but messages are not delivered; reopening the session");
            current.request_replacement(own);
        }
        _ => {
            warn!(%neighbour, "link is up, but messages are not delivered after several new sessions; the neighbour may not be a Consort node");
        }
    }
}

async fn is_linked(session: &Session, neighbour: ZenohId) -> bool {
    !session.is_closed() && session.info().transports().await.any(|link| *link.zid() == neighbour)
}

/// Returns the first reply to a query.
async fn first_reply(session: &Session, selector: &str) -> Option<String> {
    let query =
        session.get(selector).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(QUERY_TIMEOUT);
    // A late reply would close a link that works.
    let query = query.priority(zenoh_priority(Priority::Liveness));
    let (mailbox, mut replies) = tokio::sync::mpsc::unbounded_channel();
    let on_reply = move |reply: zenoh::query::Reply| {
        if let Ok(sample) = reply.into_result() {
            let _ = mailbox.send(sample.payload().try_to_string().map(|text| text.into_owned()).unwrap_or_default());
        }
    };
    query.callback(on_reply).await.ok()?;
    replies.recv().await
}
