//! The ledger stays within its limits, whatever other nodes send.
//!
//! A command contains no longer texts than allowed, a mission is no larger than allowed, and the
//! ledger keeps no more ended missions whole than the fleet's settings say. So a snapshot always fits
//! into a record.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::ledger::{Command, MissionEntry};
use std::time::Duration;

pub(super) struct Bounded {
    ended_missions_max: usize,
    /// A coordinator has stated the limits of the history. Before, the ledger has the default limits.
    has_limits: bool,
    reference: ReferenceLedger,
}

impl Bounded {
    pub(super) fn new(ended_missions_max: usize) -> Bounded {
        Bounded { ended_missions_max, has_limits: false, reference: ReferenceLedger::default() }
    }

    fn check(&self, command: &Command) -> Result<(), InvariantViolation> {
        if command.clone().limited() != *command {
            return Err(format!("the log contains a command with too long a text: {command:?}").into());
        }
        let mission = command.mission().and_then(|mission| self.reference.ledger.mission(mission));
        let Some(entry) = mission else { return Ok(()) };
        let (bytes, bytes_max) = (entry.encoded_bytes(), MissionEntry::BYTES_MAX);
        if bytes > bytes_max {
            return Err(format!("{} has {bytes} bytes in the ledger; at most {bytes_max} are allowed", entry.id).into());
        }
        let is_kept = |entry: &&MissionEntry| entry.state.has_ended();
        let (kept, kept_max) = (self.reference.ledger.missions().filter(is_kept).count(), self.ended_missions_max);
        if self.has_limits && entry.state.has_ended() && kept > kept_max {
            return Err(format!("the ledger keeps {kept} ended missions; at most {kept_max} are allowed").into());
        }
        Ok(())
    }
}

impl Invariant for Bounded {
    fn name(&self) -> &'static str {
        "bounded"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        if let Observation::EntryApplied { at, commands, .. } = entry
            && self.reference.is_new(*at)
        {
            self.has_limits |= commands.iter().any(|command| matches!(command, Command::SetHistoryLimits(_)));
            self.reference.apply(*at, commands);
            commands.iter().try_for_each(|command| self.check(command))?;
        }
        Ok(())
    }
}
