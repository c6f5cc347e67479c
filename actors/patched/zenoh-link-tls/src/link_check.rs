//! Added for Consort: the TLS stream of a link behind a lock, and checks of the certificate at the
//! other end.
//!
//! Reader and writer of a link use the same TLS connection, so each poll takes the lock
//! (eclipse-zenoh/zenoh#2557).
//!
//! Zenoh reads no lists of revoked certificates, and its users learn only the common name at the
//! other end of a link. Therefore a program with such a list registers a check here. The check
//! receives the certificate at the other end of each link that is opened, from either side. When
//! the program reports a changed list, the check receives the certificates of all open links. A
//! rejected link fails every read and write, so Zenoh closes it.

use std::{
    collections::BTreeMap,
    io,
    net::Shutdown,
    pin::Pin,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex, MutexGuard, PoisonError, Weak,
    },
    task::{Context, Poll},
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::TcpStream,
};
use tokio_rustls::TlsStream;

/// A TLS stream that a reader and a writer use in turns: each poll takes the lock.
#[derive(Clone)]
pub(crate) struct SharedStream(Arc<Link>);

struct Link {
    stream: Mutex<TlsStream<TcpStream>>,
    is_rejected: AtomicBool,
}

impl SharedStream {
    /// Registers the stream of a new link, and rejects it if a check rejects its certificate.
    pub(crate) fn new(stream: TlsStream<TcpStream>) -> SharedStream {
        let link = Arc::new(Link { stream: Mutex::new(stream), is_rejected: AtomicBool::new(false) });
        // Registered before the check: a check with a changed list meanwhile covers this link as
        // well.
        let checks: Vec<_> = registry(|registry| {
            registry.links.retain(|link| link.strong_count() > 0);
            registry.links.push(Arc::downgrade(&link));
            registry.checks.values().cloned().collect()
        });
        for check in checks {
            link.check(&check);
        }
        SharedStream(link)
    }

    fn poll<T>(
        &self,
        poll: impl FnOnce(Pin<&mut TlsStream<TcpStream>>) -> Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let mut stream = lock(&self.0.stream);
        if self.0.is_rejected.load(Ordering::Acquire) {
            let error = "the certificate at the other end is rejected";
            return Poll::Ready(Err(io::Error::new(io::ErrorKind::ConnectionAborted, error)));
        }
        poll(Pin::new(&mut stream))
    }
}

impl AsyncRead for SharedStream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.poll(|stream| stream.poll_read(context, buffer))
    }
}

impl AsyncWrite for SharedStream {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &[u8]) -> Poll<io::Result<usize>> {
        self.poll(|stream| stream.poll_write(context, buffer))
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.poll(|stream| stream.poll_flush(context))
    }

    /// Shuts down the TCP stream, as the published crate does.
    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(lock(&self.0.stream).get_mut().0).poll_shutdown(context)
    }
}

/// Returns true if links to the principal of a certificate (DER) must be rejected.
type Check = Arc<dyn Fn(&[u8]) -> bool + Send + Sync>;

#[derive(Default)]
struct Registry {
    next: u64,
    checks: BTreeMap<u64, Check>,
    links: Vec<Weak<Link>>,
}

static REGISTRY: Mutex<Option<Registry>> = Mutex::new(None);

fn registry<T>(act: impl FnOnce(&mut Registry) -> T) -> T {
    act(lock(&REGISTRY).get_or_insert_default())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The registration of a check; dropping it removes the check.
pub struct LinkCheck(u64);

/// Registers a check of all links of this process, and applies it to the open links. The check
/// returns true for a certificate (DER) to be rejected.
pub fn check_links(is_rejected: impl Fn(&[u8]) -> bool + Send + Sync + 'static) -> LinkCheck {
    let check = registry(|registry| {
        registry.next += 1;
        registry.checks.insert(registry.next, Arc::new(is_rejected));
        LinkCheck(registry.next)
    });
    check.repeat();
    check
}

impl LinkCheck {
    /// Applies the check to all open links again, and ends the rejected links.
    pub fn repeat(&self) {
        let (check, links) = registry(|registry| {
            registry.links.retain(|link| link.strong_count() > 0);
            (registry.checks.get(&self.0).cloned(), registry.links.clone())
        });
        let Some(check) = check else { return };
        // The registry is not locked here: a check may take long, and links open and close
        // meanwhile.
        for link in links.iter().filter_map(Weak::upgrade) {
            link.check(&check);
        }
    }
}

impl Drop for LinkCheck {
    fn drop(&mut self) {
        registry(|registry| registry.checks.remove(&self.0));
    }
}

impl Link {
    /// Applies a check. The connection of a rejected link is shut down, which wakes its reader.
    fn check(&self, check: &Check) {
        let certificate = {
            let stream = lock(&self.stream);
            let chain = stream.get_ref().1.peer_certificates();
            chain.and_then(<[_]>::first).map(|certificate| certificate.to_vec())
        };
        // The stream is not locked during the check, which may take long.
        if certificate.is_some_and(|certificate| check(&certificate)) {
            self.is_rejected.store(true, Ordering::Release);
            let _ = socket2::SockRef::from(lock(&self.stream).get_ref().0).shutdown(Shutdown::Both);
        }
    }
}
