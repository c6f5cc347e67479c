//! Setup of robots before a fleet starts.

use crate::slug;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{Attributes, Availability, RobotKnowledge};
use consort_protocol::pose::Pose;
use consort_protocol::scalar::Scalar;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_skills::library::SkillLibrary;
use consort_world::map::Map;
use consort_world::world::RobotSetup;
use std::collections::BTreeMap;

/// Version of the estimators of all robots.
pub(crate) const ESTIMATOR_VERSION: &str = "1";

/// Setup of a robot.
#[derive(Debug, Clone)]
pub struct RobotSpec {
    /// Its name.
    pub name: String,
    /// Its start place.
    pub place: String,
    /// Metres per second; `None` for an arm.
    pub speed: Option<f64>,
    /// Charge at the start, as a share.
    pub battery: f64,
    /// Published discharge rate at work, as a share of a full charge per second.
    pub discharge: f64,
    /// Its skills.
    pub skills: Vec<String>,
    /// Its attributes.
    pub attributes: Attributes,
    /// Changes its skill library before it starts.
    pub customize_library: Option<fn(&mut SkillLibrary)>,
    /// The test starts the node of the robot later.
    pub starts_later: bool,
    /// Actual discharge rate divided by the published rate.
    pub discharge_factor: f64,
    /// Seconds that the clock of its node counts per second.
    pub clock_rate: f64,
}

impl RobotSpec {
    /// Returns a robot with a drawer, as lab samples need it.
    pub fn carrier(name: &str, place: &str) -> RobotSpec {
        let skills = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];
        RobotSpec {
            name: name.to_owned(),
            place: place.to_owned(),
            speed: Some(0.6),
            battery: 0.9,
            discharge: 0.0004,
            skills: skills.map(str::to_owned).to_vec(),
            attributes: Attributes::default(),
            customize_library: None,
            starts_later: false,
            discharge_factor: 1.0,
            clock_rate: 1.0,
        }
    }

    /// Returns an arm that takes samples out of drawers.
    pub fn arm(name: &str, place: &str) -> RobotSpec {
        let carrier = RobotSpec::carrier(name, place);
        RobotSpec { speed: None, battery: 1.0, discharge: 0.0, skills: vec!["pick_up".to_owned()], ..carrier }
    }

    /// Sets the speed in metres per second.
    pub fn with_speed(self, speed: f64) -> RobotSpec {
        RobotSpec { speed: Some(speed), ..self }
    }

    /// Sets the charge at the start.
    pub fn with_charge(self, battery: f64) -> RobotSpec {
        RobotSpec { battery, ..self }
    }

    /// Replaces the skills.
    pub fn with_skills(self, skills: &[&str]) -> RobotSpec {
        RobotSpec { skills: skills.iter().map(|skill| (*skill).to_owned()).collect(), ..self }
    }

    /// Adds a skill.
    pub fn with_skill(mut self, skill: &str) -> RobotSpec {
        self.skills.push(skill.to_owned());
        self
    }

    /// Adds an attribute.
    pub fn with_attribute(self, name: &str, value: &str) -> RobotSpec {
        let given = self.attributes.iter().map(|(name, value)| (name.clone(), value.clone()));
        let all: BTreeMap<_, _> = given.chain([(name.to_owned(), Scalar::Text(value.to_owned()))]).collect();
        RobotSpec { attributes: Attributes::try_from(all).expect("a valid attribute"), ..self }
    }

    /// Sets a function that changes the skill library.
    pub fn with_library(self, train: fn(&mut SkillLibrary)) -> RobotSpec {
        RobotSpec { customize_library: Some(train), ..self }
    }

    /// Makes the test start the node of the robot later.
    pub fn starting_later(self) -> RobotSpec {
        RobotSpec { starts_later: true, ..self }
    }

    /// Sets how many times as fast as published the battery empties.
    pub fn with_discharge_factor(self, thirst: f64) -> RobotSpec {
        RobotSpec { discharge_factor: thirst, ..self }
    }

    /// Sets how many seconds the clock of the node counts per second.
    pub fn with_clock(self, clock_rate: f64) -> RobotSpec {
        RobotSpec { clock_rate, ..self }
    }

    pub(crate) fn robot_body(&self) -> RobotSetup {
        let (id, place) = (slug(&self.name), slug(&self.place));
        match self.speed {
            Some(speed) => {
                let speed = MetresPerSecond::new(speed).expect("a speed");
                let battery = BatteryShare::new(self.battery).expect("a share");
                let discharge = SharePerSecond::new(self.discharge().get() * self.discharge_factor).expect("a rate");
                RobotSetup::carrier(id, place, speed, battery, discharge)
            }
            None => RobotSetup::arm(id, place),
        }
    }

    fn discharge(&self) -> SharePerSecond {
        SharePerSecond::new(self.discharge).expect("a rate")
    }

    pub(crate) fn worker(&self, map: &Map) -> RobotKnowledge {
        let place: PlaceId = slug(&self.place);
        RobotKnowledge {
            skills: self.skills.iter().map(|skill| slug(skill)).collect(),
            attributes: self.attributes.clone(),
            pose: map.place(&place).map_or(Pose::default(), |place| place.pose),
            place,
            battery: BatteryShare::new(self.battery).expect("a share"),
            discharge: self.discharge(),
            useful_charge: BatteryShare::new(0.08).expect("a share"),
            speed: self.speed.map(|speed| MetresPerSecond::new(speed).expect("a speed")),
            availability: Availability::Free,
            estimator: ESTIMATOR_VERSION.to_owned(),
            charging: None,
        }
    }
}
