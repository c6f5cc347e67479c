//! Unrequested actions of people: they cancel a mission, decline, or walk away, at triggers that
//! the setup names.
//!
//! A generator per person decides whether an action is taken; it is separate from the generator for
//! requested tasks. Actions are logged as events. [`people`](super::people) observes them and
//! interrupts handovers.

use crate::component_types;
use crate::world::components::{PersonInfo, SimRobot};
use crate::world::event::{SampleHolder, WorldEvent};
use crate::world::names::PersonName;
use crate::world::setup::WorldSetup;
use crate::world::setup::{PersonAction, PersonTrigger, SpontaneousAction};
use crate::world::sim_state::SimState;
use crate::world::simulation::World;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use consort_protocol::ids::RobotId;
use consort_skills::actions::BackendEvent;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::collections::{BTreeMap, BTreeSet};

/// First random stream for actions of people. The streams for their tasks are below it.
const FIRST_STREAM: u64 = 1 << 32;

/// State of all people with regard to their actions.
pub(crate) struct PersonStates {
    people: BTreeMap<PersonName, PersonState>,
    /// Scheduled actions, by sequence number.
    scheduled: BTreeMap<u64, ScheduledAction>,
    next: u64,
    /// People away from their places.
    away: BTreeSet<PersonName>,
    /// People with the robot of the mission they canceled. The robot receives nothing until it
    /// approaches again.
    refused_robots: BTreeSet<(PersonName, RobotId)>,
}

struct PersonState {
    actions: Vec<SpontaneousAction>,
    rng: ChaCha8Rng,
}

#[derive(Clone)]
enum ScheduledAction {
    Act { person: PersonName, action: PersonAction, robot: Option<RobotId>, back_after_s: Option<f64> },
    Return(PersonName),
}

/// See the [module](self).
pub(crate) struct SpontaneousActions;

impl System for SpontaneousActions {
    fn name(&self) -> &'static str {
        "spontaneous_actions"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![SimRobot, PersonInfo]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![PersonStates]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let person_state = |(index, person): (usize, &crate::world::setup::PersonSetup)| {
            let mut rng = ChaCha8Rng::seed_from_u64(setup.seed);
            rng.set_stream(FIRST_STREAM + index as u64);
            (person.name.clone(), PersonState { actions: person.spontaneous_actions.clone(), rng })
        };
        let people: BTreeMap<_, _> = setup.people.iter().enumerate().map(person_state).collect();
        let names: Vec<PersonName> = people.keys().cloned().collect();
        let (scheduled, away, refused_robots) = (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        state.insert_resource(PersonStates { people, scheduled, next: 0, away, refused_robots });
        for person in names {
            state.evaluate_trigger(&person, PersonTrigger::Waiting, None);
        }
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        let scheduled_action = state.resource_mut::<PersonStates>().scheduled.remove(&number);
        match scheduled_action {
            Some(ScheduledAction::Act { person, action, robot, back_after_s }) => {
                state.act(&person, action, robot, back_after_s);
            }
            Some(ScheduledAction::Return(person)) => state.return_to_place(&person),
            None => {}
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        match event {
            WorldEvent::Approached { robot, person, authenticated } => {
                if !authenticated {
                    state.resource_mut::<PersonStates>().refused_robots.remove(&(person.clone(), robot.clone()));
                }
                let trigger = if *authenticated { PersonTrigger::Authenticated } else { PersonTrigger::Approached };
                state.evaluate_trigger(person, trigger, Some(robot.clone()));
            }
            WorldEvent::HandoverStarted { person, robot } => {
                state.evaluate_trigger(person, PersonTrigger::HandingOver, Some(robot.clone()));
            }
            WorldEvent::SampleMoved { from: SampleHolder::Person(person), to: SampleHolder::Drawer(robot), .. } => {
                state.evaluate_trigger(person, PersonTrigger::HandedOver, Some(robot.clone()));
            }
            _ => {}
        }
    }
}

impl World {
    /// Triggers an action of a person now, regardless of the setup. `robot` is the robot concerned,
    /// if any. An unknown person is ignored.
    pub fn trigger_person_action(&mut self, person: &PersonName, action: PersonAction, robot: Option<&RobotId>) {
        self.run_as(&SpontaneousActions, |state| state.act(person, action, robot.cloned(), None));
    }

    /// Returns a person who is away to their place now. Without effect if the person is not away.
    pub fn return_person(&mut self, person: &PersonName) {
        self.run_as(&SpontaneousActions, |state| state.return_to_place(person));
    }
}

impl SimState {
    /// Checks whether a person is at their place.
    pub(crate) fn is_present(&self, person: &PersonName) -> bool {
        !self.has_resource::<PersonStates>() || !self.resource::<PersonStates>().away.contains(person)
    }

    /// Checks whether a person still serves a robot that came.
    pub(crate) fn is_willing(&self, person: &PersonName, robot: &RobotId) -> bool {
        !self.has_resource::<PersonStates>()
            || !self.resource::<PersonStates>().refused_robots.contains(&(person.clone(), robot.clone()))
    }

    /// Evaluates a trigger: draws for each action that may follow it.
    fn evaluate_trigger(&mut self, person: &PersonName, trigger: PersonTrigger, robot: Option<RobotId>) {
        let mut triggered = Vec::new();
        if let Some(person_state) = self.resource_mut::<PersonStates>().people.get_mut(person) {
            let actions: Vec<SpontaneousAction> =
                person_state.actions.iter().filter(|action| action.trigger == trigger).copied().collect();
            triggered.extend(actions.into_iter().filter(|action| person_state.rng.random_bool(action.probability)));
        }
        for SpontaneousAction { action, after_s, back_after_s, .. } in triggered {
            let scheduled_action =
                ScheduledAction::Act { person: person.clone(), action, robot: robot.clone(), back_after_s };
            self.schedule_action(after_s, scheduled_action);
        }
    }

    fn schedule_action(&mut self, after_s: f64, scheduled_action: ScheduledAction) {
        let number = {
            let mut minds = self.resource_mut::<PersonStates>();
            let number = minds.next;
            minds.next += 1;
            minds.scheduled.insert(number, scheduled_action);
            number
        };
        let about = self.resource_entity();
        self.schedule(self.now + after_s, about, number);
    }

    fn act(&mut self, person: &PersonName, action: PersonAction, robot: Option<RobotId>, back_after_s: Option<f64>) {
        match (action, robot) {
            (PersonAction::Cancels, Some(robot)) => {
                let is_new = self.resource_mut::<PersonStates>().refused_robots.insert((person.clone(), robot.clone()));
                let Some(role) = self.role_of(person).filter(|_| is_new) else { return };
                self.log_event(WorldEvent::MissionCanceled { person: person.clone(), robot: robot.clone() });
                self.emit(BackendEvent::MissionCanceled { by: person.to_string(), role, robot });
            }
            (PersonAction::Declines, Some(robot)) => {
                self.log_event(WorldEvent::HandoverDeclined { person: person.clone(), robot });
            }
            (PersonAction::WalksAway, _) if !self.people.contains_key(person) => {}
            (PersonAction::WalksAway, _) => {
                if !self.resource_mut::<PersonStates>().away.insert(person.clone()) {
                    return;
                }
                self.log_event(WorldEvent::PersonLeft { person: person.clone() });
                if let Some(back) = back_after_s {
                    self.schedule_action(back, ScheduledAction::Return(person.clone()));
                }
            }
            (PersonAction::Cancels | PersonAction::Declines, None) => {}
        }
    }

    fn return_to_place(&mut self, person: &PersonName) {
        if self.resource_mut::<PersonStates>().away.remove(person) {
            self.log_event(WorldEvent::PersonReturned { person: person.clone() });
        }
    }

    fn role_of(&self, person: &PersonName) -> Option<consort_protocol::ids::RoleId> {
        self.people.get(person).map(|person| self.get::<PersonInfo>(*person).role.clone())
    }
}
