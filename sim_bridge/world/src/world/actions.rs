//! Parameters of the actions with which robots meet people and other robots, and handle items.

use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::ActionParameters;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Approach a person with this role at the robot's place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachPerson {
    /// The person's role in the mission.
    pub role: RoleId,
}

/// Authenticate the approached person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuthenticatePerson {
    /// The person's role in the mission.
    pub role: RoleId,
}

/// Open or close the robot's own drawer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperateDrawer {
    /// Requested state: `open` or `close`.
    #[serde(rename = "action", serialize_with = "write_open", deserialize_with = "read_open")]
    pub open: bool,
}

/// Approach another robot at the same place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachRobot {
    /// The other robot.
    pub robot: RobotId,
}

/// Take an object from another robot's open drawer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PickUp {
    /// Robot with the drawer.
    pub from: RobotId,
}

/// Take an object from the table of the robot's place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grasp {
    /// Name of the object.
    pub object: String,
}

/// Put the held object into another robot's open drawer or, without a robot, on the table of
/// the place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deposit {
    /// Robot with the drawer.
    #[serde(default)]
    pub into: Option<RobotId>,
}

impl ActionParameters for ApproachPerson {
    const ACTION: &'static str = "approach_person";
    const REPEATABLE: bool = true;
}

impl ActionParameters for AuthenticatePerson {
    const ACTION: &'static str = "authenticate_person";
    const REPEATABLE: bool = true;
}

impl ActionParameters for OperateDrawer {
    const ACTION: &'static str = "operate_drawer";
    const REPEATABLE: bool = true;
}

impl ActionParameters for ApproachRobot {
    const ACTION: &'static str = "approach_robot";
    const REPEATABLE: bool = true;
}

impl ActionParameters for PickUp {
    const ACTION: &'static str = "pick_up";
    const REPEATABLE: bool = false;
}

impl ActionParameters for Grasp {
    const ACTION: &'static str = "grasp";
    const REPEATABLE: bool = false;
}

impl ActionParameters for Deposit {
    const ACTION: &'static str = "deposit";
    const REPEATABLE: bool = false;
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum DrawerAction {
    Open,
    Close,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn write_open<S: Serializer>(open: &bool, serializer: S) -> Result<S::Ok, S::Error> {
    let action = if *open { DrawerAction::Open } else { DrawerAction::Close };
    action.serialize(serializer)
}

fn read_open<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    Ok(matches!(DrawerAction::deserialize(deserializer)?, DrawerAction::Open))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_skills::actions::{Dock, FollowWaypoints, Goal, NavigateToPose, Spin, Undock, Wait};
    use consort_skills::domain::standard_domain;

    fn is_declared<P: ActionParameters>() {
        let declared = standard_domain().action_forms().find(|(name, _)| name.as_str() == P::ACTION);
        let (name, form) = declared.unwrap_or_else(|| panic!("{} is not declared", P::ACTION));
        assert_eq!(form.repeatable, P::REPEATABLE, "{name}");
    }

    #[test]
    fn the_standard_domain_declares_the_actions_that_the_world_simulates() {
        is_declared::<ApproachPerson>();
        is_declared::<AuthenticatePerson>();
        is_declared::<OperateDrawer>();
        is_declared::<ApproachRobot>();
        is_declared::<PickUp>();
        is_declared::<Grasp>();
        is_declared::<Deposit>();
        is_declared::<NavigateToPose>();
        is_declared::<FollowWaypoints>();
        is_declared::<Spin>();
        is_declared::<Wait>();
        is_declared::<Dock>();
        is_declared::<Undock>();
    }

    #[test]
    fn a_drawer_is_opened_or_closed() {
        for open in [false, true] {
            let goal = Goal::from(OperateDrawer { open });
            assert_eq!(goal.parameters["action"], if open { "open" } else { "close" });
            assert_eq!(goal.read(), Some(Ok(OperateDrawer { open })));
        }
    }
}
