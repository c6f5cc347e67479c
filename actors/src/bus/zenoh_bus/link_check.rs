//! Whether a node and its neighbours hear one another.
//!
//! A link is no proof of it. Zenoh 1.10.2 tells a neighbour of a node's subscriptions, services and tokens when that
//! neighbour is new to its routes, which it works out at most every 100 ms and compares by places in a graph. A link that
//! breaks and is back within that time, or a node that comes while another goes, takes over a place that is known already:
//! it is told of nothing, now or later, and whatever it publishes or asks goes nowhere. So whoever opened a link asks
//! through it, until it has an answer, whether the neighbour hears it and is heard. If not, only a new session helps, which
//! stays away for long enough to be new to everybody.

use super::current_session::CurrentSession;
use super::{BusError, Mode, ZenohSettings, failed};
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

/// Where a node answers its neighbours, outside of any fleet's keys, followed by its id on the bus. With the parameter
/// `back=ID` it answers whether that one answers it.
pub(super) const LINK_CHECK: &str = "consort-hearing";
const YES: &str = "heard";
const NO: &str = "not heard";

/// How long a neighbour has for its answer.
const LIMIT: Duration = Duration::from_secs(2);

/// How long before it is asked, at first and again: routes are there 100 ms after a link.
const PAUSE: Duration = Duration::from_millis(400);

/// So often it does not answer before that is taken for more than a bad moment.
const ENOUGH: u32 = 6;

/// So many sessions are opened for one neighbour in vain: it may speak another language.
const SESSIONS: u32 = 3;

/// Answers neighbours, and asks those to whom this session opens a link.
///
/// Not as a client with a certificate: that is a person, whose link lets in no answers, so that nobody could say that the person
/// hears, and one session after the other would be opened anew in vain.
pub(super) async fn start(current: &Arc<CurrentSession>, settings: &ZenohSettings) -> Result<(), BusError> {
    if settings.mode == Mode::Client && settings.link_trust.is_some() {
        return Ok(());
    }
    let (session, runtime) = (current.session(), Handle::current());
    let own = session.zid();
    let key = format!("{LINK_CHECK}/{own}");
    let (on, weak, spawner) = (key.clone(), Arc::downgrade(current), runtime.clone());
    let answer = move |query: zenoh::query::Query| {
        let (on, weak) = (on.clone(), weak.clone());
        spawner.spawn(async move {
            let heard = match (query.parameters().get("back"), weak.upgrade()) {
                (None, _) => true,
                (Some(back), _) if !is_id(back) => return,
                (Some(back), Some(current)) => ask(&current.session(), &format!("{LINK_CHECK}/{back}")).await.is_some(),
                (Some(_), None) => return,
            };
            // Whoever asked may have gone.
            let _ = query.reply(on, if heard { YES } else { NO }).await;
        });
    };
    session.declare_queryable(key).callback(answer).background().await.map_err(|problem| failed("serve", problem))?;

    let weak = Arc::downgrade(current);
    let accepting: BTreeSet<String> = settings.listen.iter().filter_map(|address| port(address)).collect();
    let linked = move |event: zenoh::session::LinkEvent| {
        let (link, opened) = (event.link(), event.kind() == SampleKind::Put);
        if opened && port(link.src().as_str()).is_some_and(|port| !accepting.contains(&port)) {
            runtime.spawn(be_sure(weak.clone(), own, *link.zid(), link.dst().to_string()));
        }
    };
    let listener = session.info().link_events_listener().history(true).callback(linked).background().await;
    listener.map_err(|problem| failed("notice links", problem))
}

/// Whether a text is one node's id on the bus. Anything else would have the question passed on to whoever matches it.
fn is_id(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// The port of an address as `tcp/127.0.0.1:7447`.
fn port(address: &str) -> Option<String> {
    address.rsplit_once(':').map(|(_, port)| port.to_owned())
}

/// Asks a neighbour until it answers that it is heard and hears. If it does not, the session is replaced.
async fn be_sure(current: Weak<CurrentSession>, own: ZenohId, neighbour: ZenohId, address: String) {
    for _ in 0..ENOUGH {
        sleep(PAUSE).await;
        let Some(current) = current.upgrade() else { return };
        let session = current.session();
        if session.zid() != own || !is_linked(&session, neighbour).await {
            return;
        }
        let heard = match ask(&session, &format!("{LINK_CHECK}/{neighbour}?back={own}")).await {
            Some(answer) => answer == YES,
            // A router that is none of ours says of itself, if anything, what the admin space of Zenoh has.
            None => ask(&session, &format!("@/{neighbour}/router")).await.is_some(),
        };
        if heard {
            current.reset_attempts(&address);
            return;
        }
        debug!(%neighbour, "is not heard, or does not hear");
    }
    let Some(current) = current.upgrade() else { return };
    if !is_linked(&current.session(), neighbour).await {
        return;
    }
    match current.count_attempt(&address) {
        count if count <= SESSIONS => {
            warn!(%neighbour, "linked, and yet one does not hear the other: the session is opened anew");
            current.request_replacement(own);
        }
        _ => warn!(%neighbour, "linked, and yet one does not hear the other, whatever is done; it may be none of ours"),
    }
}

async fn is_linked(session: &Session, neighbour: ZenohId) -> bool {
    !session.is_closed() && session.info().transports().await.any(|link| *link.zid() == neighbour)
}

/// The first answer to a question.
async fn ask(session: &Session, selector: &str) -> Option<String> {
    let asked = session.get(selector).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(LIMIT);
    let (mailbox, mut replies) = tokio::sync::mpsc::unbounded_channel();
    let hear = move |reply: zenoh::query::Reply| {
        if let Ok(sample) = reply.into_result() {
            let _ = mailbox.send(sample.payload().try_to_string().map(|text| text.into_owned()).unwrap_or_default());
        }
    };
    asked.callback(hear).await.ok()?;
    replies.recv().await
}
