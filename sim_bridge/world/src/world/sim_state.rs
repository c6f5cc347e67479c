//! The simulation state: entities and resources, the clock, and the event queue.
//!
//! Systems access the world only through it. A system requests effects by commands. The commands
//! are executed in turn once the system has returned, so no system calls another.

use super::event::{EventLog, WorldEvent};
use super::event_queue::{EventQueue, TimerId};
use super::location::RobotLocation;
use super::names::{PersonName, SampleId};
use super::setup::{Durations, WorldLimits};
use super::system_access::{ComponentType, RunningSystem, SystemIndex, SystemTimer};
use crate::kinematics::NamedChassis;
use crate::map::Map;
use crate::space::WallGrid;
use consort_protocol::charging_curve::ChargingCurve;
use consort_protocol::ids::{ActionName, PlaceId, RobotId};
use consort_protocol::pose::Pose;
use consort_protocol::units::Watts;
use consort_skills::actions::{ActionError, BackendEvent};
use hecs::{Component, Entity, Fetch, Query, QueryMut, Ref, RefMut};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::num::NonZeroUsize;

/// An entry of the event queue.
pub(crate) enum ScheduledEvent {
    /// Emit an event that was decided earlier.
    Emit(Box<BackendEvent>),
    /// A robot's goal ends.
    GoalEnds(Entity),
    /// A timer of a system.
    SystemTimer(SystemIndex, SystemTimer),
    /// A grid instant, at which the world steps.
    Step,
}

/// A command of a system to the world.
pub(crate) enum SimCommand {
    /// Emit an event to the backend's client.
    Emit(BackendEvent),
    /// Log an event.
    Log(WorldEvent),
    /// Abort the active goal, if any.
    AbortGoal(Entity, ActionError),
    /// Complete the active goal, if any.
    CompleteGoal(Entity),
}

/// The simulation state, as systems access it.
pub struct SimState {
    pub(crate) map: Map,
    /// Walls by level.
    pub(crate) walls: Vec<WallGrid>,
    /// Seconds since the world began.
    pub(crate) now: f64,
    pub(crate) robots: BTreeMap<RobotId, Entity>,
    pub(crate) people: BTreeMap<PersonName, Entity>,
    pub(crate) samples: BTreeMap<SampleId, Entity>,
    pub(crate) durations: Durations,
    pub(crate) limits: WorldLimits,
    /// Chargers besides those of the map, with their powers.
    pub(crate) chargers: BTreeMap<PlaceId, Option<Watts>>,
    /// Charging curve of all batteries.
    pub(crate) charging_curve: ChargingCurve,
    /// Discharge during goals of actions, as multiples of the robots' rates.
    pub(crate) discharge_of_actions: BTreeMap<ActionName, f64>,
    /// Actions that give a robot a full battery.
    pub(crate) renewing_actions: BTreeSet<ActionName>,
    /// Chassis of the program itself.
    pub(crate) own_chassis: &'static [NamedChassis],
    /// Greatest number of threads that move robots with kinematics.
    pub(crate) threads: NonZeroUsize,
    pub(crate) queue: EventQueue<ScheduledEvent>,
    pub(crate) commands: VecDeque<SimCommand>,
    /// Events that the systems have not observed yet.
    pub(crate) unobserved_events: VecDeque<WorldEvent>,
    pub(super) event_log: EventLog,
    store: hecs::World,
    /// The entity that holds the resources.
    resource_entity: Entity,
    running: Option<RunningSystem>,
    /// Step of the time grid, in seconds.
    step_s: f64,
    /// True while a grid instant is in the queue.
    step_scheduled: bool,
}

impl SimState {
    pub(super) fn new(map: Map, durations: Durations, limits: WorldLimits, step_s: f64) -> SimState {
        let mut store = hecs::World::new();
        let resource_entity = store.spawn(());
        let walls = map.level_indices().map(|level| WallGrid::new(map.walls_on(level))).collect();
        SimState {
            map,
            walls,
            now: 0.0,
            robots: BTreeMap::new(),
            people: BTreeMap::new(),
            samples: BTreeMap::new(),
            durations,
            limits,
            chargers: BTreeMap::new(),
            charging_curve: ChargingCurve::default(),
            discharge_of_actions: BTreeMap::new(),
            renewing_actions: BTreeSet::new(),
            own_chassis: &[],
            threads: NonZeroUsize::MIN,
            queue: EventQueue::new(),
            commands: VecDeque::new(),
            unobserved_events: VecDeque::new(),
            event_log: EventLog::default(),
            store,
            resource_entity,
            running: None,
            step_s,
            step_scheduled: false,
        }
    }

    /// Runs `work` as a system. Only the components that the system declares can be accessed.
    pub(super) fn run_as_system<T>(&mut self, running: RunningSystem, work: impl FnOnce(&mut SimState) -> T) -> T {
        let previous = self.running.replace(running);
        let done = work(self);
        self.running = previous;
        done
    }

    /// Returns the time since the world began, in seconds.
    pub fn now_s(&self) -> f64 {
        self.now
    }

    /// Returns the map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Returns the robots with their entities, ordered by name.
    pub fn robots(&self) -> impl Iterator<Item = (&RobotId, Entity)> {
        self.robots.iter().map(|(id, entity)| (id, *entity))
    }

    /// Returns the present pose of a robot. No declaration is necessary.
    pub fn robot_pose(&self, robot: Entity) -> Pose {
        self.peek::<RobotLocation>(robot).expect("a robot has a location").pose(self.now)
    }

    /// Creates an entity without components.
    pub fn spawn(&mut self) -> Entity {
        self.store.spawn(())
    }

    /// Removes an entity with its components.
    pub(crate) fn despawn(&mut self, entity: Entity) {
        self.store.despawn(entity).expect("the entity is in the world");
    }

    /// Sets a component of an entity, replacing any of the same type.
    pub fn insert<T: Component>(&mut self, entity: Entity, component: T) {
        self.check(ComponentType::of::<T>(), true);
        self.store.insert_one(entity, component).expect("the entity is in the world");
    }

    /// Reads a component that the entity always has.
    pub fn get<T: Component>(&self, entity: Entity) -> Ref<'_, T> {
        self.find(entity).unwrap_or_else(|| panic!("an entity has no component {}", ComponentType::of::<T>().name()))
    }

    /// Writes a component that the entity always has.
    pub fn get_mut<T: Component>(&self, entity: Entity) -> RefMut<'_, T> {
        self.find_mut(entity)
            .unwrap_or_else(|| panic!("an entity has no component {}", ComponentType::of::<T>().name()))
    }

    /// Reads a component, if the entity has it.
    pub fn find<T: Component>(&self, entity: Entity) -> Option<Ref<'_, T>> {
        self.check(ComponentType::of::<T>(), false);
        self.store.get::<&T>(entity).ok()
    }

    /// Writes a component, if the entity has it.
    pub fn find_mut<T: Component>(&self, entity: Entity) -> Option<RefMut<'_, T>> {
        self.check(ComponentType::of::<T>(), true);
        self.store.get::<&mut T>(entity).ok()
    }

    /// Reads a resource.
    pub fn resource<T: Component>(&self) -> Ref<'_, T> {
        self.get(self.resource_entity)
    }

    /// Writes a resource.
    pub fn resource_mut<T: Component>(&self) -> RefMut<'_, T> {
        self.get_mut(self.resource_entity)
    }

    /// Adds a resource.
    pub fn insert_resource<T: Component>(&mut self, component: T) {
        self.insert(self.resource_entity, component);
    }

    /// Checks whether a resource exists, that is, whether the system that adds it is part of this
    /// world.
    pub fn has_resource<T: Component>(&self) -> bool {
        self.store.satisfies::<&T>(self.resource_entity)
    }

    /// Reads a component of a shipped system without a declaration.
    pub(super) fn peek<T: Component>(&self, entity: Entity) -> Option<Ref<'_, T>> {
        self.store.get::<&T>(entity).ok()
    }

    /// Writes a component of a shipped system without a declaration.
    pub(super) fn poke<T: Component>(&self, entity: Entity) -> Option<RefMut<'_, T>> {
        self.store.get::<&mut T>(entity).ok()
    }

    /// The entity that holds the resources.
    pub(crate) fn resource_entity(&self) -> Entity {
        self.resource_entity
    }

    /// Schedules a timer of the running system.
    pub fn schedule(&mut self, time: f64, about: Entity, number: u64) -> TimerId {
        let index = self.running.as_ref().expect("only systems schedule timers").index;
        self.queue.schedule(time, ScheduledEvent::SystemTimer(index, SystemTimer { entity: about, number }))
    }

    /// Lets the world step from the next grid instant on, until no system needs another step.
    pub fn start_stepping(&mut self) {
        if !std::mem::replace(&mut self.step_scheduled, true) {
            // An instant closer than the rounding error is the previous instant.
            let next = (self.now / self.step_s + 1e-6).floor() + 1.0;
            self.queue.schedule(next * self.step_s, ScheduledEvent::Step);
        }
    }

    /// Checks whether the world steps.
    pub(crate) fn is_stepping(&self) -> bool {
        self.step_scheduled
    }

    /// Notes that the grid instant in the queue has come.
    pub(super) fn clear_step(&mut self) {
        self.step_scheduled = false;
    }

    /// Returns all entities that match a query, always in the same order.
    pub fn query<Q: Query>(&mut self) -> QueryMut<'_, Q> {
        if let Some(running) = self.running.as_ref().filter(|_| cfg!(debug_assertions)) {
            <Q::Fetch as Fetch>::for_each_borrow(|id, writes| running.check_id(id, writes));
        }
        self.store.query_mut::<Q>()
    }

    /// Aborts the active goal of a robot, if any.
    pub fn abort_goal(&mut self, robot: Entity, error: ActionError) {
        self.commands.push_back(SimCommand::AbortGoal(robot, error));
    }

    /// Completes the active goal of a robot, if any: for goals that began without a known end.
    pub fn complete_goal(&mut self, robot: Entity) {
        self.commands.push_back(SimCommand::CompleteGoal(robot));
    }

    /// Logs an event after the commands issued before it have been executed.
    pub(crate) fn log_after_commands(&mut self, event: WorldEvent) {
        self.commands.push_back(SimCommand::Log(event));
    }

    /// Emits an event to the backend's client.
    pub(crate) fn emit(&mut self, event: BackendEvent) {
        self.commands.push_back(SimCommand::Emit(event));
    }

    /// Logs an event, and shows it to all systems.
    pub(crate) fn log_event(&mut self, event: WorldEvent) {
        self.event_log.write(self.now, event.clone(), self.limits.history_kept);
        self.unobserved_events.push_back(event);
    }

    fn check(&self, kind: ComponentType, writes: bool) {
        if let Some(running) = self.running.as_ref().filter(|_| cfg!(debug_assertions)) {
            running.check(kind, writes);
        }
    }
}
