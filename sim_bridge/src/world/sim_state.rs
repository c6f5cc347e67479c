//! The floor: what there is, what time it is, and what is due.
//!
//! Systems act on it and on nothing else. What a system asks of another it says in orders, which are carried out in turn
//! once it has ended; so no system calls another.

use super::event_log::{EventLog, WorldEvent};
use super::event_queue::{EventQueue, TimerId};
use super::names::{PersonName, SampleId};
use super::setup::{Durations, WorldLimits};
use super::system::{ComponentType, System, SystemTimer};
use crate::map::Map;
use crate::space::WallGrid;
use consort_protocol::ids::RobotId;
use consort_skills::actions::{ActionError, BackendEvent};
use hecs::{Component, Entity, Fetch, Query, QueryMut, Ref, RefMut};
use std::any::TypeId;
use std::collections::{BTreeMap, VecDeque};

/// What falls due at an instant.
pub(crate) enum ScheduledEvent {
    /// Say what was decided earlier.
    Emit(Box<BackendEvent>),
    /// A robot's goal reaches its end.
    GoalEnds(Entity),
    /// A system, by its place among those of this world, wanted to be woken.
    SystemTimer(usize, SystemTimer),
    /// An instant of the grid in which the world steps.
    Step,
}

/// What a system asks of the world.
pub(crate) enum SimCommand {
    /// Say it.
    Emit(BackendEvent),
    /// Write it down.
    Log(WorldEvent),
    /// The goal under way, if there is one, cannot go on.
    AbortGoal(Entity, ActionError),
    /// The goal under way, if there is one, has come to its end.
    CompleteGoal(Entity),
}

/// A system at work: its place among those of this world, and what it may get at.
struct AtWork {
    place: usize,
    name: &'static str,
    reads: Vec<ComponentType>,
    writes: Vec<ComponentType>,
}

/// See the [module](self).
pub(crate) struct SimState {
    pub(crate) map: Map,
    /// Its walls, by level.
    pub(crate) walls: Vec<WallGrid>,
    /// Seconds since the world began.
    pub(crate) now: f64,
    pub(crate) robots: BTreeMap<RobotId, Entity>,
    pub(crate) people: BTreeMap<PersonName, Entity>,
    pub(crate) samples: BTreeMap<SampleId, Entity>,
    pub(crate) durations: Durations,
    pub(crate) limits: WorldLimits,
    pub(crate) queue: EventQueue<ScheduledEvent>,
    pub(crate) commands: VecDeque<SimCommand>,
    /// What happened and was not yet shown to the systems.
    pub(crate) unobserved_events: VecDeque<WorldEvent>,
    pub(super) event_log: EventLog,
    store: hecs::World,
    /// The entity whose components belong to the floor as a whole.
    here: Entity,
    at_work: Option<AtWork>,
    /// Time between two instants of the grid, in seconds.
    step_s: f64,
    /// Whether an instant of the grid stands in the queue.
    steps: bool,
}

impl SimState {
    pub(super) fn new(map: Map, durations: Durations, limits: WorldLimits, step_s: f64) -> SimState {
        let mut store = hecs::World::new();
        let here = store.spawn(());
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
            queue: EventQueue::new(),
            commands: VecDeque::new(),
            unobserved_events: VecDeque::new(),
            event_log: EventLog::default(),
            store,
            here,
            at_work: None,
            step_s,
            steps: false,
        }
    }

    /// Lets a system, the one at `place`, do something; it is held to the components that it named.
    pub(super) fn run_as_system<T>(
        &mut self,
        place: usize,
        system: &dyn System,
        work: impl FnOnce(&mut SimState) -> T,
    ) -> T {
        // The lists are for the check alone.
        let (reads, writes) = if cfg!(debug_assertions) { (system.reads(), system.writes()) } else { (vec![], vec![]) };
        let before = self.at_work.replace(AtWork { place, name: system.name(), reads, writes });
        let done = work(self);
        self.at_work = before;
        done
    }

    /// An entity without components.
    pub(crate) fn spawn(&mut self) -> Entity {
        self.store.spawn(())
    }

    /// Gives an entity a component, in the place of one of the same type if it has it.
    pub(crate) fn insert<T: Component>(&mut self, entity: Entity, component: T) {
        self.check(ComponentType::of::<T>(), true);
        self.store.insert_one(entity, component).expect("entities stay");
    }

    /// Reads a component of an entity that has it by construction.
    pub(crate) fn get<T: Component>(&self, entity: Entity) -> Ref<'_, T> {
        self.find(entity).unwrap_or_else(|| panic!("an entity was given no {}", ComponentType::of::<T>().name()))
    }

    /// Writes a component of an entity that has it by construction.
    pub(crate) fn get_mut<T: Component>(&self, entity: Entity) -> RefMut<'_, T> {
        self.find_mut(entity).unwrap_or_else(|| panic!("an entity was given no {}", ComponentType::of::<T>().name()))
    }

    /// Reads a component, if the entity has it.
    pub(crate) fn find<T: Component>(&self, entity: Entity) -> Option<Ref<'_, T>> {
        self.check(ComponentType::of::<T>(), false);
        self.store.get::<&T>(entity).ok()
    }

    /// Writes a component, if the entity has it.
    pub(crate) fn find_mut<T: Component>(&self, entity: Entity) -> Option<RefMut<'_, T>> {
        self.check(ComponentType::of::<T>(), true);
        self.store.get::<&mut T>(entity).ok()
    }

    /// Reads a component of the floor itself.
    pub(crate) fn resource<T: Component>(&self) -> Ref<'_, T> {
        self.get(self.here)
    }

    /// Writes a component of the floor itself.
    pub(crate) fn resource_mut<T: Component>(&self) -> RefMut<'_, T> {
        self.get_mut(self.here)
    }

    /// Gives the floor itself a component.
    pub(crate) fn insert_resource<T: Component>(&mut self, component: T) {
        self.insert(self.here, component);
    }

    /// Whether the floor itself has a component: whether the system that brings it is one of this world's.
    pub(crate) fn has_resource<T: Component>(&self) -> bool {
        self.store.satisfies::<&T>(self.here)
    }

    /// The entity that stands for the floor itself.
    pub(crate) fn resource_entity(&self) -> Entity {
        self.here
    }

    /// Has the system at work woken at an instant.
    pub(crate) fn schedule(&mut self, time: f64, about: Entity, number: u64) -> TimerId {
        let place = self.at_work.as_ref().expect("only systems arrange things").place;
        self.queue.schedule(time, ScheduledEvent::SystemTimer(place, SystemTimer { entity: about, number }))
    }

    /// Has the world step from the next instant of its grid on, until no system has anything more to step.
    pub(crate) fn start_stepping(&mut self) {
        if !std::mem::replace(&mut self.steps, true) {
            // An instant that is a hair away is the one that has just been.
            let next = (self.now / self.step_s + 1e-6).floor() + 1.0;
            self.queue.schedule(next * self.step_s, ScheduledEvent::Step);
        }
    }

    /// Whether the world steps.
    pub(crate) fn is_stepping(&self) -> bool {
        self.steps
    }

    /// The instant of the grid has come that stood in the queue.
    pub(super) fn clear_step(&mut self) {
        self.steps = false;
    }

    /// All entities that have what is asked for, always in the same order.
    pub(crate) fn query<Q: Query>(&mut self) -> QueryMut<'_, Q> {
        if let Some(at_work) = self.at_work.as_ref().filter(|_| cfg!(debug_assertions)) {
            <Q::Fetch as Fetch>::for_each_borrow(|id, writes| at_work.check_id(id, writes));
        }
        self.store.query_mut::<Q>()
    }

    /// The goal that a robot has under way, if any, cannot go on.
    pub(crate) fn abort_goal(&mut self, robot: Entity, why: ActionError) {
        self.commands.push_back(SimCommand::AbortGoal(robot, why));
    }

    /// The goal that a robot has under way, if any, has come to its end: for goals that began without one.
    pub(crate) fn complete_goal(&mut self, robot: Entity) {
        self.commands.push_back(SimCommand::CompleteGoal(robot));
    }

    /// Notes what happened once what was ordered before has been done.
    pub(crate) fn log_after_commands(&mut self, what: WorldEvent) {
        self.commands.push_back(SimCommand::Log(what));
    }

    /// Tells the outside.
    pub(crate) fn emit(&mut self, event: BackendEvent) {
        self.commands.push_back(SimCommand::Emit(event));
    }

    /// Writes down what happened, and shows it to all systems.
    pub(crate) fn log_event(&mut self, what: WorldEvent) {
        self.event_log.write(self.now, what.clone(), self.limits.history_kept);
        self.unobserved_events.push_back(what);
    }

    fn check(&self, kind: ComponentType, writes: bool) {
        if let Some(at_work) = self.at_work.as_ref().filter(|_| cfg!(debug_assertions)) {
            at_work.check(kind, writes);
        }
    }
}

impl AtWork {
    fn check(&self, kind: ComponentType, writes: bool) {
        let allowed = self.writes.contains(&kind) || !writes && self.reads.contains(&kind);
        let does = if writes { "writes" } else { "reads" };
        assert!(allowed, "system {} {does} {}, which it does not name", self.name, kind.name());
    }

    /// The same where only the type's number is known.
    fn check_id(&self, id: TypeId, writes: bool) {
        let named = |kinds: &[ComponentType]| kinds.iter().any(|kind| kind.is(id));
        let does = if writes { "writes" } else { "reads" };
        let allowed = named(&self.writes) || !writes && named(&self.reads);
        assert!(allowed, "system {} {does} one of the components it asks for without naming it", self.name);
    }
}
