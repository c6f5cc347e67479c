//! A session that can be opened anew, with everything that was declared on it.

use super::current_session::CurrentSession;
use super::{
    Mode, ZenohSettings, attachment_bytes, failed, from_zenoh, link_check, open_error, query_callback, to_bytes,
};
use crate::bus::{BusError, Presence, Query, Sample};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;
use tokio::time::sleep;
use tracing::{error, info, warn};
use zenoh::Session;
use zenoh::sample::SampleKind;
use zenoh_keyexpr::OwnedKeyExpr;

/// How long a router stays away before it links up. Zenoh 1.10.2 works out its routes at most every 100 ms, and compares
/// them by the places of the nodes in its graph: who comes within that time after somebody went takes the other's place,
/// counts as known, and is never told of any declaration. See [`hearing`] for those to whom it happens all the same.
const AWAY: Duration = Duration::from_millis(250);

/// How long after a session could not be opened anew it is tried again, and how often.
const TRY_AGAIN: Duration = Duration::from_secs(1);
const TRIES: u32 = 30;

/// What is declared on a session.
#[derive(Clone)]
pub(super) enum Declaration {
    /// Samples are heard.
    Subscriber(OwnedKeyExpr, UnboundedSender<Sample>),
    /// Questions are answered, by one who knows all there is below the key or by one of several.
    Queryable { key: OwnedKeyExpr, mailbox: UnboundedSender<Query>, complete: bool },
    /// Presence is told.
    Token(OwnedKeyExpr),
    /// Presence is heard; what is present is remembered, since Zenoh repeats itself when links come and go.
    PresenceSubscriber(OwnedKeyExpr, UnboundedSender<Presence>, Arc<Mutex<BTreeSet<String>>>),
}

/// A declaration, and what Zenoh gave for it while there is a session.
struct Entry {
    declaration: Declaration,
    declared: Option<Box<dyn Send + Sync>>,
}

/// A session and its declarations. The session closes when this is dropped.
pub(super) struct SessionManager {
    settings: ZenohSettings,
    current: Arc<CurrentSession>,
    entries: Mutex<Entries>,
    /// Held while something is declared, or everything anew.
    declaring: tokio::sync::Mutex<()>,
}

#[derive(Default)]
struct Entries {
    next: u64,
    all: BTreeMap<u64, Entry>,
    /// Nothing is declared any more.
    closed: bool,
}

/// Ends a declaration when dropped.
pub(super) struct DeclarationGuard {
    id: u64,
    life: Weak<SessionManager>,
}

impl Drop for DeclarationGuard {
    fn drop(&mut self) {
        if let Some(life) = self.life.upgrade() {
            let ended = life.entries().all.remove(&self.id);
            drop(ended); // not while the entries are held: Zenoh waits for callbacks under way
        }
    }
}

async fn open(settings: &ZenohSettings) -> Result<Session, BusError> {
    if settings.mode == Mode::Router {
        sleep(AWAY).await;
    }
    let opened = zenoh::open(settings.config()?).await;
    opened.map_err(|problem| open_error(settings, &problem.to_string()))
}

/// Where a session listens, with the ports it was given.
pub(super) async fn listen_addresses(session: &Session) -> Vec<String> {
    session.info().locators().await.iter().map(ToString::to_string).collect()
}

/// Addresses to listen on, with the ports that the system gave for port 0: others know them by now.
fn with_ports(listen: &[String], given: &[String]) -> Vec<String> {
    let at = |address: &String| {
        let Some(host) = address.strip_suffix(":0") else { return address.clone() };
        let same = given.iter().find(|given| given.rsplit_once(':').is_some_and(|(at, _)| at == host));
        let port = same.or(given.first()).and_then(|given| Some(given.rsplit_once(':')?.1));
        port.map_or_else(|| address.clone(), |port| format!("{host}:{port}"))
    };
    listen.iter().map(at).collect()
}

impl Declaration {
    async fn declare(&self, session: &Session, message_max: usize) -> Result<Box<dyn Send + Sync>, BusError> {
        match self {
            Declaration::Subscriber(key, mailbox) => {
                let mailbox = mailbox.clone();
                let hear = move |sample: zenoh::sample::Sample| {
                    if sample.kind() == SampleKind::Put {
                        // Nobody hears it any more: the declaration is about to end.
                        let _ = mailbox.send(Sample {
                            key: sample.key_expr().to_string(),
                            payload: to_bytes(sample.payload()),
                            encoding: from_zenoh(sample.encoding()),
                            attachment: attachment_bytes(sample.attachment()),
                        });
                    }
                };
                let declared = session.declare_subscriber(key.clone()).callback(hear).await;
                Ok(Box::new(declared.map_err(|problem| failed("subscribe", problem))?))
            }
            Declaration::Queryable { key, mailbox, complete } => {
                let declared = session.declare_queryable(key.clone()).complete(*complete);
                let declared = declared.callback(query_callback(mailbox.clone(), session.zid(), message_max)).await;
                Ok(Box::new(declared.map_err(|problem| failed("serve", problem))?))
            }
            Declaration::Token(key) => {
                let declared = session.liveliness().declare_token(key.clone()).await;
                Ok(Box::new(declared.map_err(|problem| failed("announce", problem))?))
            }
            Declaration::PresenceSubscriber(key, mailbox, present) => {
                let (mailbox, present) = (mailbox.clone(), present.clone());
                let hear = move |sample: zenoh::sample::Sample| {
                    let key = sample.key_expr().to_string();
                    let alive = sample.kind() == SampleKind::Put;
                    let mut present = present.lock().unwrap_or_else(PoisonError::into_inner);
                    let changed = if alive { present.insert(key.clone()) } else { present.remove(&key) };
                    if changed {
                        let _ = mailbox.send(Presence { key, alive });
                    }
                };
                let declared = session.liveliness().declare_subscriber(key.clone()).history(true).callback(hear).await;
                Ok(Box::new(declared.map_err(|problem| failed("watch", problem))?))
            }
        }
    }

    /// Without a session nobody is known to be present.
    fn lose_sight(&self) {
        if let Declaration::PresenceSubscriber(_, mailbox, present) = self {
            for key in std::mem::take(&mut *present.lock().unwrap_or_else(PoisonError::into_inner)) {
                let _ = mailbox.send(Presence { key, alive: false });
            }
        }
    }
}

impl SessionManager {
    /// Opens a session.
    pub(super) async fn open(mut settings: ZenohSettings) -> Result<Arc<SessionManager>, BusError> {
        let session = open(&settings).await?;
        settings.listen = with_ports(&settings.listen, &listen_addresses(&session).await);
        let (current, mut asked) = CurrentSession::new(session);
        let life = Arc::new(SessionManager {
            settings,
            current: Arc::new(current),
            entries: Mutex::default(),
            declaring: tokio::sync::Mutex::default(),
        });
        link_check::start(&life.current, &life.settings).await?;
        let weak = Arc::downgrade(&life);
        tokio::spawn(async move {
            while let Some(stale) = asked.recv().await {
                let Some(life) = weak.upgrade() else { return };
                if life.session().zid() == stale {
                    life.begin_anew().await;
                }
            }
        });
        Ok(life)
    }

    pub(super) fn settings(&self) -> &ZenohSettings {
        &self.settings
    }

    /// The session of now. After it was closed everything that is attempted fails.
    pub(super) fn session(&self) -> Session {
        self.current.session()
    }

    fn entries(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Declares something until what is returned is dropped; it outlives the session.
    pub(super) async fn declare(self: &Arc<Self>, declaration: Declaration) -> Result<DeclarationGuard, BusError> {
        let _declaring = self.declaring.lock().await;
        let declared = declaration.declare(&self.session(), self.settings.message_max).await?;
        let mut entries = self.entries();
        if entries.closed {
            return Err(failed("declare", "the bus has been closed"));
        }
        let id = entries.next;
        entries.next += 1;
        entries.all.insert(id, Entry { declaration, declared: Some(declared) });
        Ok(DeclarationGuard { id, life: Arc::downgrade(self) })
    }

    /// Declares everything on a new session.
    async fn declare_all(&self, session: &Session) -> Result<(), BusError> {
        let wanted: Vec<u64> = self.entries().all.keys().copied().collect();
        for id in wanted {
            let Some(declaration) = self.entries().all.get(&id).map(|entry| entry.declaration.clone()) else {
                continue;
            };
            let declared = declaration.declare(session, self.settings.message_max).await?;
            let mut entries = self.entries();
            // Otherwise it ended in the meantime, and so does what was declared for it.
            if let Some(entry) = entries.all.get_mut(&id) {
                entry.declared = Some(declared);
            }
        }
        Ok(())
    }

    fn end_all(&self) {
        let all = {
            let mut entries = self.entries();
            entries.closed = true;
            std::mem::take(&mut entries.all)
        };
        drop(all); // not while the entries are held: Zenoh waits for callbacks under way
    }

    /// Ends everything declared, and the session.
    pub(super) async fn close(&self) -> Result<(), BusError> {
        self.end_all();
        self.session().close().await.map_err(|problem| failed("close", problem))
    }

    /// Opens the session anew, at the same addresses, and declares everything again. Meanwhile publications and questions
    /// fail, and presence is out of sight. If that cannot be done for long, the bus closes: every stream ends, and whoever
    /// supervises the node learns of it.
    async fn begin_anew(self: &Arc<Self>) {
        let _declaring = self.declaring.lock().await;
        let ended: Vec<_> = {
            let mut entries = self.entries();
            entries.all.values_mut().filter_map(|entry| entry.declared.take()).collect()
        };
        drop(ended);
        if let Err(problem) = self.session().close().await {
            warn!(%problem, "a session did not close well");
        }
        self.entries().all.values().for_each(|entry| entry.declaration.lose_sight());
        let mut tries = 0;
        let session = loop {
            if self.entries().closed {
                return;
            }
            let problem = match open(&self.settings).await {
                Ok(session) => match self.declare_all(&session).await {
                    Ok(()) => break session,
                    Err(problem) => {
                        // The next try declares everything on a session of its own.
                        let _ = session.close().await;
                        problem
                    }
                },
                Err(problem) => problem,
            };
            tries += 1;
            if tries >= TRIES {
                error!(%problem, "the session cannot be opened anew: the bus is closed");
                self.end_all();
                return;
            }
            warn!(%problem, "the session cannot be opened anew; tries again");
            sleep(TRY_AGAIN).await;
        };
        self.current.set(session.clone());
        if self.entries().closed {
            // Nobody closed this one.
            let _ = session.close().await;
            return;
        }
        info!(id = %session.zid(), "opened its session anew");
        if let Err(problem) = link_check::start(&self.current, &self.settings).await {
            warn!(%problem, "does not notice if it is not heard");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::with_ports;

    #[test]
    fn a_port_that_was_given_is_kept() {
        let listen = ["tcp/127.0.0.1:0", "tcp/[::1]:7", "tcp/0.0.0.0:0"].map(str::to_owned);
        let given = ["tcp/127.0.0.1:38589", "tcp/[::1]:7"].map(str::to_owned);
        assert_eq!(with_ports(&listen, &given), ["tcp/127.0.0.1:38589", "tcp/[::1]:7", "tcp/0.0.0.0:38589"]);
        assert_eq!(with_ports(&listen[..1], &[]), ["tcp/127.0.0.1:0"]);
    }
}
