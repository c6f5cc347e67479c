//! Automatic doors: they open for whoever stands before them, let in so many at a time, and close behind the last.
//!
//! ```text
//!            DoorAwaited                      DoorEntered
//!  driving ──────────────▶ queue of the door ─────────────▶ driving … ── DoorLeft ──▶ the next one, or the door closes
//! ```
//!
//! Who came first is let in first. A robot that stops dead in a doorway keeps the door open and its place taken.

use crate::world::components::SimRobot;
use crate::world::environment_setup::DoorSetup;
use crate::world::event_log::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use consort_protocol::ids::RobotId;
use hecs::Entity;
use std::collections::{BTreeMap, VecDeque};

/// The doors of the floor, by name.
pub(crate) struct DoorsByName(BTreeMap<String, Entity>);

/// One door.
pub(crate) struct DoorState {
    pub(crate) name: String,
    opening_s: f64,
    open_for_s: f64,
    capacity: usize,
    leaf: Leaf,
    /// The end of what the leaf does, or of its standing open for nobody.
    due: Option<TimerId>,
    inside: Vec<Entity>,
    queue: VecDeque<Entity>,
    /// When it last let somebody in.
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
        kinds![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![DoorState, DoorsByName]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        let mut doors = BTreeMap::new();
        for door in setup.map.doors() {
            let told = setup.doors.iter().find(|told| told.name == door.name);
            let DoorSetup { capacity, open_for_s, .. } =
                told.cloned().unwrap_or_else(|| DoorSetup::named(door.name.clone()));
            let entity = floor.spawn();
            floor.insert(
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
        floor.insert_resource(DoorsByName(doors));
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { entity: door, .. }: SystemTimer) {
        floor.get_mut::<DoorState>(door).due = None;
        let leaf = floor.get::<DoorState>(door).leaf;
        match leaf {
            Leaf::Opening => {
                floor.door_stands(door, Leaf::Open);
                floor.let_in(door);
            }
            // Nobody came while it stood open.
            Leaf::Open => floor.move_leaf(door, Leaf::Closing, None),
            Leaf::Closing => floor.door_stands(door, Leaf::Closed),
            Leaf::Closed => {}
        }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        match what {
            WorldEvent::DoorRequested { robot, door } => {
                if let Some((robot, door)) = floor.at_door(robot, door) {
                    floor.queue_at(robot, door);
                }
            }
            WorldEvent::DoorLeft { robot, door } => {
                if let Some((robot, door)) = floor.at_door(robot, door) {
                    {
                        let mut doorway = floor.get_mut::<DoorState>(door);
                        doorway.inside.retain(|other| *other != robot);
                        doorway.queue.retain(|other| *other != robot);
                    }
                    floor.let_in(door);
                }
            }
            _ => {}
        }
    }
}

impl SimState {
    /// The door of a name, if doors are among what happens here.
    pub(crate) fn door_entity(&self, name: &str) -> Option<Entity> {
        if self.has_resource::<DoorsByName>() { self.resource::<DoorsByName>().0.get(name).copied() } else { None }
    }

    /// Each door and how its leaf is: `closed`, `opening`, `open` or `closing`.
    pub(crate) fn door_states(&self) -> Vec<(String, &'static str)> {
        if !self.has_resource::<DoorsByName>() {
            return vec![];
        }
        let word = |door: &Entity| match self.get::<DoorState>(*door).leaf {
            Leaf::Closed => "closed",
            Leaf::Opening => "opening",
            Leaf::Open => "open",
            Leaf::Closing => "closing",
        };
        self.resource::<DoorsByName>().0.iter().map(|(name, door)| (name.clone(), word(door))).collect()
    }

    fn at_door(&self, robot: &RobotId, door: &str) -> Option<(Entity, Entity)> {
        Some((*self.robots.get(robot)?, self.door_entity(door)?))
    }

    fn queue_at(&mut self, robot: Entity, door: Entity) {
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
            // It is as far from open as it has come on its way to closed.
            Leaf::Closing => {
                let left = due.map_or(0.0, |due| due.time - self.now);
                self.move_leaf(door, Leaf::Opening, Some(left));
            }
            Leaf::Open => self.let_in(door),
            Leaf::Opening => {}
        }
    }

    /// Sets the leaf in motion; `spared` seconds of the way need not be gone.
    fn move_leaf(&mut self, door: Entity, leaf: Leaf, spared: Option<f64>) {
        let takes = self.get::<DoorState>(door).opening_s - spared.unwrap_or(0.0);
        self.door_due(door, Some(takes.max(0.0)));
        self.get_mut::<DoorState>(door).leaf = leaf;
    }

    /// What was due is so no longer; something else may be after a while.
    fn door_due(&mut self, door: Entity, after_s: Option<f64>) {
        let old = self.get_mut::<DoorState>(door).due.take();
        old.into_iter().for_each(|ticket| self.queue.cancel(ticket));
        let ticket = after_s.map(|after| self.schedule(self.now + after, door, 0));
        self.get_mut::<DoorState>(door).due = ticket;
    }

    fn door_stands(&mut self, door: Entity, leaf: Leaf) {
        let name = {
            let mut doorway = self.get_mut::<DoorState>(door);
            doorway.leaf = leaf;
            doorway.name.clone()
        };
        self.log_event(WorldEvent::DoorMoved { door: name, open: leaf == Leaf::Open });
    }

    /// Lets in as many as there is room for; if there is nobody, the door closes after a while.
    fn let_in(&mut self, door: Entity) {
        if self.get::<DoorState>(door).leaf != Leaf::Open {
            return;
        }
        let mut entered = Vec::new();
        let (name, deserted, waits) = {
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
        self.door_due(door, deserted.then_some(waits));
        for robot in entered {
            self.log_event(WorldEvent::DoorEntered { robot: self.robot_id(robot), door: name.clone() });
        }
    }
}
