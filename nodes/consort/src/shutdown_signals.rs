//! Signals that end a program: Ctrl-C, or SIGTERM from a service manager.

use crate::exit::Failure;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Ctrl-C and SIGTERM. Signals are kept from the creation of this value on: an early signal is not
/// lost.
pub(crate) struct ShutdownSignals {
    interrupt: Signal,
    terminate: Signal,
}

impl ShutdownSignals {
    /// Starts receiving signals. Called within a tokio runtime.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the system does not support it.
    pub(crate) fn open() -> Result<ShutdownSignals, Failure> {
        let receive = |kind| {
            let no_signal = |problem| Failure::Unsuccessful(format!("signals cannot be received: {problem}"));
            signal(kind).map_err(no_signal)
        };
        Ok(ShutdownSignals {
            interrupt: receive(SignalKind::interrupt())?,
            terminate: receive(SignalKind::terminate())?,
        })
    }

    /// Waits for a signal, and returns its name. Cancelling the wait loses no signal.
    pub(crate) async fn wait(&mut self) -> &'static str {
        tokio::select! {
            _ = self.interrupt.recv() => "Ctrl-C",
            _ = self.terminate.recv() => "SIGTERM",
        }
    }
}
