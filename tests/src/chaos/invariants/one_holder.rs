//! A role has at most a single active holder, a robot acts in at most a single role, and the awards
//! of a role have increasing epochs.
//!
//! A robot is active from the start or resumption of a role until it suspends the role, gives it up, halts
//! it, is killed, or ends because it cannot write to its disk. Each robot records these events locally.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::lease::Epoch;
use std::collections::BTreeMap;
use std::time::Duration;

type Part = (MissionId, RoleId);

#[derive(Default)]
pub(super) struct OneHolder {
    active: BTreeMap<Part, NodeId>,
    latest: BTreeMap<Part, Epoch>,
}

impl OneHolder {
    fn begins(&mut self, node: &NodeId, mission: &MissionId, role: &RoleId) -> Result<(), InvariantViolation> {
        let part = (mission.clone(), role.clone());
        if let Some(other) = self.active.get(&part).filter(|other| *other != node) {
            return Err(format!("{node} acts as {role} of {mission} while {other} still does").into());
        }
        let elsewhere = self.active.iter().find(|(other, who)| *who == node && **other != part);
        if let Some(((other, as_role), _)) = elsewhere {
            return Err(format!("{node} acts as {role} of {mission} while it acts as {as_role} of {other}").into());
        }
        self.active.insert(part, node.clone());
        Ok(())
    }
}

impl Invariant for OneHolder {
    fn name(&self) -> &'static str {
        "one_holder"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        let node = entry.node();
        if let Observation::TestAction { action: "killed" | "ended", .. } = entry {
            self.active.retain(|_, who| who != node);
        }
        match entry.event_kind() {
            Some(EventKind::Started { mission, role, epoch }) => {
                let part = (mission.clone(), role.clone());
                if let Some(latest) = self.latest.insert(part, *epoch)
                    && latest > *epoch
                {
                    return Err(format!(
                        "{node} begins {role} of {mission} under epoch {epoch}, after {latest} was begun"
                    )
                    .into());
                }
                self.begins(node, mission, role)
            }
            Some(EventKind::Resumed { mission, role }) => self.begins(node, mission, role),
            Some(
                EventKind::Suspended { mission, role, .. }
                | EventKind::GaveUp { mission, role, .. }
                | EventKind::TaskFailed { mission, role, .. }
                | EventKind::Halted { mission, role, .. },
            ) => {
                let part = (mission.clone(), role.clone());
                if self.active.get(&part) == Some(node) {
                    self.active.remove(&part);
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    #[test]
    fn a_second_holder_and_a_second_role_of_a_robot_are_found() {
        let (garnet, hazel): (NodeId, NodeId) = (slug("garnet"), slug("hazel"));
        let missions: [MissionId; 2] = ["rest-1", "rest-2"].map(slug);
        let role: RoleId = slug("r1");
        let mut state = OneHolder::default();
        assert_eq!(state.begins(&garnet, &missions[0], &role), Ok(()));
        assert_eq!(state.begins(&garnet, &missions[0], &role), Ok(()), "it resumes the role");
        let violation = state.begins(&hazel, &missions[0], &role).unwrap_err().0;
        assert_eq!(violation, "hazel acts as r1 of rest-1 while garnet still does");
        let violation = state.begins(&garnet, &missions[1], &role).unwrap_err().0;
        assert_eq!(violation, "garnet acts as r1 of rest-2 while it acts as r1 of rest-1");
        assert_eq!(state.begins(&hazel, &missions[1], &role), Ok(()));
    }
}
