//! Obstacles: a trolley in a corridor, a floor that is being cleaned.
//!
//! A robot detects an obstacle at a short distance (see [`driving`](super::driving)), or receives a
//! report from outside. It remembers the closure for a while
//! ([`Durations::closure_memory_s`](crate::world::Durations)), then it regards the lane as open
//! again.

use crate::component_types;
use crate::map::PlaceIndex;
use crate::world::event::WorldEvent;
use crate::world::setup::Obstacle;
use crate::world::setup::{RobotSetup, SetupError, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::simulation::World;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use consort_protocol::ids::PlaceId;
use hecs::Entity;
use std::collections::BTreeMap;

/// Current obstacles by name, and the obstacles of the setup.
pub(crate) struct ActiveObstacles {
    active: BTreeMap<String, ObstaclePosition>,
    planned: Vec<(String, ObstaclePosition)>,
}

/// Position of an obstacle: a share of the lane from the first place to the second.
#[derive(Debug, Clone, Copy)]
struct ObstaclePosition {
    from: PlaceIndex,
    to: PlaceIndex,
    share: f64,
}

/// Lanes that a robot has found closed, or that were reported to it: the time of the latest
/// information, by the two ends in order.
#[derive(Default)]
pub(crate) struct KnownClosures(BTreeMap<(PlaceIndex, PlaceIndex), f64>);

/// See the [module](self).
pub(crate) struct Obstacles;

impl System for Obstacles {
    fn name(&self) -> &'static str {
        "obstacles"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![ActiveObstacles, KnownClosures]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let planned: Vec<_> = setup
            .obstacles
            .iter()
            .map(|obstacle| (obstacle.name.clone(), state.position(obstacle).expect("checked: the way is on the map")))
            .collect();
        state.insert_resource(ActiveObstacles { active: BTreeMap::new(), planned });
        for (index, obstacle) in setup.obstacles.iter().enumerate() {
            // Even numbers are appearances, odd numbers disappearances.
            let (about, number) = (state.spawn(), 2 * index as u64);
            if obstacle.from_s > 0.0 {
                state.schedule(obstacle.from_s, about, number);
            } else {
                let (name, position) = state.resource::<ActiveObstacles>().planned[index].clone();
                state.place_obstacle(name, position);
            }
            if let Some(until) = obstacle.until_s {
                state.schedule(until, about, number + 1);
            }
        }
    }

    fn init_robot(&self, state: &mut SimState, robot: Entity, _body: &RobotSetup) {
        state.insert(robot, KnownClosures::default());
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        let planned = state.resource::<ActiveObstacles>().planned.get((number / 2) as usize).cloned();
        let Some((name, position)) = planned else { return };
        if number % 2 == 0 {
            state.place_obstacle(name, position);
        } else {
            state.clear_obstacle(&name);
        }
    }
}

impl World {
    /// Adds an obstacle, replacing any obstacle with this name. Its times are ignored.
    ///
    /// # Errors
    /// [`SetupError`] if the obstacle is not on a lane of this map. Nothing has changed.
    pub fn add_obstacle(&mut self, obstacle: &Obstacle) -> Result<(), SetupError> {
        obstacle.check(&self.state.map)?;
        let position = self.state.position(obstacle).expect("checked: the way is on the map");
        self.run_as(&Obstacles, |state| state.place_obstacle(obstacle.name.clone(), position));
        Ok(())
    }

    /// Removes an obstacle. Without effect if there is none with this name. Robots that remember it
    /// try the lane again after [`Durations::closure_memory_s`](crate::world::Durations).
    pub fn remove_obstacle(&mut self, obstacle: &str) {
        self.run_as(&Obstacles, |state| state.clear_obstacle(obstacle));
    }
}

impl SimState {
    fn position(&self, obstacle: &Obstacle) -> Option<ObstaclePosition> {
        let (a, b) = &obstacle.on;
        Some(ObstaclePosition { from: self.map.index(a)?, to: self.map.index(b)?, share: obstacle.at })
    }

    fn place_obstacle(&mut self, name: String, position: ObstaclePosition) {
        self.resource_mut::<ActiveObstacles>().active.insert(name.clone(), position);
        let between = self.ends(position);
        self.log_event(WorldEvent::LaneBlocked { obstacle: name, between });
    }

    fn clear_obstacle(&mut self, name: &str) {
        let removed = self.resource_mut::<ActiveObstacles>().active.remove(name);
        if let Some(position) = removed {
            let between = self.ends(position);
            self.log_event(WorldEvent::LaneCleared { obstacle: name.to_owned(), between });
        }
    }

    fn ends(&self, ObstaclePosition { from, to, .. }: ObstaclePosition) -> (PlaceId, PlaceId) {
        (self.map.place_at(from).id.clone(), self.map.place_at(to).id.clone())
    }

    /// Returns the obstacles between two neighbouring places, each with its share of the lane.
    pub(crate) fn obstacles_on(&self, from: PlaceIndex, to: PlaceIndex) -> Vec<(f64, String)> {
        if !self.has_resource::<ActiveObstacles>() {
            return vec![];
        }
        let obstacles = self.resource::<ActiveObstacles>();
        let active = obstacles.active.iter().filter_map(|(name, position)| match (position.from, position.to) {
            ends if ends == (from, to) => Some((position.share, name.clone())),
            ends if ends == (to, from) => Some((1.0 - position.share, name.clone())),
            _ => None,
        });
        active.collect()
    }

    /// Remembers a lane as closed for a robot.
    pub(crate) fn remember_closure(&self, robot: Entity, a: PlaceIndex, b: PlaceIndex) {
        if let Some(mut closures) = self.find_mut::<KnownClosures>(robot) {
            closures.0.insert((a.min(b), a.max(b)), self.now);
        }
    }

    /// Returns the lanes that a robot regards as closed.
    pub(crate) fn known_closures(&self, robot: Entity) -> Vec<(PlaceId, PlaceId)> {
        let Some(closures) = self.find::<KnownClosures>(robot) else { return vec![] };
        let remembered = |since: &f64| self.now - since < self.durations.closure_memory_s;
        let ends = |((a, b), _): (&(PlaceIndex, PlaceIndex), &f64)| {
            (self.map.place_at(*a).id.clone(), self.map.place_at(*b).id.clone())
        };
        closures.0.iter().filter(|(_, since)| remembered(since)).map(ends).collect()
    }
}
