//! Order of the states of a driver server, also across its restarts.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Number of former starts of a server whose late states are recognised.
const FORMER_BOOTS_KEPT: usize = 8;

/// Position of a state among the states of a driver server.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateStamp {
    /// Random number of the server's start.
    pub boot: u64,
    /// Grows with each state since the start.
    pub sequence: u64,
}

/// Newest state that a client has received. It does not depend on clocks: the clock of a restarted
/// server may have gone back.
#[derive(Debug, Default)]
pub struct StateOrder {
    newest: Option<StateStamp>,
    former_boots: VecDeque<u64>,
}

impl StateOrder {
    /// Returns the newest stamp; the default before the first.
    pub fn newest(&self) -> StateStamp {
        self.newest.unwrap_or_default()
    }

    /// Records a received state. Returns false for one that arrives late: a newer state was received,
    /// or a state of a later start of the server.
    pub fn accept(&mut self, stamp: StateStamp) -> bool {
        match self.newest {
            Some(newest) if newest.boot == stamp.boot && stamp.sequence <= newest.sequence => return false,
            Some(newest) if newest.boot == stamp.boot => {}
            _ if self.former_boots.contains(&stamp.boot) => return false,
            Some(newest) => {
                self.former_boots.push_back(newest.boot);
                if self.former_boots.len() > FORMER_BOOTS_KEPT {
                    self.former_boots.pop_front();
                }
            }
            None => {}
        }
        self.newest = Some(stamp);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restarted_server_is_followed_and_late_states_are_ignored() {
        let mut order = StateOrder::default();
        let mut accepts = |boot, sequence| order.accept(StateStamp { boot, sequence });
        assert!(accepts(9, 5) && accepts(9, 6) && !accepts(9, 6) && !accepts(9, 5));
        assert!(accepts(3, 1), "restarted: its numbers start again");
        assert!(!accepts(9, 7), "of the former start");
        assert!(accepts(3, 2) && accepts(8, 1) && !accepts(3, 3) && !accepts(9, 8));
        assert_eq!(order.newest(), StateStamp { boot: 8, sequence: 1 });
    }
}
