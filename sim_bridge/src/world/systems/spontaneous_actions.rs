//! People who change their minds: they call a mission off, decline, or walk away, each at moments that the setup names.
//!
//! Whether something comes over a person is drawn from a generator of her own, apart from the one for how long she takes.
//! What she does then is said in news; [`people`](super::people) hears it and breaks off what she has under way.

use crate::world::World;
use crate::world::components::{PersonInfo, SimRobot};
use crate::world::event_log::WorldEvent;
use crate::world::names::PersonName;
use crate::world::samples::SampleHolder;
use crate::world::setup::WorldSetup;
use crate::world::sim_state::SimState;
use crate::world::spontaneous_action::{PersonAction, PersonTrigger, SpontaneousAction};
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use consort_protocol::ids::RobotId;
use consort_skills::actions::BackendEvent;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::collections::{BTreeMap, BTreeSet};

/// The streams of people's generators for what comes over them begin here; those for their pace are below.
const STREAMS: u64 = 1 << 32;

/// All that is on people's minds.
pub(crate) struct PersonStates {
    of: BTreeMap<PersonName, Mind>,
    /// What is to be done later, by a running number.
    intents: BTreeMap<u64, Intent>,
    next: u64,
    /// Those who are not at their places.
    away: BTreeSet<PersonName>,
    /// Who has called a mission off for which a robot came: it gets nothing until it comes anew.
    done_with: BTreeSet<(PersonName, RobotId)>,
}

struct Mind {
    moods: Vec<SpontaneousAction>,
    chance: ChaCha8Rng,
}

#[derive(Clone)]
enum Intent {
    Does { person: PersonName, does: PersonAction, robot: Option<RobotId>, back_after_s: Option<f64> },
    ComesBack(PersonName),
}

/// See the [module](self).
pub(crate) struct SpontaneousActions;

impl System for SpontaneousActions {
    fn name(&self) -> &'static str {
        "moods"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![SimRobot, PersonInfo]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![PersonStates]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        let mind = |(index, person): (usize, &crate::world::setup::PersonSetup)| {
            let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
            chance.set_stream(STREAMS + index as u64);
            (person.name.clone(), Mind { moods: person.mood.clone(), chance })
        };
        let of: BTreeMap<_, _> = setup.people.iter().enumerate().map(mind).collect();
        let people: Vec<PersonName> = of.keys().cloned().collect();
        let (intents, away, done_with) = (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        floor.insert_resource(PersonStates { of, intents, next: 0, away, done_with });
        for person in people {
            floor.comes_over(&person, PersonTrigger::Waiting, None);
        }
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        let intent = floor.resource_mut::<PersonStates>().intents.remove(&number);
        match intent {
            Some(Intent::Does { person, does, robot, back_after_s }) => floor.do_it(&person, does, robot, back_after_s),
            Some(Intent::ComesBack(person)) => floor.come_back(&person),
            None => {}
        }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        match what {
            WorldEvent::Approached { robot, person, authenticated } => {
                if !authenticated {
                    floor.resource_mut::<PersonStates>().done_with.remove(&(person.clone(), robot.clone()));
                }
                let moment = if *authenticated { PersonTrigger::Authenticated } else { PersonTrigger::Approached };
                floor.comes_over(person, moment, Some(robot.clone()));
            }
            WorldEvent::HandoverStarted { person, robot } => {
                floor.comes_over(person, PersonTrigger::HandingOver, Some(robot.clone()));
            }
            WorldEvent::SampleMoved { from: SampleHolder::Person(person), to: SampleHolder::Drawer(robot), .. } => {
                floor.comes_over(person, PersonTrigger::HandedOver, Some(robot.clone()));
            }
            _ => {}
        }
    }
}

impl World {
    /// Has a person do something now, whatever the setup says: to the robot that came to her, if it is about one. A person
    /// who is not here does nothing.
    pub fn trigger_person_action(&mut self, person: &PersonName, does: PersonAction, robot: Option<&RobotId>) {
        self.run_as(&SpontaneousActions, |floor| floor.do_it(person, does, robot.cloned(), None));
    }

    /// Has a person who is away be back at her place now. One who is not away stays where she is.
    pub fn return_person(&mut self, person: &PersonName) {
        self.run_as(&SpontaneousActions, |floor| floor.come_back(person));
    }
}

impl SimState {
    /// Whether a person is at her place.
    pub(crate) fn is_present(&self, person: &PersonName) -> bool {
        !self.has_resource::<PersonStates>() || !self.resource::<PersonStates>().away.contains(person)
    }

    /// Whether a person has something left for a robot that came.
    pub(crate) fn is_willing(&self, person: &PersonName, robot: &RobotId) -> bool {
        !self.has_resource::<PersonStates>()
            || !self.resource::<PersonStates>().done_with.contains(&(person.clone(), robot.clone()))
    }

    /// Things have come so far: each mood that there may be now is drawn for.
    fn comes_over(&mut self, person: &PersonName, moment: PersonTrigger, robot: Option<RobotId>) {
        let mut felt = Vec::new();
        if let Some(mind) = self.resource_mut::<PersonStates>().of.get_mut(person) {
            let moods: Vec<SpontaneousAction> = mind.moods.iter().filter(|mood| mood.at == moment).copied().collect();
            felt.extend(moods.into_iter().filter(|mood| mind.chance.random_bool(mood.probability)));
        }
        for SpontaneousAction { does, after_s, back_after_s, .. } in felt {
            let intent = Intent::Does { person: person.clone(), does, robot: robot.clone(), back_after_s };
            self.intend(after_s, intent);
        }
    }

    fn intend(&mut self, after_s: f64, intent: Intent) {
        let number = {
            let mut minds = self.resource_mut::<PersonStates>();
            let number = minds.next;
            minds.next += 1;
            minds.intents.insert(number, intent);
            number
        };
        let about = self.resource_entity();
        self.schedule(self.now + after_s, about, number);
    }

    fn do_it(&mut self, person: &PersonName, does: PersonAction, robot: Option<RobotId>, back_after_s: Option<f64>) {
        match (does, robot) {
            (PersonAction::Cancels, Some(robot)) => {
                let fresh = self.resource_mut::<PersonStates>().done_with.insert((person.clone(), robot.clone()));
                let Some(role) = self.role_of(person).filter(|_| fresh) else { return };
                self.log_event(WorldEvent::MissionCanceled { person: person.clone(), robot: robot.clone() });
                self.emit(BackendEvent::MissionCanceled { by: person.to_string(), role, robot });
            }
            (PersonAction::Declines, Some(robot)) => {
                self.log_event(WorldEvent::HandoverDeclined { person: person.clone(), robot })
            }
            (PersonAction::WalksAway, _) if !self.people.contains_key(person) => {}
            (PersonAction::WalksAway, _) => {
                if !self.resource_mut::<PersonStates>().away.insert(person.clone()) {
                    return;
                }
                self.log_event(WorldEvent::PersonLeft { person: person.clone() });
                if let Some(back) = back_after_s {
                    self.intend(back, Intent::ComesBack(person.clone()));
                }
            }
            (PersonAction::Cancels | PersonAction::Declines, None) => {}
        }
    }

    fn come_back(&mut self, person: &PersonName) {
        if self.resource_mut::<PersonStates>().away.remove(person) {
            self.log_event(WorldEvent::PersonReturned { person: person.clone() });
        }
    }

    fn role_of(&self, person: &PersonName) -> Option<consort_protocol::ids::RoleId> {
        self.people.get(person).map(|person| self.get::<PersonInfo>(*person).role.clone())
    }
}
