//! Steering: driving or flying with kinematics.
//!
//! Routes, and the points at which a robot waits, are the same as for robots that drive in straight
//! lines ([`Driving`]). A [`KinematicModel`](crate::kinematics) drives each part. Its arrival time is not known in
//! advance, so the world steps while any such robot moves.

use super::driving::Driving;
use crate::component_types;
use crate::world::location::RobotLocation;
use crate::world::setup::{RobotSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::steered::{BodyIndex, Footprint, Steered};
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use hecs::Entity;

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
        state.insert(robot, Footprint(body.radius_m));
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
        let mut goes_on = false;
        let now = state.now;
        for (robot, steered, location) in state.query::<(Entity, &mut Steered, &mut RobotLocation)>() {
            if !steered.model.is_moving() {
                steered.since = now;
                continue;
            }
            index.collect_neighbours(robot, steered);
            let is_arrived = steered.model.advance(now - steered.since, &index.neighbours).is_some();
            steered.since = now;
            goes_on |= steered.model.is_moving();
            *location = steered.location(location);
            if is_arrived && let Some(part) = steered.part.take() {
                *location = RobotLocation::Standing { position: part.end_position, pose: steered.pose() };
                index.arrived.push(robot);
            } else if steered.notify_at_m.is_some_and(|notify_at_m| steered.remaining_m() <= notify_at_m) {
                steered.notify_at_m = None;
                index.passed.push(robot);
            }
        }
        state.rebuild_index(&mut index);
        let (mut arrived, mut passed) = (std::mem::take(&mut index.arrived), std::mem::take(&mut index.passed));
        *state.resource_mut::<BodyIndex>() = index;
        passed.drain(..).for_each(|robot| state.on_steered_door_passed(robot));
        arrived.drain(..).for_each(|robot| state.on_steered_arrival(robot));
        let mut index = state.resource_mut::<BodyIndex>();
        (index.arrived, index.passed) = (arrived, passed);
        goes_on
    }
}
