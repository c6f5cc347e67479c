//! Requests of people that reassign and pin roles.

use super::api::{ApiError, ApiHandler};
use consort_protocol::api::{ReassignReply, ReassignRequest, RobotSelection, parse_request};
use consort_protocol::ensemble::{Eligibility, Ineligibility};
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId, TaskType};
use consort_protocol::keys::ApiCall;
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::ledger::{MissionChange, MissionEntry};
use std::collections::BTreeSet;

impl ApiHandler {
    /// Gives a role to another robot, or restricts it to a robot.
    pub(super) async fn reassign(&self, payload: &[u8]) -> Result<ReassignReply, ApiError> {
        let ReassignRequest { mission, role, to, pin, unpin, repeat, by, request } =
            parse_request(ApiCall::Reassign, payload)?;
        let is_pin = pin.is_some();
        if [to.is_some(), is_pin, unpin].into_iter().filter(|given| *given).count() > 1 {
            return Err("give only one of `to`, `pin` and `unpin`".to_owned().into());
        }
        if repeat && (is_pin || unpin) {
            return Err("`repeat` belongs neither to `pin` nor to `unpin`".to_owned().into());
        }
        if let Some(robot) = to.as_ref().or(pin.as_ref()) {
            self.check_robot(&mission, &role, robot, is_pin)?;
        }
        let change = match is_pin || unpin {
            true => MissionChange::Pin { role: role.clone(), robot: pin },
            false => MissionChange::Reassign { role: role.clone(), to, repeat },
        };
        self.change_mission(&mission, change, by, request).await?;
        Ok(self.replica.read(|ledger| {
            let entry = ledger.mission(&mission);
            let found = entry.and_then(|entry| entry.roles.get(&role));
            let order = entry.and_then(|entry| entry.role_orders().get(&role));
            ReassignReply {
                phase: found.map(|role| role.phase),
                robot: found.and_then(|role| role.holder.as_ref()).map(|holder| holder.robot.clone()),
                order: order.map(ToString::to_string),
                mission: mission.clone(),
                role: role.clone(),
            }
        }))
    }

    /// Checks whether a robot can do a role, as far as its record shows. A pinned robot may meet a condition later.
    fn check_robot(&self, mission: &MissionId, role: &RoleId, robot: &RobotId, is_pin: bool) -> Result<(), ApiError> {
        self.selected(&RobotSelection::Named(BTreeSet::from([robot.clone()])))?;
        let node = NodeId::from(robot.clone());
        let known = self.knowledge.read(|base| base.get(&node)?.knowledge().robot.clone());
        let known = known.ok_or_else(|| format!("the coordinator has no record of {robot}; it must be switched on"))?;
        // The ledger rejects an unknown mission.
        let check = |entry: &MissionEntry| check_able(entry, role, (robot, &known), is_pin);
        Ok(self.replica.read(|ledger| ledger.mission(mission).map_or(Ok(()), check))?)
    }
}

/// Checks the skills of a robot, and the condition of a role on its robot. The ledger rejects an unknown role.
fn check_able(
    entry: &MissionEntry,
    role: &RoleId,
    (robot, known): (&RobotId, &RobotKnowledge),
    is_pin: bool,
) -> Result<(), String> {
    let needed = entry.plan(role).into_iter().flat_map(|plan| plan.tasks().map(|(_, spec)| &spec.task_type));
    let missing: BTreeSet<&str> = needed.filter(|skill| !known.skills.contains(*skill)).map(TaskType::as_str).collect();
    if !missing.is_empty() {
        let missing = missing.into_iter().collect::<Vec<_>>().join(", ");
        return Err(format!("{robot} is not eligible for {role}: it lacks {missing}"));
    }
    let condition = entry.mission().roles.get(role).and_then(|declared| declared.eligible.as_deref());
    match condition.map(|condition| Eligibility::check_text(condition, robot, known)) {
        Some(Err(Ineligibility { why, permanent })) if permanent || !is_pin => {
            Err(format!("{robot} is not eligible for {role}: {why}"))
        }
        Some(_) | None => Ok(()),
    }
}
