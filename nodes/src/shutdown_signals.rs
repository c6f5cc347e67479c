//! What tells a program to end: Ctrl-C, or SIGTERM from a service manager.

use crate::exit::Failure;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Ctrl-C and SIGTERM. They are kept from the first moment on: one that comes while nobody waits for it is not lost.
pub(crate) struct ShutdownSignals {
    interrupt: Signal,
    terminate: Signal,
}

impl ShutdownSignals {
    /// From now on they are heard. Called within a tokio runtime.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the system does not have it.
    pub(crate) fn open() -> Result<ShutdownSignals, Failure> {
        let hear = |kind| {
            let no_signal = |problem| Failure::Unsuccessful(format!("signals cannot be heard: {problem}"));
            signal(kind).map_err(no_signal)
        };
        Ok(ShutdownSignals { interrupt: hear(SignalKind::interrupt())?, terminate: hear(SignalKind::terminate())? })
    }

    /// Waits for one of them, and says which it was. One that was not waited for to the end is not lost either.
    pub(crate) async fn wait(&mut self) -> &'static str {
        tokio::select! {
            _ = self.interrupt.recv() => "Ctrl-C",
            _ = self.terminate.recv() => "SIGTERM",
        }
    }
}
