//! Lifts: called to a stop, they open, take in whom they have room for, and go.
//!
//! ```text
//!            LiftAwaited                    LiftEntered                     LiftLeft
//!  driving ──────────────▶ calls of a lift ─────────────▶ riding, a while ───────────▶ driving
//! ```
//!
//! The cabin always goes where the oldest call wants it: to the stop where the caller waits or, once it is in, to where
//! it wants to go. At each stop others get in as long as there is room, but they leave one free for whoever
//! called before them and waits elsewhere. So everybody gets in.

use crate::map::PlaceIndex;
use crate::world::components::SimRobot;
use crate::world::event_log::WorldEvent;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use consort_protocol::ids::PlaceId;
use hecs::Entity;
use std::collections::BTreeMap;

/// The lifts of the floor, by name.
pub(crate) struct LiftsByName(BTreeMap<String, Entity>);

/// One lift.
pub(crate) struct Cabin {
    name: String,
    capacity: usize,
    opening_s: f64,
    /// Where it stands, or comes from.
    at: PlaceIndex,
    phase: Phase,
    /// By the running number of the call.
    calls: BTreeMap<u64, Call>,
    next_call: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// It stands with closed doors, and nobody wants it.
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

    /// Where the oldest call that can be served wants it.
    fn wanted(&self) -> Option<PlaceIndex> {
        let full = self.riders() >= self.capacity;
        let call = self.calls.values().find(|call| call.riding || !full)?;
        Some(if call.riding { call.to } else { call.from })
    }

    /// Those who want out here, out of the calls.
    fn let_out(&mut self) -> Vec<Entity> {
        let here = self.at;
        let out: Vec<u64> =
            self.calls.iter().filter(|(_, call)| call.riding && call.to == here).map(|(number, _)| *number).collect();
        out.into_iter().filter_map(|number| self.calls.remove(&number)).map(|call| call.robot).collect()
    }

    /// Those who get in here.
    fn take_in(&mut self) -> Vec<Entity> {
        let (mut riders, mut left_behind, mut taken) = (self.riders(), 0, Vec::new());
        for call in self.calls.values_mut().filter(|call| !call.riding) {
            if call.from != self.at {
                left_behind = 1;
            } else if riders + left_behind < self.capacity {
                call.riding = true;
                riders += 1;
                taken.push(call.robot);
            }
        }
        taken
    }
}

/// See the [module](self).
pub(crate) struct Lifts;

impl System for Lifts {
    fn name(&self) -> &'static str {
        "lifts"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![Cabin, LiftsByName]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        let mut lifts = BTreeMap::new();
        for lift in setup.map.lifts() {
            let at = lift.stops.first().and_then(|stop| setup.map.index(stop)).expect("a sound lift has stops");
            let entity = floor.spawn();
            let cabin = Cabin {
                name: lift.name.clone(),
                capacity: lift.capacity as usize,
                opening_s: lift.opening.get(),
                at,
                phase: Phase::Idle,
                calls: BTreeMap::new(),
                next_call: 0,
            };
            floor.insert(entity, cabin);
            lifts.insert(lift.name.clone(), entity);
        }
        floor.insert_resource(LiftsByName(lifts));
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { entity: lift, .. }: SystemTimer) {
        let phase = floor.get::<Cabin>(lift).phase;
        match phase {
            Phase::Moving(to) => {
                floor.get_mut::<Cabin>(lift).at = to;
                floor.lift_does(lift, Phase::Opening);
            }
            Phase::Opening => {
                floor.exchange_riders(lift);
                floor.lift_does(lift, Phase::Closing);
            }
            Phase::Closing => floor.send_lift(lift),
            Phase::Idle => {}
        }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        match what {
            WorldEvent::LiftRequested { robot, lift, at, to } => {
                let ends = floor.map.index(at).zip(floor.map.index(to));
                let robot = floor.robots.get(robot).copied();
                if let (Some(lift), Some(robot), Some((from, to))) = (floor.lift(lift), robot, ends) {
                    floor.call_lift(lift, Call { robot, from, to, riding: false });
                }
            }
            WorldEvent::LiftLeft { robot, lift, .. } => {
                let robot = floor.robots.get(robot).copied();
                if let (Some(lift), Some(robot)) = (floor.lift(lift), robot) {
                    floor.get_mut::<Cabin>(lift).calls.retain(|_, call| call.robot != robot || call.riding);
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

    /// The lift that goes from one place to the other, if lifts are among what happens here.
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
            self.send_lift(lift);
        }
    }

    /// Its doors are closed: it goes where it is wanted, or stays.
    fn send_lift(&mut self, lift: Entity) {
        let next = {
            let cabin = self.get::<Cabin>(lift);
            match cabin.wanted() {
                None => Phase::Idle,
                Some(stop) if stop == cabin.at => Phase::Opening,
                Some(stop) => Phase::Moving(stop),
            }
        };
        self.lift_does(lift, next);
    }

    fn lift_does(&mut self, lift: Entity, phase: Phase) {
        let takes = {
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
        self.schedule(self.now + takes, lift, 0);
    }

    fn exchange_riders(&mut self, lift: Entity) {
        let (name, at, out, taken) = {
            let mut cabin = self.get_mut::<Cabin>(lift);
            let out = cabin.let_out();
            (cabin.name.clone(), self.map.place_at(cabin.at).id.clone(), out, cabin.take_in())
        };
        for robot in out {
            self.log_event(WorldEvent::LiftLeft { robot: self.robot_id(robot), lift: name.clone(), at: at.clone() });
        }
        for robot in taken {
            self.log_event(WorldEvent::LiftEntered { robot: self.robot_id(robot), lift: name.clone() });
        }
    }
}
