//! Requests of people that change missions.

use super::apply::Ledger;
use super::command::{Command, CommandOutcome};
use super::command_error::CommandError;
use super::mission_order::{MissionCancelation, MissionChange};
use super::robot_order::OrderRequest;
use crate::ids::MissionId;
use crate::lease::Epoch;

impl Ledger {
    /// Cancels missions. A mission that has ended meanwhile keeps its state.
    pub(super) fn cancel_missions(
        &mut self,
        order: OrderRequest<MissionCancelation>,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let OrderRequest { change: MissionCancelation { missions }, by, at_ms, request } = order;
        self.execute_once(request.as_ref(), |ledger| {
            for (mission, places) in missions {
                ledger.apply(at, Command::Cancel { mission, by: by.clone(), places, at_ms });
            }
            Ok(CommandOutcome::Done)
        })
    }

    /// Changes an active mission. Its promised roles follow a new priority, too: the order of the promises of a robot
    /// depends on it.
    pub(super) fn change_mission(
        &mut self,
        mission: &MissionId,
        order: &OrderRequest<MissionChange>,
    ) -> Result<CommandOutcome, CommandError> {
        self.execute_once(order.request.as_ref(), |ledger| {
            match &order.change {
                MissionChange::SetPriority(priority) => {
                    ledger.active_mission(mission)?.submission.priority = *priority;
                }
                MissionChange::Reassign { role, to, repeat } => {
                    ledger.reassign(mission, role, to.as_ref(), (*repeat, &order.by))?;
                }
                MissionChange::Pin { role, robot } => ledger.pin(mission, role, robot.as_ref(), &order.by)?,
            }
            Ok(CommandOutcome::Done)
        })
    }
}

#[cfg(test)]
mod tests;
