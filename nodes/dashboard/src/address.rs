//! Binds listening addresses before anything else is started. A command with an address that is not
//! available fails at once, and nothing has to be stopped again.

use axum::serve::Listener;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Maximum number of connections served at the same time at an address. Further connections wait
/// until another ends.
const CONNECTIONS: usize = 256;

/// An address cannot be bound.
#[derive(Debug, thiserror::Error)]
#[error("{flag} {at}: this address is not available: {problem}; port 0 selects a free port")]
pub struct AddressUnavailable {
    flag: &'static str,
    at: SocketAddr,
    problem: io::Error,
}

/// A bound address that is not served yet. Connections that arrive meanwhile wait.
pub struct BoundAddress {
    at: SocketAddr,
    listener: TcpListener,
}

impl BoundAddress {
    /// Binds an address; port 0 selects any free port. `flag` is the flag that requested it, for
    /// example `--dashboard`.
    ///
    /// # Errors
    /// [`AddressUnavailable`] if the address cannot be bound.
    pub async fn bind(flag: &'static str, at: SocketAddr) -> Result<BoundAddress, AddressUnavailable> {
        let refused = |problem| AddressUnavailable { flag, at, problem };
        let listener = TcpListener::bind(at).await.map_err(refused)?;
        Ok(BoundAddress { at: listener.local_addr().map_err(refused)?, listener })
    }

    /// Returns the bound address, including the port that the system selected.
    pub fn local_addr(&self) -> SocketAddr {
        self.at
    }

    /// Turns it into a listener that limits the number of connections.
    pub fn with_connection_limit(self) -> LimitedListener {
        LimitedListener { listener: self.listener, permits: Arc::new(Semaphore::new(CONNECTIONS)) }
    }
}

/// A listener that limits the number of connections.
pub struct LimitedListener {
    listener: TcpListener,
    permits: Arc<Semaphore>,
}

impl Listener for LimitedListener {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        let permit = Arc::clone(&self.permits).acquire_owned().await.ok();
        let (stream, from) = Listener::accept(&mut self.listener).await;
        (Connection { stream, _permit: permit }, from)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Listener::local_addr(&self.listener)
    }
}

/// A connection. It holds its permit until it ends.
pub struct Connection {
    stream: TcpStream,
    _permit: Option<OwnedSemaphorePermit>,
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, into)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(cx, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tokio::time::timeout;

    #[tokio::test]
    async fn a_connection_above_the_limit_waits_for_a_free_permit() {
        let bound = BoundAddress::bind("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
        let at = bound.local_addr();
        let mut guarded = LimitedListener { permits: Arc::new(Semaphore::new(1)), ..bound.with_connection_limit() };
        let _clients = [TcpStream::connect(at).await.unwrap(), TcpStream::connect(at).await.unwrap()];
        let (first, _) = guarded.accept().await;
        assert!(timeout(Duration::from_millis(50), guarded.accept()).await.is_err(), "there is a single permit");
        drop(first);
        timeout(Duration::from_secs(20), guarded.accept()).await.expect("it is free again");
    }
}
