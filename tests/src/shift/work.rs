//! Work of a shift: its requests, and the time and charge that they need by the robots' own estimates.

use super::ShiftSetup;
use crate::fleet::nurse_in;
use crate::{ChargingSetup, RobotSpec, slug};
use consort_evaluation::shift::ShiftJob;
use consort_protocol::ids::{PlaceId, RoleId};
use consort_protocol::knowledge::Attributes;
use consort_protocol::plan::divide_and_check;
use consort_protocol::timeline::Travel;
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::domain::hospital;
use consort_skills::environment::{Routes, SpeedLimits};
use consort_world::map::{Map, shipped};
use consort_world::world::PersonSetup;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// Mission of all requests, and the role of its carrier.
pub(crate) const MISSION: &str = "lab-samples";
pub(crate) const CARRIER: &str = "r1";

/// Place of the arms, where each mission ends.
pub(crate) const LABORATORY: &str = "Laboratory";

/// Places of chargers, in the order of use. No sample is fetched from a room with a charger.
pub const CHARGERS: [&str; 6] = ["Dock", "PC Room 8", "IC Room 3", "PC Room 4", "IC Room 5", "PC Room 6"];

/// Charge below which a carrier charges.
const BELOW: f64 = 0.4;

/// Power of a charger: it charges a battery about four times as fast as a working robot discharges it.
const POWER_W: f64 = 600.0;

/// Request of a shift.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ShiftRequest {
    /// Time since the first request in seconds of world time.
    pub(crate) at_s: f64,
    /// Room with the sample.
    pub(crate) room: PlaceId,
}

/// Returns the rooms from which samples are fetched.
pub(crate) fn rooms(chargers: usize) -> Vec<PlaceId> {
    let map = shipped("hospital").expect("it is shipped");
    let is_room = |place: &PlaceId| ["IC Room", "PC Room"].iter().any(|kind| place.as_str().starts_with(kind));
    let has_charger = |place: &PlaceId| CHARGERS[..chargers].contains(&place.as_str());
    map.topology().places.into_keys().filter(|place| is_room(place) && !has_charger(place)).collect()
}

/// Returns a nurse for each room, who has a sample for each request.
pub(crate) fn nurses(rooms: &[PlaceId]) -> Vec<PersonSetup> {
    let nurse = |room: &PlaceId| PersonSetup { endless_samples: true, ..nurse_in(room.as_str()) };
    rooms.iter().map(nurse).collect()
}

/// Draws the carriers, each in a room and with a full battery.
pub(crate) fn draw_carriers(count: usize, rooms: &[PlaceId], chance: &mut ChaCha8Rng) -> Vec<RobotSpec> {
    let carrier = |number: usize| {
        let room = rooms.choose(chance).expect("the hospital has rooms");
        RobotSpec::carrier(&format!("robot-{number:02}"), room.as_str()).with_charge(1.0)
    };
    (0..count).map(carrier).collect()
}

/// Draws the requests in the order of their times.
pub(crate) fn draw_requests(setup: &ShiftSetup, rooms: &[PlaceId], chance: &mut ChaCha8Rng) -> Vec<ShiftRequest> {
    let mut at_s = 0.0;
    let mut draw = |number: usize| {
        if let Some(per_hour) = setup.per_hour.filter(|_| number > 0) {
            // The times between the events of a Poisson process are exponential.
            let uniform: f64 = chance.random_range(f64::MIN_POSITIVE..1.0);
            at_s += -uniform.ln() * 3600.0 / per_hour;
        }
        ShiftRequest { at_s, room: rooms.choose(chance).expect("the hospital has rooms").clone() }
    };
    (0..setup.missions).map(&mut draw).collect()
}

/// Returns the chargers; `None` for none.
pub(crate) fn charging(chargers: usize) -> Option<ChargingSetup> {
    (chargers > 0).then(|| ChargingSetup::new(&CHARGERS[..chargers], BELOW, POWER_W).with_known_power())
}

/// Estimates of the carriers' work.
#[derive(Debug)]
pub(crate) struct WorkModel {
    routes: Routes,
    speed: MetresPerSecond,
    /// Duration of the work of a carrier in each room, without the drive to the room.
    spans_s: BTreeMap<PlaceId, f64>,
}

impl WorkModel {
    /// Returns the estimates for these rooms, with the speed of [`RobotSpec::carrier`].
    pub(crate) fn new(rooms: &[PlaceId]) -> WorkModel {
        let map = shipped("hospital").expect("it is shipped");
        let environment = map.environment().expect("the shipped map is sound");
        let routes = environment.find::<Routes>().expect("a map has routes").clone();
        let estimator = DescriptorRegistry::standard().resolve(environment).expect("routes are there");
        let carrier = RobotSpec::carrier("model", LABORATORY);
        let speed = MetresPerSecond::new(carrier.speed.expect("a carrier drives")).expect("a speed");
        let spans = rooms.iter().map(|room| (room.clone(), span_s(room, speed, &map, &estimator)));
        WorkModel { routes, speed, spans_s: spans.collect() }
    }

    /// Returns the job of the carrier for a request.
    pub(crate) fn job(&self, request: &ShiftRequest) -> ShiftJob<PlaceId> {
        ShiftJob {
            requested_s: request.at_s,
            from: request.room.clone(),
            to: slug(LABORATORY),
            duration_s: self.spans_s[&request.room],
        }
    }

    /// Returns the mean duration of a mission for its carrier, which begins in the laboratory.
    fn mission_s(&self) -> f64 {
        let laboratory = slug(LABORATORY);
        let each = self.spans_s.iter().map(|(room, span_s)| self.seconds(&laboratory, room) + span_s);
        each.sum::<f64>() / self.spans_s.len() as f64
    }
}

impl Travel<PlaceId> for WorkModel {
    fn seconds(&self, from: &PlaceId, to: &PlaceId) -> f64 {
        self.routes.distance(from, to).map_or(f64::INFINITY, |length| length.at(self.speed).get())
    }
}

/// Returns the rate of requests at which the offered work of the carriers is this share of the time that they have. The
/// time in which a carrier charges what a mission needs is no such time; drives to chargers and idle discharge do not
/// count.
pub fn requests_per_hour(robots: usize, chargers: usize, load: f64) -> f64 {
    let mission_s = WorkModel::new(&rooms(chargers)).mission_s();
    let charging_s = match chargers {
        0 => 0.0,
        _ => {
            let battery_s = ChargingSetup::CAPACITY_WH * 3600.0 / POWER_W;
            mission_s * RobotSpec::carrier("model", LABORATORY).discharge * battery_s
        }
    };
    load * robots as f64 * 3600.0 / (mission_s + load * charging_s)
}

/// Estimates the work of the carrier in a room as robots do.
fn span_s(room: &PlaceId, speed: MetresPerSecond, map: &Map, estimator: &Estimator) -> f64 {
    let domain = hospital().with_places(map.topology().places.into_keys());
    let parameters = BTreeMap::from([("room".to_owned(), room.as_str().to_owned())]);
    let mission = consort_skills::missions::shipped()[MISSION].instantiate(&parameters, &domain);
    let division = divide_and_check(&mission.expect("a shipped mission")).expect("a shipped mission");
    let context = EstimateContext {
        place: room.clone(),
        pose: None,
        speed,
        discharge: SharePerSecond::new(0.0).expect("a rate"),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    };
    let plan = &division.plans[&slug::<RoleId>(CARRIER)];
    estimator.budget(plan, &context).expect("the standard skills have estimates").time().get()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_requests_grows_with_load_and_robots() {
        let rate = requests_per_hour(20, 6, 0.7);
        // A mission takes a carrier between one and three minutes.
        assert!((20.0 * 0.7 * 20.0..20.0 * 0.7 * 60.0).contains(&rate), "{rate}");
        assert!((requests_per_hour(10, 6, 0.7) - rate / 2.0).abs() < 1e-9);
        let half = requests_per_hour(20, 6, 0.35);
        assert!(half > rate / 2.0, "{half}: robots that work less charge less");
        let mission_s = WorkModel::new(&rooms(0)).mission_s();
        let uncharged = requests_per_hour(20, 0, 0.35) * mission_s / 3600.0;
        assert!((uncharged - 20.0 * 0.35).abs() < 1e-9, "{uncharged}: robots that never charge only work");
    }

    #[test]
    fn requests_are_in_the_order_of_time_and_avoid_chargers() {
        let setup = ShiftSetup { missions: 500, per_hour: Some(100.0), chargers: 6, ..ShiftSetup::default() };
        let rooms = rooms(setup.chargers);
        assert_eq!(rooms.len(), 14 - 5);
        let mut chance = consort_evaluation::seeds::generator(1, &["test"]);
        let requests = draw_requests(&setup, &rooms, &mut chance);
        assert!(requests.is_sorted_by(|one, other| one.at_s <= other.at_s));
        let hours = requests[499].at_s / 3600.0;
        assert!((4.0..6.0).contains(&hours), "500 requests in {hours} h");
        assert!(requests.iter().all(|request| !CHARGERS.contains(&request.room.as_str())));
    }
}
