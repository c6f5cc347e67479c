//! Robots of a fleet, before it starts.

use crate::slug;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{Availability, Worker};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_sim::map::Map;
use consort_sim::world::RobotBody;
use consort_skills::library::SkillLibrary;

/// A robot of the fleet, before the fleet starts.
#[derive(Debug, Clone)]
pub struct Member {
    /// Its name.
    pub name: String,
    /// Where it starts.
    pub place: String,
    /// Metres per second; `None` for an arm.
    pub speed: Option<f64>,
    /// Charge at the start, as a share.
    pub battery: f64,
    /// Share of a full charge that it loses in a second at work, as it admits.
    pub discharge: f64,
    /// Its skills.
    pub skills: Vec<String>,
    /// Changes its skill library before it starts.
    pub trained: Option<fn(&mut SkillLibrary)>,
    /// Whether its node is started only when the test says so.
    pub late: bool,
    /// How many times as fast as it admits its battery empties.
    pub thirst: f64,
    /// Seconds that its node's clock counts in one.
    pub clock_rate: f64,
}

impl Member {
    /// A robot with a drawer, as lab samples need one.
    pub fn carrier(name: &str, place: &str) -> Member {
        let skills = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];
        Member {
            name: name.to_owned(),
            place: place.to_owned(),
            speed: Some(0.6),
            battery: 0.9,
            discharge: 0.0004,
            skills: skills.map(str::to_owned).to_vec(),
            trained: None,
            late: false,
            thirst: 1.0,
            clock_rate: 1.0,
        }
    }

    /// An arm that takes samples out of drawers.
    pub fn arm(name: &str, place: &str) -> Member {
        let carrier = Member::carrier(name, place);
        Member { speed: None, battery: 1.0, discharge: 0.0, skills: vec!["pick_up".to_owned()], ..carrier }
    }

    /// The same robot with another speed, in metres per second.
    pub fn at_speed(self, speed: f64) -> Member {
        Member { speed: Some(speed), ..self }
    }

    /// The same robot with another charge.
    pub fn charged(self, battery: f64) -> Member {
        Member { battery, ..self }
    }

    /// The same robot with other skills.
    pub fn able(self, skills: &[&str]) -> Member {
        Member { skills: skills.iter().map(|skill| (*skill).to_owned()).collect(), ..self }
    }

    /// The same robot with one more skill.
    pub fn able_to(mut self, skill: &str) -> Member {
        self.skills.push(skill.to_owned());
        self
    }

    /// The same robot with a skill library of its own.
    pub fn trained(self, train: fn(&mut SkillLibrary)) -> Member {
        Member { trained: Some(train), ..self }
    }

    /// The same robot, whose node is started later by the test.
    pub fn late(self) -> Member {
        Member { late: true, ..self }
    }

    /// The same robot with a battery that empties so many times as fast as its estimates reckon with.
    pub fn thirsty(self, thirst: f64) -> Member {
        Member { thirst, ..self }
    }

    /// The same robot, whose node's clock counts so many seconds in one.
    pub fn with_clock(self, clock_rate: f64) -> Member {
        Member { clock_rate, ..self }
    }

    pub(crate) fn body(&self) -> RobotBody {
        let (id, place) = (slug(&self.name), slug(&self.place));
        match self.speed {
            Some(speed) => {
                let speed = MetresPerSecond::new(speed).expect("a speed");
                let battery = BatteryShare::new(self.battery).expect("a share");
                let discharge = SharePerSecond::new(self.discharge().get() * self.thirst).expect("a rate");
                RobotBody::carrier(id, place, speed, battery, discharge)
            }
            None => RobotBody::arm(id, place),
        }
    }

    fn discharge(&self) -> SharePerSecond {
        SharePerSecond::new(self.discharge).expect("a rate")
    }

    pub(crate) fn worker(&self, map: &Map) -> Worker {
        let place: PlaceId = slug(&self.place);
        Worker {
            skills: self.skills.iter().map(|skill| slug(skill)).collect(),
            pose: map.place(&place).map_or(Pose::default(), |place| place.pose),
            place,
            battery: BatteryShare::new(self.battery).expect("a share"),
            discharge: self.discharge(),
            useful_charge: BatteryShare::new(0.08).expect("a share"),
            speed: self.speed.map(|speed| MetresPerSecond::new(speed).expect("a speed")),
            availability: Availability::Free,
            estimator: "1".to_owned(),
        }
    }
}
