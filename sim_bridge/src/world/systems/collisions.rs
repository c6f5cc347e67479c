//! Running into things: robots that are steered, into walls and into other bodies.
//!
//! Looked for at every step, among what the grid of bodies has near. Whoever runs into something stands there, and its
//! goal is broken off; it may go on from there, and what it still touches then is no new collision. Robots that drive
//! in straight lines computed ahead pass through everything, and are only run into.

use super::steering::{BodyIndex, Footprint, Steered};
use crate::space::WallGrid;
use crate::world::components::SimRobot;
use crate::world::event_log::WorldEvent;
use crate::world::location::RobotLocation;
use crate::world::preconditions::action_error;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, kinds};
use consort_skills::actions::ErrorCode;
use hecs::Entity;
use std::collections::BTreeSet;

/// Who touches whom, the lesser first; a wall is nobody.
#[derive(Default)]
pub(crate) struct Touching(BTreeSet<(Entity, Option<Entity>)>);

/// See the [module](self).
pub(crate) struct Collisions;

impl System for Collisions {
    fn name(&self) -> &'static str {
        "collisions"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot, BodyIndex, Footprint, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Steered, Touching]
    }

    fn init_world(&self, floor: &mut SimState, _setup: &WorldSetup) {
        floor.insert_resource(Touching::default());
    }

    fn step(&self, floor: &mut SimState) -> bool {
        if !floor.has_resource::<BodyIndex>() {
            return false;
        }
        let touching = floor.resource::<BodyIndex>().touching(&floor.walls);
        if touching.is_empty() && floor.resource::<Touching>().0.is_empty() {
            return false;
        }
        let mut before = std::mem::take(&mut floor.resource_mut::<Touching>().0);
        let new: Vec<_> = touching.difference(&before).copied().collect();
        before.retain(|(one, other)| touching.contains(&(*one, *other)) || floor.still_touch(*one, *other));
        before.extend(touching);
        floor.resource_mut::<Touching>().0 = before;
        for (one, other) in new {
            floor.collide(one, other);
            if let Some(other) = other {
                floor.collide(other, Some(one));
            }
        }
        false
    }
}

impl BodyIndex {
    /// What touches now, of which at least one moves in steps.
    fn touching(&self, walls: &[WallGrid]) -> BTreeSet<(Entity, Option<Entity>)> {
        let mut touching = BTreeSet::new();
        for (name, (robot, _)) in self.owners.iter().enumerate().filter(|(_, (_, moves))| *moves) {
            let disc = self.bodies.disc(name);
            self.bodies.for_each_near(
                &disc.at,
                disc.level,
                disc.radius_m + self.bodies.max_radius_m(),
                |other, found| {
                    let touch_m = disc.radius_m + found.radius_m;
                    if other != name && (found.at - disc.at).norm_squared() < touch_m * touch_m {
                        let other = self.owners[other].0;
                        touching.insert((*robot.min(&other), Some(*robot.max(&other))));
                    }
                },
            );
            if walls[disc.level].nearest_distance(disc.at.xy(), disc.radius_m).is_some_and(|away| away < disc.radius_m)
            {
                touching.insert((*robot, None));
            }
        }
        touching
    }
}

impl SimState {
    /// Whether two that stand touch as they did; for a wall, whether the robot stands.
    fn still_touch(&self, one: Entity, other: Option<Entity>) -> bool {
        let moves = |robot: Entity| self.find::<Steered>(robot).is_some_and(|steered| steered.model.is_moving());
        let Some(other) = other else { return !moves(one) };
        let place = |robot| (self.get::<RobotLocation>(robot).pose(self.now), self.get::<Footprint>(robot).0);
        let ((a, a_m), (b, b_m)) = (place(one), place(other));
        !moves(one) && !moves(other) && a.distance(b).get() < a_m + b_m
    }

    /// A robot ran into another, or into a wall. One that drives in straight lines notices nothing.
    fn collide(&mut self, robot: Entity, with: Option<Entity>) {
        match self.find_mut::<Steered>(robot) {
            Some(mut steered) => steered.model.stop_immediately(),
            None => return,
        }
        let (name, with) = (self.robot_id(robot), with.map(|other| self.robot_id(other)));
        let what = with.as_ref().map_or("a wall".to_owned(), ToString::to_string);
        self.abort_goal(robot, action_error(ErrorCode::NoRoute, format!("{name} ran into {what}")));
        self.log_after_commands(WorldEvent::Collided { robot: name, with });
    }
}
