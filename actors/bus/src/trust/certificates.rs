//! Exchange of certificates: a node that receives an unknown fingerprint queries the certificate's
//! owner, and without a reply the nodes that know it. A record of a third node, which arrives
//! through another, can thus be verified without a path to its owner.

use super::files::{RevokedFile, RevokedFiles, TrustError};
use super::keyring::Keyring;
use super::link_revocation::register_link_check;
use super::rejections::RejectionLog;
use crate::bus::{BusError, Encoding, Query, SharedBus, Stream};
use crate::clock::Clock;
use bytes::Bytes;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::trust::{Fingerprint, Principal};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use tracing::{debug, warn};

/// Timeout of a certificate query.
const QUERY_TIMEOUT: Duration = Duration::from_secs(2);

/// Pause before another query, after a query without a valid certificate.
const RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Maximum number of concurrent queries. Only a member of the fleet can invent fingerprints, and it
/// delays other queries by no more than this.
const QUERIES_MAX: usize = 32;

/// Interval at which the list of revoked certificates is read.
const READ_INTERVAL: Duration = Duration::from_secs(2);

/// Interval at which all certificates are verified again, even if the list is unchanged:
/// certificates expire.
const RECHECK_INTERVAL: Duration = Duration::from_secs(10);

/// Queries certificates, serves the node's own, and verifies all again periodically, until it is
/// dropped.
pub(super) struct CertificateExchange {
    requested: Sender<Fingerprint>,
    _tasks: JoinSet<()>,
}

/// State shared by the tasks.
#[derive(Clone)]
pub(super) struct ExchangeContext {
    pub(super) bus: SharedBus,
    pub(super) keys: Keys,
    pub(super) keyring: Arc<Keyring>,
    pub(super) clock: Clock,
    pub(super) rejections: Arc<RejectionLog>,
}

impl CertificateExchange {
    /// Starts to serve the node's own certificate and to query others.
    pub(super) async fn open(context: ExchangeContext, revoked: RevokedFiles) -> Result<CertificateExchange, BusError> {
        let (requested, requests) = channel(QUERIES_MAX);
        let mut tasks = JoinSet::new();
        // Persons publish no messages, so no node queries their certificates; and their links
        // reject services.
        if let Principal::Node { .. } = context.keyring.identity().principal {
            let own = context.keys.write(&Key::Certificate(context.keyring.fingerprint()));
            let queried = context.bus.serve(&own).await?;
            tasks.spawn(serve_own(queried, own, Bytes::from(context.keyring.own_certificate())));
            let queried = context.bus.serve(&context.keys.any_known_certificate()).await?;
            tasks.spawn(serve_known(queried, context.clone()));
        }
        tasks.spawn(recheck_all(revoked, context.clone()));
        tasks.spawn(query_requested(context, requests));
        Ok(CertificateExchange { requested, _tasks: tasks })
    }

    /// Requests the certificate of a fingerprint.
    pub(super) fn request(&self, fingerprint: Fingerprint) {
        // The next message of its principal requests it again.
        let _ = self.requested.try_send(fingerprint);
    }
}

/// Serves the node's own certificate.
async fn serve_own(mut queried: Stream<Query>, key: String, certificate: Bytes) {
    while let Some(query) = queried.recv().await {
        if let Err(problem) = query.replier.reply(&key, certificate.clone(), Encoding::Wire).await {
            debug!(%problem, "failed to send the own certificate");
        }
    }
}

/// Serves the certificates of other nodes: a certificate proves itself.
async fn serve_known(mut queried: Stream<Query>, context: ExchangeContext) {
    while let Some(query) = queried.recv().await {
        let Some(Key::KnownCertificate(fingerprint)) = context.keys.read(&query.key) else { continue };
        let Some(certificate) = context.keyring.certificate(fingerprint) else { continue };
        if let Err(problem) = query.replier.reply(&query.key, certificate.bytes(), Encoding::Wire).await {
            debug!(%problem, "failed to send a certificate");
        }
    }
}

/// Queries the requested certificates, each at most once at a time.
async fn query_requested(context: ExchangeContext, mut requests: Receiver<Fingerprint>) {
    let mut queried: BTreeMap<Fingerprint, Instant> = BTreeMap::new();
    let mut queries = JoinSet::new();
    while let Some(requested) = requests.recv().await {
        while queries.try_join_next().is_some() {}
        let now = Instant::now();
        queried.retain(|_, at| now < *at + RETRY_PAUSE);
        if queried.contains_key(&requested)
            || queries.len() >= QUERIES_MAX
            || context.keyring.certificate(requested).is_some()
        {
            continue;
        }
        queried.insert(requested, now);
        queries.spawn(query_certificate(context.clone(), requested));
    }
}

async fn query_certificate(context: ExchangeContext, requested: Fingerprint) {
    for key in [Key::Certificate(requested), Key::KnownCertificate(requested)] {
        match query_on(&context, &key, requested).await {
            Ok(true) => return,
            Ok(false) => {}
            Err(problem) => return debug!(%problem, "failed to query a certificate"),
        }
    }
}

/// Queries a certificate on a key, and stores the first valid reply. Returns false without one.
async fn query_on(context: &ExchangeContext, key: &Key, requested: Fingerprint) -> Result<bool, BusError> {
    let mut replies = context.bus.query(&context.keys.write(key), Bytes::new(), QUERY_TIMEOUT).await?;
    while let Ok(Some(reply)) = timeout(QUERY_TIMEOUT, replies.recv()).await {
        let Ok(certificate) = reply.payload else { continue };
        match context.keyring.add_certificate(&certificate, context.clock.unix_time()) {
            Ok(verified) if verified.fingerprint() == requested => {
                debug!(identity = %verified.identity, "received a certificate");
                return Ok(true);
            }
            Ok(_) => {}
            Err(problem) => {
                context
                    .rejections
                    .record(format!("reply to the query for certificate {requested} rejected: {problem}"));
            }
        }
    }
    Ok(false)
}

/// Verifies all certificates again, periodically, with the latest list of revoked certificates.
async fn recheck_all(files: RevokedFiles, context: ExchangeContext) {
    let ExchangeContext { keyring, clock, rejections, .. } = context;
    let links = register_link_check(&keyring, clock, rejections);
    let mut due = interval(READ_INTERVAL);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut last_read, mut next_recheck) = (Ok(None), Instant::now());
    loop {
        due.tick().await;
        let read = files.list.as_deref().map_or(Ok(None), RevokedFile::read);
        let mut is_new = false;
        if read != last_read {
            match replace_list(&read, &keyring, &files, clock) {
                Ok(replaced) => is_new = replaced,
                Err(problem) => warn!(%problem, "list of revoked certificates not used; keeping the previous list"),
            }
            last_read = read;
        }
        if !is_new && Instant::now() < next_recheck {
            continue;
        }
        next_recheck = Instant::now() + RECHECK_INTERVAL;
        for (identity, problem) in keyring.recheck(clock.unix_time()) {
            warn!(principal = %identity.principal, %problem, "certificate is no longer valid");
        }
        if is_new {
            links.repeat();
        }
    }
}

/// Uses a list that was read. Returns false if there is none.
fn replace_list(
    read: &Result<Option<RevokedFile>, TrustError>,
    keyring: &Keyring,
    files: &RevokedFiles,
    clock: Clock,
) -> Result<bool, String> {
    let Some(list) = read.as_ref().map_err(TrustError::to_string)? else { return Ok(false) };
    let file = files.list.as_deref().unwrap_or(Path::new("")).display();
    keyring.replace_revoked(list.der.clone(), clock.unix_time()).map_err(|problem| format!("{file}: {problem}"))?;
    if let Some(kept) = &files.kept
        && let Err(problem) = list.write(kept)
    {
        warn!(file = %kept.display(), %problem, "the list of revoked certificates cannot be kept");
    }
    Ok(true)
}
