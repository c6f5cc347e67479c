//! An address that is taken before anything else is begun: whoever cannot have it hears so at once, and nothing has been
//! started in vain.

use std::net::SocketAddr;
use tokio::net::TcpListener;

/// An address of ours, at which nothing is served yet. Who connects meanwhile waits.
pub struct Taken {
    at: SocketAddr,
    pub(crate) listener: TcpListener,
}

impl Taken {
    /// Takes an address; port 0 is any free one. `flag` is what it was asked for with, as `--dashboard`.
    ///
    /// # Errors
    /// In words, with flag and address, if it cannot be had.
    pub async fn take(flag: &str, at: SocketAddr) -> Result<Taken, String> {
        let refused = |problem: std::io::Error| {
            format!("{flag} {at}: this address cannot be had: {problem}; with port 0 a free one is found")
        };
        let listener = TcpListener::bind(at).await.map_err(refused)?;
        Ok(Taken { at: listener.local_addr().map_err(refused)?, listener })
    }

    /// Which it is, the port that was found among it.
    pub fn at(&self) -> SocketAddr {
        self.at
    }
}
