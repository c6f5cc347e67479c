//! People who change their minds: they call a mission off, decline, or walk away, each at moments that the setup names.
//!
//! Whether something comes over a person is drawn from a generator of her own, apart from the one for how long she takes.
//! What she does then is said in news; [`people`](super::people) hears it and breaks off what she has under way.

use crate::world::World;
use crate::world::components::{Body, Who};
use crate::world::floor::Floor;
use crate::world::journal::Happening;
use crate::world::mood::{Deed, Moment, Mood};
use crate::world::names::PersonName;
use crate::world::samples::Keeper;
use crate::world::setup::WorldSetup;
use crate::world::system::{Kind, System, Wake, kinds};
use consort_protocol::ids::RobotId;
use consort_skills::actions::BodyEvent;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::collections::{BTreeMap, BTreeSet};

/// The streams of people's generators for what comes over them begin here; those for their pace are below.
const STREAMS: u64 = 1 << 32;

/// All that is on people's minds.
pub(crate) struct Minds {
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
    moods: Vec<Mood>,
    chance: ChaCha8Rng,
}

#[derive(Clone)]
enum Intent {
    Does { person: PersonName, does: Deed, robot: Option<RobotId>, back_after_s: Option<f64> },
    ComesBack(PersonName),
}

/// See the [module](self).
pub(crate) struct Moods;

impl System for Moods {
    fn name(&self) -> &'static str {
        "moods"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Body, Who]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Minds]
    }

    fn furnish(&self, floor: &mut Floor, setup: &WorldSetup) {
        let mind = |(index, person): (usize, &crate::world::setup::Person)| {
            let mut chance = ChaCha8Rng::seed_from_u64(setup.seed);
            chance.set_stream(STREAMS + index as u64);
            (person.name.clone(), Mind { moods: person.mood.clone(), chance })
        };
        let of: BTreeMap<_, _> = setup.people.iter().enumerate().map(mind).collect();
        let people: Vec<PersonName> = of.keys().cloned().collect();
        let (intents, away, done_with) = (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        floor.furnish(Minds { of, intents, next: 0, away, done_with });
        for person in people {
            floor.comes_over(&person, Moment::Waiting, None);
        }
    }

    fn wake(&self, floor: &mut Floor, Wake { number, .. }: Wake) {
        let intent = floor.own_mut::<Minds>().intents.remove(&number);
        match intent {
            Some(Intent::Does { person, does, robot, back_after_s }) => floor.do_it(&person, does, robot, back_after_s),
            Some(Intent::ComesBack(person)) => floor.come_back(&person),
            None => {}
        }
    }

    fn observe(&self, floor: &mut Floor, what: &Happening) {
        match what {
            Happening::Approached { robot, person, authenticated } => {
                if !authenticated {
                    floor.own_mut::<Minds>().done_with.remove(&(person.clone(), robot.clone()));
                }
                let moment = if *authenticated { Moment::Authenticated } else { Moment::Approached };
                floor.comes_over(person, moment, Some(robot.clone()));
            }
            Happening::HandsOut { person, robot } => {
                floor.comes_over(person, Moment::HandingOver, Some(robot.clone()));
            }
            Happening::SampleMoved { from: Keeper::Person(person), to: Keeper::Drawer(robot), .. } => {
                floor.comes_over(person, Moment::HandedOver, Some(robot.clone()));
            }
            _ => {}
        }
    }
}

impl World {
    /// Has a person do something now, whatever the setup says: to the robot that came to her, if it is about one. A person
    /// who is not here does nothing.
    pub fn has_person_do(&mut self, person: &PersonName, does: Deed, robot: Option<&RobotId>) {
        self.have(&Moods, |floor| floor.do_it(person, does, robot.cloned(), None));
    }

    /// Has a person who is away be back at her place now. One who is not away stays where she is.
    pub fn has_person_come_back(&mut self, person: &PersonName) {
        self.have(&Moods, |floor| floor.come_back(person));
    }
}

impl Floor {
    /// Whether a person is at her place.
    pub(crate) fn is_present(&self, person: &PersonName) -> bool {
        !self.has::<Minds>() || !self.own::<Minds>().away.contains(person)
    }

    /// Whether a person has something left for a robot that came.
    pub(crate) fn is_willing(&self, person: &PersonName, robot: &RobotId) -> bool {
        !self.has::<Minds>() || !self.own::<Minds>().done_with.contains(&(person.clone(), robot.clone()))
    }

    /// Things have come so far: each mood that there may be now is drawn for.
    fn comes_over(&mut self, person: &PersonName, moment: Moment, robot: Option<RobotId>) {
        let mut felt = Vec::new();
        if let Some(mind) = self.own_mut::<Minds>().of.get_mut(person) {
            let moods: Vec<Mood> = mind.moods.iter().filter(|mood| mood.at == moment).copied().collect();
            felt.extend(moods.into_iter().filter(|mood| mind.chance.random_bool(mood.probability)));
        }
        for Mood { does, after_s, back_after_s, .. } in felt {
            let intent = Intent::Does { person: person.clone(), does, robot: robot.clone(), back_after_s };
            self.intend(after_s, intent);
        }
    }

    fn intend(&mut self, after_s: f64, intent: Intent) {
        let number = {
            let mut minds = self.own_mut::<Minds>();
            let number = minds.next;
            minds.next += 1;
            minds.intents.insert(number, intent);
            number
        };
        let about = self.here();
        self.arrange(self.now + after_s, about, number);
    }

    fn do_it(&mut self, person: &PersonName, does: Deed, robot: Option<RobotId>, back_after_s: Option<f64>) {
        match (does, robot) {
            (Deed::Cancels, Some(robot)) => {
                let fresh = self.own_mut::<Minds>().done_with.insert((person.clone(), robot.clone()));
                let Some(role) = self.role_of(person).filter(|_| fresh) else { return };
                self.note(Happening::CalledOff { person: person.clone(), robot: robot.clone() });
                self.say(BodyEvent::CalledOff { by: person.to_string(), role, robot });
            }
            (Deed::Declines, Some(robot)) => self.note(Happening::Declined { person: person.clone(), robot }),
            (Deed::WalksAway, _) if !self.people.contains_key(person) => {}
            (Deed::WalksAway, _) => {
                if !self.own_mut::<Minds>().away.insert(person.clone()) {
                    return;
                }
                self.note(Happening::WalkedAway { person: person.clone() });
                if let Some(back) = back_after_s {
                    self.intend(back, Intent::ComesBack(person.clone()));
                }
            }
            (Deed::Cancels | Deed::Declines, None) => {}
        }
    }

    fn come_back(&mut self, person: &PersonName) {
        if self.own_mut::<Minds>().away.remove(person) {
            self.note(Happening::CameBack { person: person.clone() });
        }
    }

    fn role_of(&self, person: &PersonName) -> Option<consort_protocol::ids::RoleId> {
        self.people.get(person).map(|person| self.get::<Who>(*person).role.clone())
    }
}
