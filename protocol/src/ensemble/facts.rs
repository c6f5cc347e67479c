//! Variables of the conditions of ensembles.

use crate::ids::{NodeId, PlaceId, TaskType};
use crate::knowledge::{Availability, Knowledge, RobotKnowledge};
use crate::pose::Pose;
use crate::units::{BatteryShare, SharePerSecond};
use crate::versions::VersionRange;
use serde::Serialize;
use std::collections::BTreeSet;

/// Fields of a node that conditions can use.
#[derive(Serialize)]
pub(super) struct Facts<'a> {
    name: &'a str,
    may_vote: bool,
    stationary: bool,
    mains_powered: bool,
    robot: bool,
    skills: Vec<&'a str>,
    place: &'a str,
    x_m: f64,
    y_m: f64,
    battery: f64,
    discharge: f64,
    speed: f64,
    free: bool,
    estimator: &'a str,
}

impl<'a> Facts<'a> {
    pub(super) fn of(name: &'a NodeId, knowledge: &'a Knowledge) -> Facts<'a> {
        let worker = knowledge.robot.as_ref();
        Facts {
            name: name.as_str(),
            may_vote: knowledge.may_vote,
            stationary: knowledge.stationary,
            mains_powered: knowledge.mains_powered,
            robot: worker.is_some(),
            skills: worker.map(|w| w.skills.iter().map(TaskType::as_str).collect()).unwrap_or_default(),
            place: worker.map_or("", |w| w.place.as_str()),
            x_m: worker.map_or(0.0, |w| w.pose.x),
            y_m: worker.map_or(0.0, |w| w.pose.y),
            battery: worker.map_or(0.0, |w| w.battery.get()),
            discharge: worker.map_or(0.0, |w| w.discharge.get()),
            speed: worker.and_then(|w| w.speed).map_or(0.0, |speed| speed.get()),
            free: knowledge.is_free(),
            estimator: worker.map_or("", |w| &w.estimator),
        }
    }
}

/// Returns the knowledge of an example robot, for the check of conditions.
pub(super) fn example_knowledge() -> Knowledge {
    Knowledge {
        may_vote: true,
        stationary: false,
        mains_powered: false,
        replica: None,
        cluster: None,
        leaving: false,
        supported_versions: VersionRange::OWN,
        robot: Some(RobotKnowledge {
            skills: BTreeSet::from([TaskType::new("navigation").expect("a slug")]),
            place: PlaceId::new("dock").expect("a label"),
            pose: Pose::default(),
            battery: BatteryShare::FULL,
            discharge: SharePerSecond::new(0.0).expect("a rate"),
            useful_charge: BatteryShare::new(0.0).expect("a share"),
            speed: None,
            availability: Availability::Free,
            estimator: String::new(),
        }),
    }
}
