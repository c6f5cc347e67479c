//! Signals sent under an award that the coordinator has not confirmed yet.

use consort_bus::Author;
use consort_protocol::lease::Epoch;
use consort_protocol::plan::Signal;
use std::collections::VecDeque;

/// Maximum number of parked signals. Beyond it the oldest is dropped: the history of its role is
/// queried after the confirmation.
const PARKED_MAX: usize = 32;

/// A signal, its sender's epoch, and its author.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ParkedSignal {
    pub(super) signal: Signal,
    pub(super) epoch: Epoch,
    pub(super) author: Author,
}

/// Parked signals, in the order of their arrival.
#[derive(Debug, Clone, Default)]
pub(super) struct ParkedSignals(VecDeque<ParkedSignal>);

impl ParkedSignals {
    /// Parks a signal. Returns whether no other signal was parked before.
    pub(super) fn park(&mut self, parked: ParkedSignal) -> bool {
        let first = self.0.is_empty();
        if !self.0.contains(&parked) {
            self.0.push_back(parked);
            if self.0.len() > PARKED_MAX {
                self.0.pop_front();
            }
        }
        first
    }

    /// Removes all signals.
    pub(super) fn take(&mut self) -> impl Iterator<Item = ParkedSignal> + use<> {
        std::mem::take(&mut self.0).into_iter()
    }
}
