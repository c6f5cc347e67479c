//! Reports on robots, people, doors, samples and events, for displays and checks.

use super::components::{CoPresence, DrawerOpen, PersonInfo, SimRobot};
use super::event::LoggedEvent;
use super::names::{PersonName, SampleId};
use super::samples::{HolderEntity, SampleReport};
use super::setup::RobotSetup;
use super::simulation::World;
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::units::WorldTime;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// State of a world, as served on `view/world`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct WorldReport {
    /// World time, in seconds since the start of the world.
    pub time_s: WorldTime,
    /// Samples, in the order of their labels.
    pub samples: Vec<SampleReport>,
    /// People, in the order of their names.
    pub people: Vec<PersonReport>,
    /// Automatic doors, in the order of their names.
    pub doors: Vec<DoorReport>,
}

/// State of a robot that its telemetry does not contain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RobotReport {
    /// True if the drawer is open.
    pub drawer_open: bool,
    /// Samples in the drawer, in the order of arrival.
    pub in_drawer: Vec<SampleId>,
    /// Sample in the arm.
    pub in_arm: Option<SampleId>,
    /// The approached person.
    pub beside_person: Option<PersonName>,
    /// True if that person has authenticated.
    pub authenticated: bool,
    /// The robot that this robot has approached.
    pub beside_robot: Option<RobotId>,
}

/// Current state of a person.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PersonReport {
    /// Name.
    pub name: PersonName,
    /// Role in missions.
    pub role: RoleId,
    /// Usual place.
    pub place: PlaceId,
    /// True if the person has left the place.
    pub away: bool,
    /// Samples to hand over, in order.
    pub samples: Vec<SampleId>,
}

/// Current state of an automatic door.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DoorReport {
    /// Name on the map.
    pub name: String,
    /// `closed`, `opening`, `open` or `closing`.
    pub state: String,
}

impl World {
    /// Returns the state of samples, people and doors.
    pub(crate) fn world_report(&self) -> WorldReport {
        WorldReport {
            time_s: WorldTime::from_secs(self.state.now),
            samples: self.samples(),
            people: self.people(),
            doors: self.doors(),
        }
    }

    /// Returns the setup of a robot, with its current speed; `None` for an unknown robot.
    pub(crate) fn robot_setup(&self, robot: &RobotId) -> Option<RobotSetup> {
        self.state.robots.get(robot).map(|robot| self.state.get::<SimRobot>(*robot).0.clone())
    }

    /// Returns the drawer, arm and co-presence of a robot; `None` for an unknown robot.
    pub fn robot_report(&self, robot: &RobotId) -> Option<RobotReport> {
        let robot = *self.state.robots.get(robot)?;
        let (beside_person, authenticated, beside_robot) = match *self.state.get::<CoPresence>(robot) {
            CoPresence::None => (None, false, None),
            CoPresence::Person { person, .. } if !self.state.is_present(&self.state.get::<PersonInfo>(person).name) => {
                (None, false, None)
            }
            CoPresence::Person { person, authenticated } => {
                (Some(self.state.get::<PersonInfo>(person).name.clone()), authenticated, None)
            }
            CoPresence::Robot { robot: other, .. } => (None, false, Some(self.state.robot_id(other))),
        };
        Some(RobotReport {
            drawer_open: self.state.get::<DrawerOpen>(robot).0,
            in_drawer: self.state.held_labels(HolderEntity::Drawer(robot)),
            in_arm: self.state.held_labels(HolderEntity::Arm(robot)).into_iter().next(),
            beside_person,
            authenticated,
            beside_robot,
        })
    }

    /// All people, in the order of their names.
    pub fn people(&self) -> Vec<PersonReport> {
        let report = |person: &hecs::Entity| {
            let info = self.state.get::<PersonInfo>(*person);
            PersonReport {
                name: info.name.clone(),
                role: info.role.clone(),
                place: self.state.map.place_at(info.place).id.clone(),
                away: !self.state.is_present(&info.name),
                samples: self.state.held_labels(HolderEntity::Hands(*person)),
            }
        };
        self.state.people.values().map(report).collect()
    }

    /// All automatic doors, in the order of their names.
    pub(crate) fn doors(&self) -> Vec<DoorReport> {
        let states = self.state.door_states().into_iter();
        states.map(|(name, state)| DoorReport { name, state: state.to_owned() }).collect()
    }

    /// Returns the holder of every sample.
    pub fn samples(&self) -> Vec<SampleReport> {
        self.state.samples.iter().map(|(id, sample)| self.state.sample_report(id, *sample)).collect()
    }

    /// Returns the holder of a sample; `None` for an unknown sample.
    pub fn sample(&self, id: &SampleId) -> Option<SampleReport> {
        self.state.samples.get(id).map(|sample| self.state.sample_report(id, *sample))
    }

    /// Returns and removes the logged events, oldest first.
    pub fn drain_event_log(&mut self) -> Vec<LoggedEvent> {
        self.state.event_log.drain()
    }

    /// Returns the events after the first `number` events of this world that are still in the log,
    /// oldest first, and the number of events so far. The entries stay in the log.
    pub(crate) fn events_after(&self, number: u64) -> (impl Iterator<Item = &LoggedEvent>, u64) {
        self.state.event_log.after(number)
    }
}
