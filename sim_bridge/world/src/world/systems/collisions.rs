//! Collisions of steered robots with walls and other bodies.
//!
//! Collisions are detected at every step, by queries to the body grid. A robot that collides stops,
//! and its goal is aborted. It may drive on from there; bodies that it still touches then cause no
//! new collision. Robots that drive in straight lines computed ahead pass through everything, but
//! steered robots can collide with them.

use crate::component_types;
use crate::space::WallGrid;
use crate::world::components::SimRobot;
use crate::world::event::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Footprint, Steered};
use crate::world::system::System;
use crate::world::system_access::ComponentType;
use consort_skills::actions::ErrorCode;
use hecs::Entity;
use std::collections::BTreeSet;

/// Pairs of touching bodies, the smaller entity first; `None` is a wall.
#[derive(Default)]
pub(crate) struct Touching(BTreeSet<(Entity, Option<Entity>)>);

/// See the [module](self).
pub(crate) struct Collisions;

impl System for Collisions {
    fn name(&self) -> &'static str {
        "collisions"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, Footprint, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Steered, BodyIndex, Touching]
    }

    fn init_world(&self, state: &mut SimState, _setup: &WorldSetup) {
        state.insert_resource(Touching::default());
    }

    fn step(&self, state: &mut SimState) -> bool {
        if !state.has_resource::<BodyIndex>() {
            return false;
        }
        let touching = state.resource::<BodyIndex>().touching(&state.walls);
        if touching.is_empty() && state.resource::<Touching>().0.is_empty() {
            return false;
        }
        let mut before = std::mem::take(&mut state.resource_mut::<Touching>().0);
        let new: Vec<_> = touching.difference(&before).copied().collect();
        before.retain(|(first, second)| touching.contains(&(*first, *second)) || state.still_touching(*first, *second));
        before.extend(touching);
        state.resource_mut::<Touching>().0 = before;
        for (first, second) in new {
            state.collide(first, second);
            if let Some(second) = second {
                state.collide(second, Some(first));
            }
        }
        false
    }
}

impl BodyIndex {
    /// Returns the touching pairs in which a body moves.
    fn touching(&self, walls: &[WallGrid]) -> BTreeSet<(Entity, Option<Entity>)> {
        let mut touching = BTreeSet::new();
        let moving = self.moving.iter().enumerate().filter(|(_, moves)| **moves);
        for (number, robot) in moving.map(|(number, _)| (number, &self.owners[number])) {
            let disc = self.bodies.disc(number);
            let Some(walls) = walls.get(disc.level) else { continue }; // in a lift
            self.bodies.for_each_near(
                &disc.at,
                disc.level,
                disc.radius_m + self.bodies.max_radius_m(),
                |second, found| {
                    let touch_m = disc.radius_m + found.radius_m;
                    if second != number && (found.at - disc.at).norm_squared() < touch_m * touch_m {
                        let second = self.owners[second];
                        touching.insert((*robot.min(&second), Some(*robot.max(&second))));
                    }
                },
            );
            let wall_m = walls.nearest_distance(disc.at.xy(), disc.radius_m);
            if wall_m.is_some_and(|distance| distance < disc.radius_m) {
                touching.insert((*robot, None));
            }
        }
        touching
    }
}

impl SimState {
    /// Checks whether two bodies at standstill still touch; for a wall, whether the robot stands
    /// still.
    fn still_touching(&self, first: Entity, second: Option<Entity>) -> bool {
        let moves = |robot: Entity| self.find::<Steered>(robot).is_some_and(|steered| steered.model.is_moving());
        let Some(second) = second else { return !moves(first) };
        let place = |robot| (self.get::<RobotLocation>(robot).pose(self.now), self.get::<Footprint>(robot).radius_m);
        let ((a, a_m), (b, b_m)) = (place(first), place(second));
        !moves(first) && !moves(second) && a.distance(b).get() < a_m + b_m
    }

    /// Stops a robot after a collision with another robot or a wall. A robot that drives in
    /// straight lines is not affected.
    fn collide(&mut self, robot: Entity, with: Option<Entity>) {
        if !self.change_steered(robot, |steered| steered.model.stop_immediately()) {
            return;
        }
        let (name, with) = (self.robot_id(robot), with.map(|second| self.robot_id(second)));
        let obstacle = with.as_ref().map_or("a wall".to_owned(), ToString::to_string);
        self.abort_goal(robot, action_error(ErrorCode::NoRoute, format!("{name} collided with {obstacle}")));
        self.log_after_commands(WorldEvent::Collided { robot: name, with });
    }
}
