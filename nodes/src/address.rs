//! An address that is taken before anything else is begun: whoever cannot have it hears so at once, and nothing has been
//! started in vain.

use axum::serve::Listener;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// How many connections are served at once at one address. Whoever comes then waits until one ends.
const CONNECTIONS: usize = 256;

/// An address of ours, at which nothing is served yet. Who connects meanwhile waits.
pub struct BoundAddress {
    at: SocketAddr,
    listener: TcpListener,
}

impl BoundAddress {
    /// Takes an address; port 0 is any free one. `flag` is what it was asked for with, as `--dashboard`.
    ///
    /// # Errors
    /// In words, with flag and address, if it cannot be had.
    pub async fn bind(flag: &str, at: SocketAddr) -> Result<BoundAddress, String> {
        let refused = |problem: io::Error| {
            format!("{flag} {at}: this address cannot be had: {problem}; with port 0 a free one is found")
        };
        let listener = TcpListener::bind(at).await.map_err(refused)?;
        Ok(BoundAddress { at: listener.local_addr().map_err(refused)?, listener })
    }

    /// Which it is, the port that was found among it.
    pub fn local_addr(&self) -> SocketAddr {
        self.at
    }

    /// To be served, to so many at once.
    pub(crate) fn with_connection_limit(self) -> LimitedListener {
        LimitedListener { listener: self.listener, places: Arc::new(Semaphore::new(CONNECTIONS)) }
    }
}

/// A listener with a limited number of places.
pub struct LimitedListener {
    listener: TcpListener,
    places: Arc<Semaphore>,
}

impl Listener for LimitedListener {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        let place = Arc::clone(&self.places).acquire_owned().await.ok();
        let (stream, from) = Listener::accept(&mut self.listener).await;
        (Connection { stream, _place: place }, from)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Listener::local_addr(&self.listener)
    }
}

/// A connection, which has its place until it ends.
pub struct Connection {
    stream: TcpStream,
    _place: Option<OwnedSemaphorePermit>,
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
    async fn whoever_finds_no_place_waits_for_one() {
        let taken = BoundAddress::bind("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.unwrap();
        let at = taken.local_addr();
        let mut guarded = LimitedListener { places: Arc::new(Semaphore::new(1)), ..taken.with_connection_limit() };
        let _clients = [TcpStream::connect(at).await.unwrap(), TcpStream::connect(at).await.unwrap()];
        let (first, _) = guarded.accept().await;
        assert!(timeout(Duration::from_millis(50), guarded.accept()).await.is_err(), "there is one place");
        drop(first);
        timeout(Duration::from_secs(20), guarded.accept()).await.expect("it is free again");
    }
}
