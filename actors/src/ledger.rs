//! The mission ledger as the state machine that is replicated.

use crate::replica::StateMachine;
use consort_protocol::ids::ClusterId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger, Outcome};

impl StateMachine for Ledger {
    type Command = Command;
    type Outcome = Outcome;

    fn apply(&mut self, at: Epoch, command: Command) -> Outcome {
        Ledger::apply(self, at, command)
    }

    fn grants_epoch(command: &Command) -> bool {
        match command {
            Command::Award { .. } => true,
            Command::Submit(_)
            | Command::Defer { .. }
            | Command::Accept { .. }
            | Command::Progress { .. }
            | Command::Release { .. }
            | Command::Fail { .. }
            | Command::Cancel { .. }
            | Command::Rescued { .. }
            | Command::Raise { .. }
            | Command::Found { .. } => false,
        }
    }

    fn cluster(&self) -> Option<ClusterId> {
        Ledger::cluster(self)
    }
}
