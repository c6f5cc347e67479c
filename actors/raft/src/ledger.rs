//! The mission ledger as the replicated state machine.

use crate::types::StateMachine;
use consort_protocol::ids::ClusterId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, CommandOutcome, Ledger};

impl StateMachine for Ledger {
    type Command = Command;
    type Outcome = CommandOutcome;

    fn apply(&mut self, at: Epoch, command: Command) -> CommandOutcome {
        Ledger::apply(self, at, command)
    }

    fn grants_epoch(command: &Command) -> bool {
        match command {
            Command::Award { .. }
            | Command::AwardPromised { .. }
            | Command::MovePromise(_)
            | Command::LeaseResource { .. } => true,
            Command::Submit(_)
            | Command::Defer { .. }
            | Command::Accept { .. }
            | Command::Progress { .. }
            | Command::Release { .. }
            | Command::Fail { .. }
            | Command::Cancel { .. }
            | Command::Resolve { .. }
            | Command::AskPerson { .. }
            | Command::SetQuestion { .. }
            | Command::Postpone { .. }
            | Command::AnswerPerson { .. }
            | Command::EscalatePersonRequest { .. }
            | Command::ExpirePersonRequest { .. }
            | Command::AddSchedule { .. }
            | Command::RemoveSchedule { .. }
            | Command::PauseSchedule { .. }
            | Command::ResumeSchedule { .. }
            | Command::SubmitOccurrence { .. }
            | Command::SkipOccurrences { .. }
            | Command::OrderRobots { .. }
            | Command::ExpireOrders { .. }
            | Command::EndOrders { .. }
            | Command::CancelMissions { .. }
            | Command::ChangeMission { .. }
            | Command::ChangeClosures { .. }
            | Command::ChangeSpeedLimits { .. }
            | Command::ChangeAlarms { .. }
            | Command::FreeResource { .. }
            | Command::RaiseWireVersion { .. }
            | Command::SetHistoryLimits(_)
            | Command::Bootstrap { .. } => false,
        }
    }

    fn cluster(&self) -> Option<ClusterId> {
        Ledger::cluster(self)
    }
}
