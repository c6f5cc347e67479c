//! How nodes learn each other's certificates: whoever hears a fingerprint that it does not know asks its bearer.

use super::files::read_revoked;
use super::keyring::Keyring;
use super::link_revocation::register_link_check;
use super::rejections::RejectionLog;
use crate::bus::{BusError, Encoding, SharedBus, Stream};
use crate::clock::Clock;
use bytes::Bytes;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::trust::{Fingerprint, Principal};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use tracing::{debug, warn};

/// How long a bearer has to show its certificate.
const SHOWN_WITHIN: Duration = Duration::from_secs(2);

/// How long a bearer who showed none, or none that is believed, is not asked again.
const NOT_AGAIN_FOR: Duration = Duration::from_secs(1);

/// How many are asked at once. Who makes up fingerprints is a member of the fleet, and holds up others no longer than this.
const AT_ONCE: usize = 32;

/// How often the list of revoked certificates is read.
const READ_EVERY: Duration = Duration::from_secs(2);

/// How often everybody is judged anew, though the list is as it was: certificates end.
const REVIEWED_EVERY: Duration = Duration::from_secs(10);

/// Asks for certificates, shows the own, and reviews all, for as long as it lives.
pub(super) struct CertificateExchange {
    wanted: UnboundedSender<Fingerprint>,
    _tasks: JoinSet<()>,
}

/// What the tasks work with.
#[derive(Clone)]
struct Parts {
    bus: SharedBus,
    keys: Keys,
    keyring: Arc<Keyring>,
    clock: Clock,
    refusals: Arc<RejectionLog>,
}

impl CertificateExchange {
    /// Begins to show the own certificate, and to ask for others'.
    pub(super) async fn open(
        bus: SharedBus,
        keys: Keys,
        keyring: Arc<Keyring>,
        revoked: Option<PathBuf>,
        clock: Clock,
        refusals: Arc<RejectionLog>,
    ) -> Result<CertificateExchange, BusError> {
        let parts = Parts { bus, keys, keyring, clock, refusals };
        let (wanted, wishes) = unbounded_channel();
        let mut tasks = JoinSet::new();
        // People say nothing, so nobody asks for theirs; and their links let no service in.
        if let Principal::Node { .. } = parts.keyring.identity().principal {
            let own = parts.keys.write(&Key::Certificate(parts.keyring.fingerprint()));
            let asked = parts.bus.serve(&own).await?;
            tasks.spawn(show(asked, own, Bytes::from(parts.keyring.own_certificate())));
        }
        tasks.spawn(review(revoked, parts.clone()));
        tasks.spawn(learn(parts, wishes));
        Ok(CertificateExchange { wanted, _tasks: tasks })
    }

    /// Somebody was heard whose certificate is not known.
    pub(super) fn request(&self, of: Fingerprint) {
        let _ = self.wanted.send(of);
    }
}

/// Shows the own certificate to whoever asks.
async fn show(mut asked: Stream<crate::bus::Query>, key: String, certificate: Bytes) {
    while let Some(query) = asked.recv().await {
        if let Err(problem) = query.replier.reply(&key, certificate.clone(), Encoding::Wire).await {
            debug!(%problem, "the certificate was not shown");
        }
    }
}

/// Asks for what is wanted, each once at a time.
async fn learn(parts: Parts, mut wishes: UnboundedReceiver<Fingerprint>) {
    let mut asked: BTreeMap<Fingerprint, Instant> = BTreeMap::new();
    let mut asking = JoinSet::new();
    while let Some(wanted) = wishes.recv().await {
        while asking.try_join_next().is_some() {}
        let now = Instant::now();
        asked.retain(|_, at| now < *at + NOT_AGAIN_FOR);
        if asked.contains_key(&wanted) || asking.len() >= AT_ONCE || parts.keyring.certificate(wanted).is_some() {
            continue;
        }
        asked.insert(wanted, now);
        asking.spawn(ask(parts.clone(), wanted));
    }
}

async fn ask(parts: Parts, wanted: Fingerprint) {
    let key = parts.keys.write(&Key::Certificate(wanted));
    let mut shown = match parts.bus.query(&key, Bytes::new(), SHOWN_WITHIN).await {
        Ok(shown) => shown,
        Err(problem) => return debug!(%problem, "a certificate was not asked for"),
    };
    while let Ok(Some(reply)) = timeout(SHOWN_WITHIN, shown.recv()).await {
        let Ok(certificate) = reply.payload else { continue };
        match parts.keyring.add_certificate(&certificate, unix_time(parts.clock)) {
            Ok(card) if card.fingerprint() == wanted => return debug!(identity = %card.identity, "known"),
            Ok(_) => {}
            Err(problem) => parts.refusals.record(format!("the bearer of certificate {wanted}: {problem}")),
        }
    }
}

/// Judges everybody anew, now and then.
async fn review(file: Option<PathBuf>, parts: Parts) {
    let Parts { keyring, clock, refusals, .. } = parts;
    let links = register_link_check(&keyring, clock, refusals);
    let mut due = interval(READ_EVERY);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut unread, mut known, mut again) = (false, None, Instant::now());
    loop {
        due.tick().await;
        let revoked = match file.as_deref().map(read_revoked).transpose() {
            Ok(revoked) => {
                unread = false;
                revoked
            }
            Err(problem) => {
                if !unread {
                    warn!(%problem, "the list of revoked certificates stays as it was");
                }
                unread = true;
                None
            }
        };
        let is_new = revoked.is_some() && revoked != known;
        if !is_new && Instant::now() < again {
            continue;
        }
        again = Instant::now() + REVIEWED_EVERY;
        if is_new {
            known.clone_from(&revoked);
        }
        for (identity, problem) in keyring.recheck(revoked, unix_time(clock)) {
            warn!(bearer = %identity.principal, %problem, "no longer believed");
        }
        if is_new {
            links.again();
        }
    }
}

/// The time since 1970.
pub(super) fn unix_time(clock: Clock) -> Duration {
    Duration::from_millis(clock.wall_ms())
}
