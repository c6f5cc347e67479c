//! The controller of a swarm, and its clock.

use super::formation::{Swarm, SwarmError, assign, circles, robot};
use super::table::SwarmResult;
use crate::world::{World, WorldEvent};
use consort_protocol::ids::RobotId;
use consort_protocol::pose::Pose;
use consort_protocol::units::WorldTime;
use consort_skills::actions::{BackendEvent, Goal, GoalId, GoalStatus, NavigateToPose, RobotBackend};
use std::collections::BTreeSet;
use std::time::Duration;

/// Time for which the controller waits for the next result, in seconds.
const RESULT_TIMEOUT_S: f64 = 15.0;

/// Lets a swarm take off and fly to its circles. `clock` returns the time elapsed outside the
/// simulation. It is called once for each simulated second.
///
/// # Errors
/// [`SwarmError`] if the swarm is impossible.
pub fn run_swarm(swarm: Swarm, mut clock: impl FnMut() -> Duration) -> Result<SwarmResult, SwarmError> {
    if swarm.drones == 0 {
        return Err(SwarmError::NoDrones);
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
    Ok(flight.result(&seconds, rest))
}

/// A flying swarm, from the view of its controller.
struct Flight {
    world: World,
    /// Target of each drone.
    targets: Vec<(RobotId, Pose)>,
    pending: BTreeSet<RobotId>,
    arrived: usize,
    crashed: BTreeSet<RobotId>,
    /// Time of the latest result.
    last_result_s: f64,
}

impl Flight {
    fn prepare(swarm: Swarm) -> Result<Flight, SwarmError> {
        let world = swarm.world()?;
        let stand: Vec<(f64, f64)> = world.map().places().iter().map(|pad| (pad.pose.x, pad.pose.y)).collect();
        let places = circles(swarm.drones);
        let chosen = assign(&places, &stand);
        let targets = chosen.into_iter().zip(places);
        let targets = targets.map(|(drone, (x, y))| (robot(drone), Pose::new(x, y, 0.0))).collect();
        let (pending, crashed) = (BTreeSet::new(), BTreeSet::new());
        Ok(Flight { world, targets, pending, arrived: 0, crashed, last_result_s: 0.0 })
    }

    fn send(&mut self) {
        for (drone, pose) in &self.targets {
            self.world.start(drone, GoalId(1), Goal::from(NavigateToPose::to(*pose, None)));
            self.pending.insert(drone.clone());
        }
    }

    /// Advances time until `until_s` or until the flight is over. Returns whether it is over.
    fn fly_until(&mut self, until_s: f64) -> bool {
        let until_s = until_s.min(self.last_result_s + RESULT_TIMEOUT_S);
        while !self.pending.is_empty() {
            let due = self.world.next_due().map_or(f64::INFINITY, WorldTime::as_secs);
            let over = due > until_s;
            for event in self.world.advance(WorldTime::from_secs(due.min(until_s))) {
                self.on_event(event);
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
        self.pending.is_empty() || self.now() >= self.last_result_s + RESULT_TIMEOUT_S
    }

    fn on_event(&mut self, event: BackendEvent) {
        if let BackendEvent::GoalEnded { robot, status, .. } = event
            && self.pending.remove(&robot)
        {
            self.arrived += usize::from(status == GoalStatus::succeeded());
            self.last_result_s = self.now();
        }
    }

    fn now(&self) -> f64 {
        self.world.now().as_secs()
    }

    /// Computes the result from the real duration of each whole simulated second, and of the rest.
    fn result(&self, seconds: &[f64], rest: f64) -> SwarmResult {
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
    use std::num::NonZeroUsize;

    fn swarm(drones: usize, seed: u64) -> Swarm {
        Swarm { drones, seed, threads: NonZeroUsize::MIN }
    }

    fn flown(drones: usize, seed: u64) -> SwarmResult {
        run_swarm(swarm(drones, seed), || Duration::ZERO).unwrap()
    }

    /// Poses of all drones after a time of flight, the drones under way, and the number of those that have arrived.
    fn trace(swarm: Swarm, until_s: f64) -> (Vec<Pose>, BTreeSet<RobotId>, usize) {
        let mut flight = Flight::prepare(swarm).unwrap();
        flight.send();
        flight.fly_until(until_s);
        let poses = (0..swarm.drones).map(|n| flight.world.telemetry(&robot(n)).unwrap().pose).collect();
        (poses, flight.pending, flight.arrived)
    }

    #[test]
    fn no_drone_of_two_hundred_crashes_and_all_arrive() {
        for seed in 1..=3 {
            let result = flown(200, seed);
            assert_eq!((result.arrived, result.crashed), (200, 0), "seed {seed}: {result:?}");
            assert!(result.simulated_s < 40.0, "seed {seed}: {result:?}");
        }
    }

    #[test]
    fn small_swarms_do_as_well() {
        for (drones, seed) in [(1, 7), (2, 7), (20, 7), (40, 1), (60, 1), (80, 7), (80, 8), (100, 1)] {
            let result = flown(drones, seed);
            assert_eq!((result.arrived, result.crashed), (drones, 0), "seed {seed}: {result:?}");
        }
    }

    #[test]
    fn equal_seeds_fly_alike_and_others_do_not() {
        let trace = |seed| trace(swarm(60, seed), 9.0);
        assert_eq!(trace(4), trace(4));
        assert_ne!(trace(4), trace(5));
        assert_eq!(flown(60, 4), flown(60, 4));
    }

    #[test]
    fn a_flight_does_not_depend_on_the_number_of_threads() {
        // As many drones as make two and three threads worth starting.
        let trace = |threads| trace(Swarm { threads: NonZeroUsize::new(threads).unwrap(), ..swarm(1_600, 3) }, 5.0);
        let single = trace(1);
        assert!(single.2 > 0, "some have arrived");
        assert!(single == trace(2), "two threads");
        assert!(single == trace(3), "three threads");
    }

    #[test]
    fn impossible_swarms_are_rejected() {
        let refused = |drones| run_swarm(swarm(drones, 1), || Duration::ZERO).unwrap_err().to_string();
        assert_eq!(refused(0), "a swarm needs at least 1 drone");
        assert!(refused(10_001).contains("10000"), "{}", refused(10_001));
    }

    #[test]
    fn a_missing_result_ends_the_flight_after_fifteen_seconds() {
        let mut flight = Flight::prepare(swarm(2, 1)).unwrap();
        flight.send();
        let stranger = RobotId::new("nobody").unwrap();
        flight.pending.insert(stranger);
        assert!(!flight.fly_until(flight.last_result_s + 10.0));
        assert_eq!((flight.arrived, flight.now()), (2, 10.0));
        let last_result = flight.last_result_s;
        assert!((1.0..10.0).contains(&last_result), "{last_result}");
        assert!(flight.fly_until(100.0));
        assert!((flight.now() - last_result - RESULT_TIMEOUT_S).abs() < 1e-9);
    }
}
