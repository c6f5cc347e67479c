//! Lifts: a lift comes to a stop when called, opens, takes in robots up to its capacity, and
//! leaves.
//!
//! ```text
//!            LiftRequested                    LiftEntered                     LiftLeft
//!  driving ──────────────▶ calls of a lift ─────────────▶ riding, a while ───────────▶ driving
//! ```
//!
//! The cabin always serves the oldest call: it moves to the stop where the caller waits or, once
//! the caller is inside, to the caller's destination. At each stop other robots enter while there
//! is room, but they leave a slot free if an earlier caller waits elsewhere. Every caller is
//! therefore served.

use crate::component_types;
use crate::map::PlaceIndex;
use crate::world::components::SimRobot;
use crate::world::event::WorldEvent;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use consort_protocol::ids::PlaceId;
use hecs::Entity;
use std::collections::BTreeMap;

/// Lifts by name.
pub(crate) struct LiftsByName(BTreeMap<String, Entity>);

/// State of a lift.
pub(crate) struct Cabin {
    name: String,
    capacity: usize,
    opening_s: f64,
    /// Current or last stop.
    at: PlaceIndex,
    phase: Phase,
    /// Calls by sequence number.
    calls: BTreeMap<u64, Call>,
    next_call: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Doors closed, no calls.
    Idle,
    Opening,
    Closing,
    Moving(PlaceIndex),
}

#[derive(Debug, Clone, Copy)]
struct Call {
    robot: Entity,
    from: PlaceIndex,
    to: PlaceIndex,
    riding: bool,
}

impl Cabin {
    fn riders(&self) -> usize {
        self.calls.values().filter(|call| call.riding).count()
    }

    /// Returns the stop for the oldest call that can be served.
    fn next_destination(&self) -> Option<PlaceIndex> {
        let full = self.riders() >= self.capacity;
        let call = self.calls.values().find(|call| call.riding || !full)?;
        Some(if call.riding { call.to } else { call.from })
    }

    /// Removes the calls that end here, and returns their robots.
    fn exit_riders(&mut self) -> Vec<Entity> {
        let here = self.at;
        let left_lift: Vec<u64> =
            self.calls.iter().filter(|(_, call)| call.riding && call.to == here).map(|(number, _)| *number).collect();
        left_lift.into_iter().filter_map(|number| self.calls.remove(&number)).map(|call| call.robot).collect()
    }

    /// Marks the calls that start here as riding, and returns their robots.
    fn board_riders(&mut self) -> Vec<Entity> {
        let (mut riders, mut left_behind, mut entered) = (self.riders(), 0, Vec::new());
        for call in self.calls.values_mut().filter(|call| !call.riding) {
            if call.from != self.at {
                left_behind = 1;
            } else if riders + left_behind < self.capacity {
                call.riding = true;
                riders += 1;
                entered.push(call.robot);
            }
        }
        entered
    }
}

/// See the [module](self).
pub(crate) struct Lifts;

impl System for Lifts {
    fn name(&self) -> &'static str {
        "lifts"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![Cabin, LiftsByName]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let mut lifts = BTreeMap::new();
        for lift in setup.map.lifts() {
            let at = lift.stops.first().and_then(|stop| setup.map.index(stop)).expect("a valid lift has stops");
            let entity = state.spawn();
            let cabin = Cabin {
                name: lift.name.clone(),
                capacity: lift.capacity as usize,
                opening_s: lift.opening.get(),
                at,
                phase: Phase::Idle,
                calls: BTreeMap::new(),
                next_call: 0,
            };
            state.insert(entity, cabin);
            lifts.insert(lift.name.clone(), entity);
        }
        state.insert_resource(LiftsByName(lifts));
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { entity: lift, .. }: SystemTimer) {
        let phase = state.get::<Cabin>(lift).phase;
        match phase {
            Phase::Moving(to) => {
                state.get_mut::<Cabin>(lift).at = to;
                state.set_phase(lift, Phase::Opening);
            }
            Phase::Opening => {
                state.exchange_riders(lift);
                state.set_phase(lift, Phase::Closing);
            }
            Phase::Closing => state.dispatch_lift(lift),
            Phase::Idle => {}
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        match event {
            WorldEvent::LiftRequested { robot, lift, at, to } => {
                let ends = state.map.index(at).zip(state.map.index(to));
                let robot = state.robots.get(robot).copied();
                if let (Some(lift), Some(robot), Some((from, to))) = (state.lift(lift), robot, ends) {
                    state.call_lift(lift, Call { robot, from, to, riding: false });
                }
            }
            WorldEvent::LiftLeft { robot, lift, .. } => {
                let robot = state.robots.get(robot).copied();
                if let (Some(lift), Some(robot)) = (state.lift(lift), robot) {
                    state.get_mut::<Cabin>(lift).calls.retain(|_, call| call.robot != robot || call.riding);
                }
            }
            _ => {}
        }
    }
}

impl SimState {
    fn lift(&self, name: &str) -> Option<Entity> {
        self.resource::<LiftsByName>().0.get(name).copied()
    }

    /// Returns the lift between two places, if the world has the lifts system.
    pub(crate) fn lift_between(&self, from: &PlaceId, to: &PlaceId) -> Option<String> {
        let ride = self.map.ride(from, to)?;
        self.has_resource::<LiftsByName>().then(|| ride.lift.name.clone())
    }

    fn call_lift(&mut self, lift: Entity, call: Call) {
        let idle = {
            let mut cabin = self.get_mut::<Cabin>(lift);
            let number = cabin.next_call;
            cabin.next_call += 1;
            cabin.calls.insert(number, call);
            cabin.phase == Phase::Idle
        };
        if idle {
            self.dispatch_lift(lift);
        }
    }

    /// After the doors have closed: moves to the next stop, or stays.
    fn dispatch_lift(&mut self, lift: Entity) {
        let next = {
            let cabin = self.get::<Cabin>(lift);
            match cabin.next_destination() {
                None => Phase::Idle,
                Some(stop) if stop == cabin.at => Phase::Opening,
                Some(stop) => Phase::Moving(stop),
            }
        };
        self.set_phase(lift, next);
    }

    fn set_phase(&mut self, lift: Entity, phase: Phase) {
        let duration_s = {
            let mut cabin = self.get_mut::<Cabin>(lift);
            cabin.phase = phase;
            match phase {
                Phase::Idle => return,
                Phase::Opening | Phase::Closing => cabin.opening_s,
                Phase::Moving(to) => {
                    let (from, to) = (&self.map.place_at(cabin.at).id, &self.map.place_at(to).id);
                    let ride = self.map.ride(from, to).map_or(0.0, |ride| ride.time.get());
                    (ride - 2.0 * cabin.opening_s).max(0.0)
                }
            }
        };
        self.schedule(self.now + duration_s, lift, 0);
    }

    fn exchange_riders(&mut self, lift: Entity) {
        let (name, at, left_lift, entered) = {
            let mut cabin = self.get_mut::<Cabin>(lift);
            let left_lift = cabin.exit_riders();
            (cabin.name.clone(), self.map.place_at(cabin.at).id.clone(), left_lift, cabin.board_riders())
        };
        for robot in left_lift {
            self.log_event(WorldEvent::LiftLeft { robot: self.robot_id(robot), lift: name.clone(), at: at.clone() });
        }
        for robot in entered {
            self.log_event(WorldEvent::LiftEntered { robot: self.robot_id(robot), lift: name.clone() });
        }
    }
}
