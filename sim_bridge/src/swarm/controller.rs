//! The controller of a swarm, and the clock beside it.

use super::formation::{Swarm, assign, circles, robot};
use super::table::SwarmResult;
use crate::world::{World, WorldEvent};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{BackendEvent, Goal, GoalId, GoalStatus, RobotBackend};
use std::collections::BTreeSet;
use std::time::Duration;

/// How long the controller waits for the next answer, in seconds.
pub const RESULT_TIMEOUT_S: f64 = 15.0;

/// A swarm that cannot be: none at all, or more drones than a map has places.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SwarmError(pub(super) String);

/// Has a swarm take off and fly to its circles. `clock` tells how much time has passed outside the simulation: it is asked
/// once for each second within.
///
/// # Errors
/// [`SwarmError`] if there can be no such swarm.
pub fn run_swarm(swarm: Swarm, mut clock: impl FnMut() -> Duration) -> Result<SwarmResult, SwarmError> {
    if swarm.drones == 0 {
        return Err(SwarmError("a swarm has 1 drone or more".to_owned()));
    }
    let mut flight = Flight::prepare(swarm)?;
    let (mut seconds, mut before) = (Vec::new(), clock());
    flight.send();
    let mut until = 1.0;
    while !flight.fly_until(until) {
        let now = clock();
        seconds.push((now - before).as_secs_f64());
        (before, until) = (now, until + 1.0);
    }
    let rest = (clock() - before).as_secs_f64();
    Ok(flight.row(&seconds, rest))
}

/// A swarm under way, as its controller sees it.
struct Flight {
    world: World,
    /// Where each is to be.
    targets: Vec<(RobotId, Pose)>,
    waits_for: BTreeSet<RobotId>,
    arrived: usize,
    crashed: BTreeSet<RobotId>,
    /// When somebody answered last.
    answered_s: f64,
}

impl Flight {
    fn prepare(swarm: Swarm) -> Result<Flight, SwarmError> {
        let world = swarm.world()?;
        let stand: Vec<(f64, f64)> = world.map().places().iter().map(|pad| (pad.pose.x, pad.pose.y)).collect();
        let places = circles(swarm.drones);
        let chosen = assign(&places, &stand);
        let targets = chosen.into_iter().zip(places);
        let targets = targets.map(|(drone, (x, y))| (robot(drone), Pose::new(x, y, 0.0))).collect();
        let (waits_for, crashed) = (BTreeSet::new(), BTreeSet::new());
        Ok(Flight { world, targets, waits_for, arrived: 0, crashed, answered_s: 0.0 })
    }

    fn send(&mut self) {
        for (drone, pose) in &self.targets {
            self.world.start(drone, GoalId(1), Goal::NavigateToPose { pose: *pose, place: None });
            self.waits_for.insert(drone.clone());
        }
    }

    /// Lets time pass until so many seconds have, or until it is over: whether it is.
    fn fly_until(&mut self, until_s: f64) -> bool {
        let until_s = until_s.min(self.answered_s + RESULT_TIMEOUT_S);
        while !self.waits_for.is_empty() {
            let due = self.world.next_due().map_or(f64::INFINITY, WorldTime::as_secs);
            let over = due > until_s;
            for event in self.world.advance(WorldTime::from_secs(due.min(until_s))) {
                self.hear(event);
            }
            if over {
                break;
            }
        }
        for entry in self.world.drain_event_log() {
            if let WorldEvent::Collided { robot, .. } = entry.event {
                self.crashed.insert(robot);
            }
        }
        self.waits_for.is_empty() || self.now() >= self.answered_s + RESULT_TIMEOUT_S
    }

    fn hear(&mut self, event: BackendEvent) {
        if let BackendEvent::GoalEnded { robot, status, .. } = event
            && self.waits_for.remove(&robot)
        {
            self.arrived += usize::from(status == GoalStatus::Succeeded);
            self.answered_s = self.now();
        }
    }

    fn now(&self) -> f64 {
        self.world.now().as_secs()
    }

    /// What is to be told of it: from how long each whole second took outside, and the rest.
    fn row(&self, seconds: &[f64], rest: f64) -> SwarmResult {
        let simulated_s = self.now();
        let sum = seconds.iter().sum::<f64>() + rest;
        let whole = || seconds.iter().copied();
        SwarmResult {
            drones: self.targets.len(),
            simulated_s,
            min_s: whole().min_by(f64::total_cmp).unwrap_or(sum),
            max_s: whole().max_by(f64::total_cmp).unwrap_or(sum),
            average_s: sum / simulated_s,
            arrived: self.arrived,
            crashed: self.crashed.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flown(drones: usize, seed: u64) -> SwarmResult {
        run_swarm(Swarm { drones, seed }, || Duration::ZERO).unwrap()
    }

    #[test]
    fn no_drone_of_two_hundred_crashes_and_all_arrive() {
        for seed in 1..=3 {
            let row = flown(200, seed);
            assert_eq!((row.arrived, row.crashed), (200, 0), "seed {seed}: {row:?}");
            assert!(row.simulated_s < 40.0, "seed {seed}: {row:?}");
        }
    }

    #[test]
    fn small_swarms_do_as_well() {
        for (drones, seed) in [(1, 7), (2, 7), (20, 7), (40, 1), (60, 1), (80, 7), (80, 8), (100, 1)] {
            let row = flown(drones, seed);
            assert_eq!((row.arrived, row.crashed), (drones, 0), "seed {seed}: {row:?}");
        }
    }

    #[test]
    fn the_same_seed_flies_the_same_way_and_another_does_not() {
        let poses = |seed| {
            let mut flight = Flight::prepare(Swarm { drones: 60, seed }).unwrap();
            flight.send();
            flight.fly_until(9.0);
            let poses: Vec<Pose> = (0..60).map(|n| flight.world.telemetry(&robot(n)).unwrap().pose).collect();
            poses
        };
        assert_eq!(poses(4), poses(4));
        assert_ne!(poses(4), poses(5));
        assert_eq!(flown(60, 4), flown(60, 4));
    }

    #[test]
    fn impossible_swarms_are_refused() {
        let refused = |drones| run_swarm(Swarm { drones, seed: 1 }, || Duration::ZERO).unwrap_err().to_string();
        assert_eq!(refused(0), "a swarm has 1 drone or more");
        assert!(refused(10_001).contains("10000"), "{}", refused(10_001));
    }

    #[test]
    fn whoever_does_not_answer_is_waited_for_fifteen_seconds() {
        let mut flight = Flight::prepare(Swarm { drones: 2, seed: 1 }).unwrap();
        flight.send();
        let stranger = RobotId::new("nobody").unwrap();
        flight.waits_for.insert(stranger);
        assert!(!flight.fly_until(flight.answered_s + 10.0));
        assert_eq!((flight.arrived, flight.now()), (2, 10.0));
        let answered = flight.answered_s;
        assert!((1.0..10.0).contains(&answered), "{answered}");
        assert!(flight.fly_until(100.0));
        assert!((flight.now() - answered - RESULT_TIMEOUT_S).abs() < 1e-9);
    }
}
