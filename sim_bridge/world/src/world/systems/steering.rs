//! Steering: driving or flying with kinematics.
//!
//! Routes, and the points at which a robot waits, are the same as for robots that drive in straight
//! lines ([`Driving`]). A [`KinematicModel`](crate::kinematics) drives each part. Its arrival time is not known in
//! advance, so the world steps while any such robot moves.
//!
//! In a step each robot moves on its own, among the others where the latest step left them. So
//! threads share the robots, and the result does not depend on their number.

use super::driving::Driving;
use crate::component_types;
use crate::world::location::RobotLocation;
use crate::world::setup::{RobotSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Footprint, Neighbourhood, Placement, Steered};
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use hecs::Entity;
use std::num::NonZeroUsize;

/// Fewest moving robots for each thread: with fewer, starting a thread takes longer than it saves.
const ROBOTS_PER_THREAD: usize = 512;

/// See the [module](self).
pub(crate) struct Steering;

impl System for Steering {
    fn name(&self) -> &'static str {
        "steering"
    }

    fn reads(&self) -> Vec<ComponentType> {
        Driving.reads()
    }

    fn writes(&self) -> Vec<ComponentType> {
        let mut component_types = Driving.writes();
        component_types.extend(component_types![Footprint]);
        component_types
    }

    fn init_world(&self, state: &mut SimState, _setup: &WorldSetup) {
        state.insert_resource(BodyIndex::default());
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, body: &RobotSetup) {
        let number = state.resource_mut::<BodyIndex>().add(robot, body.radius_m, body.kinematics.is_some());
        state.insert(robot, Footprint { number, radius_m: body.radius_m });
        if let Some(kinematics) = &body.kinematics {
            let pose = state.get::<RobotLocation>(robot).pose(state.now);
            let model = state.kinematic_model(kinematics, body, pose);
            let level = state.level_of(state.map_position(robot));
            state.insert(robot, Steered { model, since: state.now, part: None, notify_at_m: None, level });
        }
    }

    fn on_timer(&self, state: &mut SimState, on_timer: SystemTimer) {
        Driving.on_timer(state, on_timer);
    }

    fn step(&self, state: &mut SimState) -> bool {
        let mut index = std::mem::take(&mut *state.resource_mut::<BodyIndex>());
        for robot in &index.changed {
            let number = state.get::<Footprint>(*robot).number;
            index.moving[number] = state.find::<Steered>(*robot).is_some_and(|steered| steered.model.is_moving());
        }
        let (now, threads) = (state.now, state.threads);
        let mut movers = Vec::new();
        state
            .query::<(&Footprint, &mut Steered, &mut RobotLocation)>()
            .into_iter()
            .filter(|(body, ..)| index.moving[body.number])
            .for_each(|(body, steered, location)| {
                movers.push(Mover { number: body.number, steered, location, notice: None });
            });
        advance_all(&mut movers, &index, now, threads);
        let mut goes_on = false;
        for Mover { number, steered, location, notice } in movers {
            let moves = steered.model.is_moving();
            goes_on |= moves;
            let (at, position) = (steered.model.position(), location.map_position(now));
            index.placements.push(Placement { number, at, position, moves });
            match notice {
                Some(Notice::Arrived) => index.arrived.push(index.owners[number]),
                Some(Notice::Passed) => index.passed.push(index.owners[number]),
                None => {}
            }
        }
        state.refresh_index(&mut index);
        let (mut arrived, mut passed) = (std::mem::take(&mut index.arrived), std::mem::take(&mut index.passed));
        *state.resource_mut::<BodyIndex>() = index;
        passed.drain(..).for_each(|robot| state.on_steered_door_passed(robot));
        arrived.drain(..).for_each(|robot| state.on_steered_arrival(robot));
        let mut index = state.resource_mut::<BodyIndex>();
        (index.arrived, index.passed) = (arrived, passed);
        goes_on
    }
}

/// A robot that moves in a step.
struct Mover<'a> {
    /// Number of its body.
    number: usize,
    steered: &'a mut Steered,
    location: &'a mut RobotLocation,
    notice: Option<Notice>,
}

/// An event of a robot in a step, which [`Driving`] handles after the step.
enum Notice {
    /// The robot has reached the end of its part.
    Arrived,
    /// The robot has passed the point for which a notification is requested.
    Passed,
}

impl Mover<'_> {
    fn advance(&mut self, index: &BodyIndex, now: f64, around: &mut Neighbourhood) {
        let (steered, location) = (&mut *self.steered, &mut *self.location);
        index.collect_neighbours(self.number, steered, around);
        let is_arrived = steered.model.advance(now - steered.since, &around.neighbours).is_some();
        steered.since = now;
        *location = steered.location(location);
        if is_arrived && let Some(part) = steered.part.take() {
            *location = RobotLocation::Standing { position: part.end_position, pose: steered.pose() };
            self.notice = Some(Notice::Arrived);
        } else if steered.notify_at_m.is_some_and(|notify_at_m| steered.remaining_m() <= notify_at_m) {
            steered.notify_at_m = None;
            self.notice = Some(Notice::Passed);
        }
    }
}

/// Moves the robots up to `now`, each thread an equal share.
fn advance_all(movers: &mut [Mover<'_>], index: &BodyIndex, now: f64, threads: NonZeroUsize) {
    let threads = useful_threads(movers.len(), threads);
    if threads.get() == 1 {
        return advance_share(movers, index, now);
    }
    let share = movers.len().div_ceil(threads.get());
    std::thread::scope(|scope| {
        let mut shares = movers.chunks_mut(share);
        let own = shares.next();
        for share in shares {
            scope.spawn(move || advance_share(share, index, now));
        }
        if let Some(own) = own {
            advance_share(own, index, now);
        }
    });
}

fn advance_share(movers: &mut [Mover<'_>], index: &BodyIndex, now: f64) {
    let mut around = Neighbourhood::default();
    for mover in movers {
        mover.advance(index, now, &mut around);
    }
}

/// Returns the number of threads that are worth starting for a number of moving robots.
fn useful_threads(movers: usize, threads: NonZeroUsize) -> NonZeroUsize {
    NonZeroUsize::new(movers / ROBOTS_PER_THREAD).map_or(NonZeroUsize::MIN, |useful| useful.min(threads))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_started_only_for_many_robots() {
        let threads = |movers| useful_threads(movers, NonZeroUsize::new(4).unwrap()).get();
        assert_eq!([0, 1, 1023, 1024, 1536, 10_000].map(threads), [1, 1, 1, 2, 3, 4]);
        assert_eq!(useful_threads(10_000, NonZeroUsize::MIN), NonZeroUsize::MIN);
    }
}
