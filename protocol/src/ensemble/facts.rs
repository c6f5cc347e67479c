//! Variables of conditions: fields of nodes and robots.

use crate::ids::{NodeId, PlaceId, TaskType};
use crate::knowledge::{Attributes, Availability, Knowledge, RobotKnowledge};
use crate::pose::Pose;
use crate::units::{BatteryShare, SharePerSecond};
use cel::{SerializationError, Value};
use serde::Serialize;
use std::collections::BTreeSet;
use std::sync::LazyLock;

/// Fields of a robot that change while it works.
pub(super) const CHANGING_FIELDS: &[&str] = &["place", "x_m", "y_m", "battery"];

#[derive(Serialize)]
struct RobotFacts<'a> {
    name: &'a str,
    attributes: &'a Attributes,
    skills: Vec<&'a str>,
    place: &'a str,
    x_m: f64,
    y_m: f64,
    battery: f64,
    discharge: f64,
    speed: f64,
}

#[derive(Serialize)]
struct NodeFacts<'a> {
    #[serde(flatten)]
    own: RobotFacts<'a>,
    may_vote: bool,
    stationary: bool,
    mains_powered: bool,
    robot: bool,
    free: bool,
    estimator: &'a str,
}

impl<'a> RobotFacts<'a> {
    fn of(name: &'a str, robot: &'a RobotKnowledge) -> RobotFacts<'a> {
        RobotFacts {
            name,
            attributes: &robot.attributes,
            skills: robot.skills.iter().map(TaskType::as_str).collect(),
            place: robot.place.as_str(),
            x_m: robot.pose.x,
            y_m: robot.pose.y,
            battery: robot.battery.get(),
            discharge: robot.discharge.get(),
            speed: robot.speed.map_or(0.0, |speed| speed.get()),
        }
    }

    /// Returns the fields of a node without a robot.
    fn none(name: &'a str) -> RobotFacts<'a> {
        static NO_ATTRIBUTES: LazyLock<Attributes> = LazyLock::new(Attributes::default);
        RobotFacts {
            name,
            attributes: &NO_ATTRIBUTES,
            skills: vec![],
            place: "",
            x_m: 0.0,
            y_m: 0.0,
            battery: 0.0,
            discharge: 0.0,
            speed: 0.0,
        }
    }
}

/// Returns the fields of a robot as a value of expressions.
pub(super) fn robot_facts(name: &str, robot: &RobotKnowledge) -> Result<Value, SerializationError> {
    cel::to_value(RobotFacts::of(name, robot))
}

/// Returns the fields of a node as a value of expressions.
pub(super) fn node_facts(name: &NodeId, knowledge: &Knowledge) -> Result<Value, SerializationError> {
    let (robot, name) = (knowledge.robot.as_ref(), name.as_str());
    cel::to_value(NodeFacts {
        own: robot.map_or_else(|| RobotFacts::none(name), |robot| RobotFacts::of(name, robot)),
        may_vote: knowledge.may_vote,
        stationary: knowledge.stationary,
        mains_powered: knowledge.mains_powered,
        robot: robot.is_some(),
        free: knowledge.is_free(),
        estimator: robot.map_or("", |robot| &robot.estimator),
    })
}

/// Returns the knowledge of an example robot, for the check of conditions.
pub(crate) fn example_robot() -> RobotKnowledge {
    RobotKnowledge {
        skills: BTreeSet::from([TaskType::new("navigation").expect("a slug")]),
        attributes: Attributes::default(),
        place: PlaceId::new("dock").expect("a label"),
        pose: Pose::default(),
        battery: BatteryShare::FULL,
        discharge: SharePerSecond::new(0.0).expect("a rate"),
        useful_charge: BatteryShare::new(0.0).expect("a share"),
        speed: None,
        availability: Availability::Free,
        estimator: String::new(),
        charging: None,
    }
}

/// Returns the knowledge of the node of [`example_robot`].
pub(super) fn example_knowledge() -> Knowledge {
    Knowledge::of(Some(example_robot()))
}
