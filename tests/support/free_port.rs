//! Free ports of the loopback. Each test crate includes this file with `#[path]`.

use std::net::{Ipv4Addr, TcpListener};
use std::sync::atomic::{AtomicU32, Ordering};

/// First port. Linux chooses the ports of `:0` from 32768 on, so no other test gets these.
const FIRST: u32 = 20_000;

/// Number of ports.
const COUNT: u32 = 12_000;

/// Returns a port that is free, and that no other call of this process returns.
pub(crate) fn free_port() -> u16 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    loop {
        // Test processes that run at the same time begin at different ports.
        let begin = std::process::id().wrapping_mul(101);
        let port = FIRST + begin.wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed)) % COUNT;
        let port = u16::try_from(port).expect("below 32768");
        if TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok() {
            return port;
        }
    }
}
