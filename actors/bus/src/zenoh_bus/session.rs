//! A session that can be reopened, together with all declarations on it.

use super::conversion::{attachment_bytes, from_zenoh, query_callback, to_bytes};
use super::current_session::CurrentSession;
use super::error::{failed, open_error};
use super::link_check;
use super::presence::PresentTokens;
use super::settings::{Mode, ZenohSettings};
use super::transmission::Senders;
use crate::author::Author;
use crate::bus::{BusError, Presence, Sample};
use crate::mailbox::MailboxSender;
use crate::open_queries::QuerySender;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};
use tokio::time::sleep;
use tracing::{debug, error, info, warn};
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait as _};
use zenoh_keyexpr::OwnedKeyExpr;

/// Pause before a router opens its session. Zenoh 1.10.2 recomputes its routes at most every 100
/// ms, and compares them by the nodes' positions in its graph. A node that joins within that time
/// after another has left takes the other's position, counts as known, and never receives a
/// declaration. See [`link_check`] for the cases in which this happens nevertheless.
const ROUTER_DELAY: Duration = Duration::from_millis(250);

/// Pause between attempts to reopen a session, and the number of attempts.
const RETRY_PAUSE: Duration = Duration::from_secs(1);
const ATTEMPTS_MAX: u32 = 30;

/// A declaration on a session.
#[derive(Clone)]
pub(super) enum Declaration {
    /// Receives samples.
    Subscriber(OwnedKeyExpr, MailboxSender<Sample>),
    /// Replies to queries: as a complete service for everything below the key, or as a service
    /// among several.
    Queryable { key: OwnedKeyExpr, mailbox: QuerySender, complete: bool },
    /// Announces presence.
    Token(OwnedKeyExpr),
    /// Receives changes of presence.
    PresenceSubscriber(OwnedKeyExpr, MailboxSender<Presence>, Arc<Mutex<PresentTokens>>),
}

/// A declaration, and Zenoh's object for it while a session exists.
struct Entry {
    declaration: Declaration,
    declared: Option<Box<dyn Send + Sync>>,
}

/// A session and its declarations. The session closes when this is dropped.
pub(super) struct SessionManager {
    settings: ZenohSettings,
    current: Arc<CurrentSession>,
    entries: Mutex<Entries>,
    /// Held during a declaration, and while everything is declared again.
    declaring: tokio::sync::Mutex<()>,
    senders: Senders,
    /// Number of the relay of a client in its settings; `None` without a relay.
    relay: Mutex<Option<usize>>,
}

#[derive(Default)]
struct Entries {
    next: u64,
    all: BTreeMap<u64, Entry>,
    /// Set once the bus is closed: no further declarations.
    closed: bool,
}

/// Guard that ends a declaration when it is dropped.
pub(super) struct DeclarationGuard {
    id: u64,
    manager: Weak<SessionManager>,
}

impl Drop for DeclarationGuard {
    fn drop(&mut self) {
        if let Some(manager) = self.manager.upgrade() {
            let removed = manager.entries().all.remove(&self.id);
            drop(removed); // not while the entries are held: Zenoh waits for callbacks under way
        }
    }
}

/// A session that was opened.
struct Opened {
    session: Session,
    /// Number of the relay, if the session is that of a [`Mode::NodeClient`] with a relay.
    relay: Option<usize>,
}

async fn open(settings: &ZenohSettings) -> Result<Opened, BusError> {
    match settings.mode {
        Mode::NodeClient => return open_at_any_relay(settings).await,
        Mode::Router => sleep(ROUTER_DELAY).await,
        Mode::Client | Mode::Peer => {}
    }
    Ok(Opened { session: open_with(settings).await?, relay: None })
}

async fn open_with(settings: &ZenohSettings) -> Result<Session, BusError> {
    let opened = zenoh::open(settings.config()?).await;
    opened.map_err(|problem| open_error(settings, &problem.to_string()))
}

/// Opens a session at the first relay that can be reached; if there is none, a session without links.
async fn open_at_any_relay(settings: &ZenohSettings) -> Result<Opened, BusError> {
    settings.config()?; // invalid settings are an error, in contrast to a relay that cannot be reached
    for (number, relay) in settings.connect.iter().enumerate() {
        match open_with(&settings.with_relay(relay)).await {
            Ok(session) => return Ok(Opened { session, relay: Some(number) }),
            Err(problem) => debug!(%relay, %problem, "the relay cannot be reached"),
        }
    }
    let relays = settings.connect.join(", ");
    warn!(relays, "no relay can be reached; the node works alone, and keeps trying");
    Ok(Opened { session: open_with(&settings.without_links()).await?, relay: None })
}

/// Returns the addresses that a session listens on, with the assigned ports.
pub(super) async fn listen_addresses(session: &Session) -> Vec<String> {
    session.info().locators().await.iter().map(ToString::to_string).collect()
}

/// Returns the addresses to listen on, with the ports that the system assigned for port 0: other
/// nodes have them by now.
fn with_ports(listen: &[String], assigned: &[String]) -> Vec<String> {
    let at = |address: &String| {
        let Some(host) = address.strip_suffix(":0") else { return address.clone() };
        let same = assigned.iter().find(|assigned| assigned.rsplit_once(':').is_some_and(|(at, _)| at == host));
        let port = same.or(assigned.first()).and_then(|assigned| Some(assigned.rsplit_once(':')?.1));
        port.map_or_else(|| address.clone(), |port| format!("{host}:{port}"))
    };
    listen.iter().map(at).collect()
}

/// Closes a session, on a thread of its own. The message that closes a link has the lowest priority, and Zenoh blocks the
/// thread while other messages of this priority wait for a slow link.
pub(super) async fn close(session: Session) -> Result<(), BusError> {
    let closed = tokio::task::spawn_blocking(move || session.close().wait()).await;
    closed.map_err(|problem| failed("close", problem))?.map_err(|problem| failed("close", problem))
}

/// Closes a session that is no longer used: its relay may not respond.
fn close_in_background(session: Session) {
    tokio::spawn(async move {
        if let Err(problem) = close(session).await {
            debug!(%problem, "failed to close the session at the former relay");
        }
    });
}

impl Declaration {
    async fn declare(
        &self,
        session: &Session,
        message_max: usize,
        senders: &Senders,
    ) -> Result<Box<dyn Send + Sync>, BusError> {
        match self {
            Declaration::Subscriber(key, mailbox) => {
                let mailbox = mailbox.clone();
                let on_sample = move |sample: zenoh::sample::Sample| {
                    if sample.kind() == SampleKind::Put {
                        // It fails if the receiver is gone: the declaration is about to end.
                        mailbox.send(Sample {
                            key: sample.key_expr().to_string(),
                            payload: to_bytes(sample.payload()),
                            encoding: from_zenoh(sample.encoding()),
                            attachment: attachment_bytes(sample.attachment()),
                            author: Author::UNKNOWN,
                        });
                    }
                };
                let declared = session.declare_subscriber(key.clone()).callback(on_sample).await;
                Ok(Box::new(declared.map_err(|problem| failed("subscribe", problem))?))
            }
            Declaration::Queryable { key, mailbox, complete } => {
                let declared = session.declare_queryable(key.clone()).complete(*complete);
                let on_query = query_callback(mailbox.clone(), session.zid(), message_max, senders.clone());
                let declared = declared.callback(on_query).await;
                Ok(Box::new(declared.map_err(|problem| failed("serve", problem))?))
            }
            Declaration::Token(key) => {
                let declared = session.liveliness().declare_token(key.clone()).await;
                Ok(Box::new(declared.map_err(|problem| failed("announce", problem))?))
            }
            Declaration::PresenceSubscriber(key, mailbox, present) => {
                let (mailbox, present) = (mailbox.clone(), present.clone());
                let on_sample = move |sample: zenoh::sample::Sample| {
                    let key = sample.key_expr().to_string();
                    let mut present = present.lock().unwrap_or_else(PoisonError::into_inner);
                    let change = match sample.kind() {
                        SampleKind::Put => present.appeared(key),
                        SampleKind::Delete => present.vanished(key, Instant::now()),
                    };
                    if let Some(change) = change {
                        mailbox.send(change);
                    }
                };
                let declared =
                    session.liveliness().declare_subscriber(key.clone()).history(true).callback(on_sample).await;
                Ok(Box::new(declared.map_err(|problem| failed("watch", problem))?))
            }
        }
    }

    /// Reports changes of presence that `change` makes to the present tokens.
    fn report_presence(&self, change: impl FnOnce(&mut PresentTokens) -> Vec<Presence>) {
        if let Declaration::PresenceSubscriber(_, mailbox, present) = self {
            let mut present = present.lock().unwrap_or_else(PoisonError::into_inner);
            for change in change(&mut present) {
                mailbox.send(change);
            }
        }
    }
}

impl SessionManager {
    /// Opens a session.
    pub(super) async fn open(mut settings: ZenohSettings) -> Result<Arc<SessionManager>, BusError> {
        let Opened { session, relay } = open(&settings).await?;
        settings.listen = with_ports(&settings.listen, &listen_addresses(&session).await);
        let (current, mut replacements) = CurrentSession::new(session);
        let manager = Arc::new(SessionManager {
            settings,
            current: Arc::new(current),
            entries: Mutex::default(),
            declaring: tokio::sync::Mutex::default(),
            senders: Senders::default(),
            relay: Mutex::new(relay),
        });
        link_check::start(&manager.current, &manager.settings).await?;
        let weak = Arc::downgrade(&manager);
        tokio::spawn(async move {
            while let Some(stale) = replacements.recv().await {
                let Some(manager) = weak.upgrade() else { return };
                if manager.session().zid() == stale {
                    manager.reopen().await;
                }
            }
        });
        Ok(manager)
    }

    pub(super) fn settings(&self) -> &ZenohSettings {
        &self.settings
    }

    /// Returns the session in use. Every operation on a closed session fails.
    pub(super) fn session(&self) -> Session {
        self.current.session()
    }

    pub(super) fn senders(&self) -> &Senders {
        &self.senders
    }

    fn entries(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a declaration. It lasts until the returned guard is dropped, and survives a reopening
    /// of the session.
    pub(super) async fn declare(self: &Arc<Self>, declaration: Declaration) -> Result<DeclarationGuard, BusError> {
        let _declaring = self.declaring.lock().await;
        let declared = declaration.declare(&self.session(), self.settings.message_max, &self.senders).await?;
        let mut entries = self.entries();
        if entries.closed {
            return Err(failed("declare", "the bus has been closed"));
        }
        let id = entries.next;
        entries.next += 1;
        entries.all.insert(id, Entry { declaration, declared: Some(declared) });
        Ok(DeclarationGuard { id, manager: Arc::downgrade(self) })
    }

    /// Repeats all declarations on a new session.
    async fn declare_all(&self, session: &Session) -> Result<(), BusError> {
        let ids: Vec<u64> = self.entries().all.keys().copied().collect();
        for id in ids {
            let Some(declaration) = self.entries().all.get(&id).map(|entry| entry.declaration.clone()) else {
                continue;
            };
            let declared = declaration.declare(session, self.settings.message_max, &self.senders).await?;
            let mut entries = self.entries();
            // A missing entry has ended in the meantime; the new declaration then ends as well.
            if let Some(entry) = entries.all.get_mut(&id) {
                entry.declared = Some(declared);
            }
        }
        Ok(())
    }

    /// Ends all declarations on the session in use; they are to be repeated on another.
    fn undeclare_all(&self) {
        let removed: Vec<_> = self.entries().all.values_mut().filter_map(|entry| entry.declared.take()).collect();
        drop(removed); // not while the entries are held: Zenoh waits for callbacks under way
    }

    /// Reports changes of presence to each subscriber.
    fn report_presence(&self, change: impl Fn(&mut PresentTokens) -> Vec<Presence>) {
        self.entries().all.values().for_each(|entry| entry.declaration.report_presence(&change));
    }

    /// Reports the presence tokens that have vanished and have not returned.
    pub(super) fn report_vanished(&self) {
        let now = Instant::now();
        self.report_presence(|present| present.due(now));
    }

    pub(super) fn is_closed(&self) -> bool {
        self.entries().closed
    }

    /// Returns the number of the relay in use.
    pub(super) fn relay(&self) -> Option<usize> {
        *self.relay.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set_relay(&self, relay: Option<usize>) {
        *self.relay.lock().unwrap_or_else(PoisonError::into_inner) = relay;
    }

    /// Opens a session at the relay with a number, for [`move_to`](Self::move_to).
    pub(super) async fn open_at(&self, relay: usize) -> Result<Session, BusError> {
        open_with(&self.settings.with_relay(&self.settings.connect[relay])).await
    }

    /// Replaces the session in use by one at the relay with a number, and repeats all declarations on
    /// it. Presence tokens that it does not announce are reported as vanished after a pause.
    pub(super) async fn move_to(self: &Arc<Self>, session: Session, relay: usize) {
        let declaring = self.declaring.lock().await;
        self.undeclare_all();
        let now = Instant::now();
        self.report_presence(|present| {
            present.all_vanished(now);
            vec![]
        });
        if let Err(problem) = self.declare_all(&session).await {
            warn!(%problem, "failed to repeat the declarations at another relay; reopening the session");
            close_in_background(session);
            drop(declaring);
            return self.reopen().await;
        }
        let old = self.session();
        self.current.set(session.clone());
        self.set_relay(Some(relay));
        close_in_background(old);
        if self.is_closed() {
            // The bus was closed meanwhile, which did not cover this session.
            close_in_background(session);
        }
    }

    fn end_all(&self) {
        let all = {
            let mut entries = self.entries();
            entries.closed = true;
            std::mem::take(&mut entries.all)
        };
        drop(all); // not while the entries are held: Zenoh waits for callbacks under way
    }

    /// Ends all declarations, and the session.
    pub(super) async fn close(&self) -> Result<(), BusError> {
        self.end_all();
        close(self.session()).await
    }

    /// Reopens the session at the same addresses, and repeats all declarations. Meanwhile
    /// publications and queries fail, and no presence is known. After too many failed attempts the
    /// bus closes: every stream ends, and the node's supervisor is notified.
    async fn reopen(self: &Arc<Self>) {
        let _declaring = self.declaring.lock().await;
        self.undeclare_all();
        if let Err(problem) = close(self.session()).await {
            warn!(%problem, "failed to close the old session");
        }
        self.report_presence(PresentTokens::take_all);
        let mut attempts = 0;
        let Opened { session, relay } = loop {
            if self.is_closed() {
                return;
            }
            let problem = match open(&self.settings).await {
                Ok(opened) => match self.declare_all(&opened.session).await {
                    Ok(()) => break opened,
                    Err(problem) => {
                        // The next attempt repeats all declarations on a session of its own.
                        let _ = close(opened.session).await;
                        problem
                    }
                },
                Err(problem) => problem,
            };
            attempts += 1;
            if attempts >= ATTEMPTS_MAX {
                error!(%problem, "failed to reopen the session; closing the bus");
                self.end_all();
                return;
            }
            warn!(%problem, "failed to reopen the session; retrying");
            sleep(RETRY_PAUSE).await;
        };
        self.current.set(session.clone());
        self.set_relay(relay);
        if self.is_closed() {
            // The bus was closed meanwhile, which did not cover this session.
            let _ = close(session).await;
            return;
        }
        info!(id = %session.zid(), "reopened the session");
        if let Err(problem) = link_check::start(&self.current, &self.settings).await {
            warn!(%problem, "failed to start the link check; undelivered links stay unnoticed");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::with_ports;

    #[test]
    fn an_assigned_port_is_kept() {
        let listen = ["tcp/127.0.0.1:0", "tcp/[::1]:7", "tcp/0.0.0.0:0"].map(str::to_owned);
        let assigned = ["tcp/127.0.0.1:38589", "tcp/[::1]:7"].map(str::to_owned);
        assert_eq!(with_ports(&listen, &assigned), ["tcp/127.0.0.1:38589", "tcp/[::1]:7", "tcp/0.0.0.0:38589"]);
        assert_eq!(with_ports(&listen[..1], &[]), ["tcp/127.0.0.1:0"]);
    }
}
