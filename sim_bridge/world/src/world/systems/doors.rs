//! Automatic doors. A door opens for waiting robots, admits a limited number at a time, and closes
//! behind the last.
//!
//! ```text
//!            DoorRequested                      DoorEntered
//!  driving ──────────────▶ queue of the door ─────────────▶ driving … ── DoorLeft ──▶ the next robot, or the door closes
//! ```
//!
//! Robots are admitted in the order of arrival. A robot that stops in a doorway keeps the door open
//! and its slot taken.

use crate::component_types;
use crate::world::components::SimRobot;
use crate::world::event::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::setup::DoorSetup;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use consort_protocol::ids::RobotId;
use hecs::Entity;
use std::collections::{BTreeMap, VecDeque};

/// Doors by name.
pub(crate) struct DoorsByName(BTreeMap<String, Entity>);

/// State of a door.
pub(crate) struct DoorState {
    pub(crate) name: String,
    opening_s: f64,
    open_for_s: f64,
    capacity: usize,
    leaf: Leaf,
    /// End of the leaf's movement, or of the time it stays open without robots.
    due: Option<TimerId>,
    inside: Vec<Entity>,
    queue: VecDeque<Entity>,
    /// Time of the latest admission.
    pub(crate) last_entry_time: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Leaf {
    Closed,
    Opening,
    Open,
    Closing,
}

/// See the [module](self).
pub(crate) struct Doors;

impl System for Doors {
    fn name(&self) -> &'static str {
        "doors"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![DoorState, DoorsByName]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let mut doors = BTreeMap::new();
        for door in setup.map.doors() {
            let settings = setup.doors.iter().find(|settings| settings.name == door.name);
            let DoorSetup { capacity, open_for_s, .. } =
                settings.cloned().unwrap_or_else(|| DoorSetup::named(door.name.clone()));
            let entity = state.spawn();
            state.insert(
                entity,
                DoorState {
                    name: door.name.clone(),
                    opening_s: door.opening.get(),
                    open_for_s,
                    capacity,
                    leaf: Leaf::Closed,
                    due: None,
                    inside: Vec::new(),
                    queue: VecDeque::new(),
                    last_entry_time: 0.0,
                },
            );
            doors.insert(door.name.clone(), entity);
        }
        state.insert_resource(DoorsByName(doors));
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: door, .. }: SystemTimer) {
        state.get_mut::<DoorState>(door).due = None;
        let leaf = state.get::<DoorState>(door).leaf;
        match leaf {
            Leaf::Opening => {
                state.finish_leaf(door, Leaf::Open);
                state.admit(door);
            }
            // No robot came while the door was open.
            Leaf::Open => state.move_leaf(door, Leaf::Closing, None),
            Leaf::Closing => state.finish_leaf(door, Leaf::Closed),
            Leaf::Closed => {}
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        match event {
            WorldEvent::DoorRequested { robot, door } => {
                if let Some((robot, door)) = state.robot_and_door(robot, door) {
                    state.join_queue(robot, door);
                }
            }
            WorldEvent::DoorLeft { robot, door } => {
                if let Some((robot, door)) = state.robot_and_door(robot, door) {
                    {
                        let mut doorway = state.get_mut::<DoorState>(door);
                        doorway.inside.retain(|other| *other != robot);
                        doorway.queue.retain(|other| *other != robot);
                    }
                    state.admit(door);
                }
            }
            _ => {}
        }
    }
}

impl SimState {
    /// Returns the door with this name, if the world has the doors system.
    pub(crate) fn door_entity(&self, name: &str) -> Option<Entity> {
        if self.has_resource::<DoorsByName>() { self.resource::<DoorsByName>().0.get(name).copied() } else { None }
    }

    /// Returns each door with its state: `closed`, `opening`, `open` or `closing`.
    pub(crate) fn door_states(&self) -> Vec<(String, &'static str)> {
        if !self.has_resource::<DoorsByName>() {
            return vec![];
        }
        let state_name = |door: &Entity| match self.get::<DoorState>(*door).leaf {
            Leaf::Closed => "closed",
            Leaf::Opening => "opening",
            Leaf::Open => "open",
            Leaf::Closing => "closing",
        };
        self.resource::<DoorsByName>().0.iter().map(|(name, door)| (name.clone(), state_name(door))).collect()
    }

    fn robot_and_door(&self, robot: &RobotId, door: &str) -> Option<(Entity, Entity)> {
        Some((*self.robots.get(robot)?, self.door_entity(door)?))
    }

    fn join_queue(&mut self, robot: Entity, door: Entity) {
        let (leaf, due) = {
            let mut doorway = self.get_mut::<DoorState>(door);
            if doorway.queue.is_empty() && doorway.inside.is_empty() {
                doorway.last_entry_time = self.now;
            }
            doorway.queue.push_back(robot);
            (doorway.leaf, doorway.due)
        };
        match leaf {
            Leaf::Closed => self.move_leaf(door, Leaf::Opening, None),
            // It has as far to open as it has closed.
            Leaf::Closing => {
                let left = due.map_or(0.0, |due| due.time - self.now);
                self.move_leaf(door, Leaf::Opening, Some(left));
            }
            Leaf::Open => self.admit(door),
            Leaf::Opening => {}
        }
    }

    /// Starts a movement of the leaf, which takes `spared` seconds less than a full movement.
    fn move_leaf(&mut self, door: Entity, leaf: Leaf, spared: Option<f64>) {
        let duration_s = self.get::<DoorState>(door).opening_s - spared.unwrap_or(0.0);
        self.set_door_timer(door, Some(duration_s.max(0.0)));
        self.get_mut::<DoorState>(door).leaf = leaf;
    }

    /// Cancels the door's timer, and sets a new timer if `after_s` is given.
    fn set_door_timer(&mut self, door: Entity, after_s: Option<f64>) {
        let old = self.get_mut::<DoorState>(door).due.take();
        old.into_iter().for_each(|timer| self.queue.cancel(timer));
        let timer = after_s.map(|after| self.schedule(self.now + after, door, 0));
        self.get_mut::<DoorState>(door).due = timer;
    }

    fn finish_leaf(&mut self, door: Entity, leaf: Leaf) {
        let name = {
            let mut doorway = self.get_mut::<DoorState>(door);
            doorway.leaf = leaf;
            doorway.name.clone()
        };
        self.log_event(WorldEvent::DoorMoved { door: name, open: leaf == Leaf::Open });
    }

    /// Admits as many robots as there are slots. Without robots, the door closes after a while.
    fn admit(&mut self, door: Entity) {
        if self.get::<DoorState>(door).leaf != Leaf::Open {
            return;
        }
        let mut entered = Vec::new();
        let (name, is_empty, open_for_s) = {
            let mut doorway = self.get_mut::<DoorState>(door);
            while doorway.inside.len() < doorway.capacity
                && let Some(robot) = doorway.queue.pop_front()
            {
                doorway.inside.push(robot);
                doorway.last_entry_time = self.now;
                entered.push(robot);
            }
            (doorway.name.clone(), doorway.inside.is_empty(), doorway.open_for_s)
        };
        self.set_door_timer(door, is_empty.then_some(open_for_s));
        for robot in entered {
            self.log_event(WorldEvent::DoorEntered { robot: self.robot_id(robot), door: name.clone() });
        }
    }
}
