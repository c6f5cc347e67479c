//! People who are asked to do something.
//!
//! An ask waits until a robot that holds a role of the mission has approached someone who plays the asked role and
//! stands there with an open drawer. Whom it approached is who hands over: of several nurses, the one where the robot
//! is. She takes her time; if the robot leaves or shuts its drawer meanwhile, she keeps her sample and waits on.
//!
//! While all who play the role are away, an ask waits for one to come back: for the seconds that its task gives in `patience`,
//! or two minutes. A robot that has stayed where it was is beside her again when she is back.

use crate::world::components::{Beside, Body, DrawerOpen, HandsBusy, Label, Pace, Who};
use crate::world::fittings::sample_kg;
use crate::world::floor::Floor;
use crate::world::journal::Happening;
use crate::world::names::PersonName;
use crate::world::queue::Ticket;
use crate::world::reach::refused;
use crate::world::samples::{Custody, Handovers, Holder, Load};
use crate::world::setup::{Person, WorldSetup};
use crate::world::system::{Kind, System, Wake, kinds};
use crate::world::systems::moods::Minds;
use crate::world::whereabouts::Whereabouts;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{AWAY_S, ActionError, BodyEvent, ErrorCode, GoalId, PATIENCE, PersonAsk};
use hecs::Entity;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// What people can do, by task type.
const CAN: &[&str] = &["deposit"];

/// The parameter of a task that names the role whose drawer is meant; without it any robot of the mission may come.
const INTO_ROLE: &str = "into_role";

/// What tells the end of patience from the end of handing over, in the number of a wake.
const IN_VAIN: u64 = 1 << 63;

/// Running number of an ask: earlier ones are served first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct AskNumber(u64);

/// The asks that have not ended, and the ids of those that lately did.
#[derive(Default)]
pub(crate) struct Asks {
    open: BTreeMap<AskNumber, Ask>,
    ids: BTreeMap<GoalId, AskNumber>,
    /// With what came of each; `None` for one that was withdrawn.
    ended: BTreeMap<GoalId, Option<Result<(), ActionError>>>,
    /// The same in the order of their ends.
    ended_order: VecDeque<GoalId>,
    next: u64,
}

struct Ask {
    id: GoalId,
    role: RoleId,
    /// The robots whose drawers will do.
    into: BTreeSet<Entity>,
    under_way: Option<HandingOver>,
    /// How long those who are away are waited for, in seconds.
    patience_s: f64,
    /// While all who could do it are away: when that ends.
    given_up: Option<Ticket>,
}

#[derive(Clone, Copy)]
struct HandingOver {
    person: Entity,
    robot: Entity,
    ends: Ticket,
}

impl Asks {
    fn knows(&self, id: GoalId) -> bool {
        self.ids.contains_key(&id) || self.ended.contains_key(&id)
    }

    fn open(&mut self, ask: Ask) {
        let number = AskNumber(self.next);
        self.next += 1;
        self.ids.insert(ask.id, number);
        self.open.insert(number, ask);
    }

    fn under_way(&self, id: GoalId) -> Option<HandingOver> {
        self.open.get(self.ids.get(&id)?)?.under_way
    }

    /// Those that nobody serves yet, earlier ones first.
    fn waiting(&self) -> Vec<AskNumber> {
        self.open.iter().filter(|(_, ask)| ask.under_way.is_none()).map(|(number, _)| *number).collect()
    }

    fn close(&mut self, id: GoalId, result: Option<Result<(), ActionError>>, kept: usize) {
        if let Some(number) = self.ids.remove(&id) {
            self.open.remove(&number);
        }
        if self.ended.insert(id, result).is_none() {
            self.ended_order.push_back(id);
        }
        if self.ended.len() > kept
            && let Some(oldest) = self.ended_order.pop_front()
        {
            self.ended.remove(&oldest);
        }
    }

    /// Those that have not ended, earlier ones first.
    pub(crate) fn unended(&self) -> Vec<GoalId> {
        self.open.values().map(|ask| ask.id).collect()
    }

    /// Whether an ask was lately withdrawn.
    pub(crate) fn was_withdrawn(&self, id: GoalId) -> bool {
        self.ended.get(&id).is_some_and(Option::is_none)
    }

    /// What came of an ask that lately ended.
    pub(crate) fn answer(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        self.ended.get(&id).cloned().flatten()
    }
}

/// See the [module](self).
pub(crate) struct People;

impl System for People {
    fn name(&self) -> &'static str {
        "people"
    }

    fn reads(&self) -> Vec<Kind> {
        kinds![Beside, Body, DrawerOpen, Minds, Whereabouts]
    }

    fn writes(&self) -> Vec<Kind> {
        kinds![Asks, Custody, HandsBusy, Handovers, Label, Load, Pace, Who]
    }

    fn furnish(&self, floor: &mut Floor, setup: &WorldSetup) {
        floor.furnish(Asks::default());
        for (index, person) in setup.people.iter().enumerate() {
            let mut pace = ChaCha8Rng::seed_from_u64(setup.seed);
            pace.set_stream(index as u64);
            floor.spawn_person(person, pace);
        }
    }

    fn ask(&self, floor: &mut Floor, id: GoalId, ask: &PersonAsk) -> bool {
        floor.take_ask(id, ask);
        true
    }

    fn dismiss(&self, floor: &mut Floor, id: GoalId) {
        floor.withdraw(id);
    }

    fn wake(&self, floor: &mut Floor, Wake { number, .. }: Wake) {
        match number & IN_VAIN {
            0 => floor.handed_over(AskNumber(number)),
            _ => floor.give_up_waiting(AskNumber(number & !IN_VAIN)),
        }
    }

    fn observe(&self, floor: &mut Floor, what: &Happening) {
        match what {
            Happening::GoalEnded { .. } => floor.serve_asks(),
            Happening::CameBack { .. } => {
                floor.mind_who_is_away();
                floor.serve_asks();
            }
            Happening::CalledOff { person, robot } => {
                floor.hold_back(person, Some(robot));
                floor.serve_asks();
            }
            Happening::Declined { person, robot } => {
                if let Some(id) = floor.hold_back(person, Some(robot)) {
                    let why = refused(ErrorCode::NotAuthenticated, format!("{person} declines"));
                    floor.end_ask(id, Err(why));
                    floor.serve_asks();
                }
            }
            Happening::WalkedAway { person } => {
                floor.hold_back(person, None);
                floor.mind_who_is_away();
                floor.serve_asks();
            }
            _ => {}
        }
    }
}

impl Floor {
    fn spawn_person(&mut self, person: &Person, pace: ChaCha8Rng) {
        let place = self.map.index(&person.place).expect("checked: the place is on the map");
        let hands = self.spawn();
        self.give(hands, Who { name: person.name.clone(), role: person.role.clone(), place });
        self.give(hands, HandsBusy(false));
        self.give(hands, Pace(pace));
        self.people.insert(person.name.clone(), hands);
        for sample in &person.samples {
            let load = Load { weight_kg: sample_kg(), distance_m: 0.0 };
            self.spawn_sample(sample.clone(), Holder::Hands(hands), load);
        }
    }

    /// Takes an ask, or answers at once why nobody can do it; an id that was seen before changes nothing.
    fn take_ask(&mut self, id: GoalId, ask: &PersonAsk) {
        if self.own::<Asks>().knows(id) {
            return;
        }
        match self.who_will_do(ask) {
            Ok(into) => {
                let patience = ask.task.parameters.get(PATIENCE).and_then(|seconds| seconds.parse().ok());
                let patience_s = patience.filter(|seconds| (0.0..=f64::MAX).contains(seconds)).unwrap_or(AWAY_S);
                let role = ask.role.clone();
                self.own_mut::<Asks>().open(Ask { id, role, into, under_way: None, patience_s, given_up: None });
                self.mind_who_is_away();
                self.serve_asks();
            }
            Err(error) => {
                self.end_ask(id, Err(error));
            }
        }
    }

    /// Withdraws an ask: nobody waits any longer, and nothing is said. One that was withdrawn before it was heard of is not
    /// served when it comes.
    fn withdraw(&mut self, id: GoalId) {
        if self.own::<Asks>().ended.contains_key(&id) {
            return;
        }
        let handing = self.own::<Asks>().under_way(id);
        if let Some(handing) = handing {
            self.queue.take_back(handing.ends);
            self.get_mut::<HandsBusy>(handing.person).0 = false;
        }
        self.close(id, None);
        self.serve_asks();
    }

    /// The robots whose drawers will do.
    fn who_will_do(&self, ask: &PersonAsk) -> Result<BTreeSet<Entity>, ActionError> {
        let roles: BTreeSet<RoleId> =
            self.people.values().map(|person| self.get::<Who>(*person).role.clone()).collect();
        let unknown = |message| Err(refused(ErrorCode::Unknown, message));
        if !roles.contains(&ask.role) {
            let known = roles.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
            let known = if known.is_empty() { "nobody".to_owned() } else { known };
            return unknown(format!("no {} is here; there is: {known}", ask.role));
        }
        if !CAN.contains(&ask.task.task_type.as_str()) {
            return unknown(format!("a {} cannot {}; can: {}", ask.role, ask.task.task_type, CAN.join(", ")));
        }
        let waiting = self.own::<Asks>().open.len();
        if waiting >= self.limits.asks_max {
            let message = format!("{waiting} asks are waiting already");
            return Err(refused(ErrorCode::Busy, message));
        }
        let wanted = ask.task.parameters.get(INTO_ROLE);
        let holders = ask.holders.iter().filter(|(role, _)| wanted.is_none_or(|wanted| role.as_str() == wanted));
        let into: BTreeSet<Entity> = holders
            .filter_map(|(_, robot)| self.robots.get(robot).copied())
            .filter(|robot| self.get::<Body>(*robot).0.has_drawer)
            .collect();
        match (into.is_empty(), wanted) {
            (false, _) => Ok(into),
            (true, Some(role)) => unknown(format!("no robot here that has a drawer holds role {role}")),
            (true, None) => unknown("no robot here that has a drawer holds a role".to_owned()),
        }
    }

    /// Begins to hand over wherever what an ask waits for has come about, earlier asks first.
    fn serve_asks(&mut self) {
        let waiting = self.own::<Asks>().waiting();
        for number in waiting {
            let met = self.own::<Asks>().open.get(&number).and_then(|ask| self.met(ask));
            let Some((person, robot)) = met else { continue };
            let (least, most) = (self.durations.person_min_s, self.durations.person_max_s);
            let takes = self.get_mut::<Pace>(person).0.random_range(least..=most);
            let ends = self.arrange(self.now + takes, person, number.0);
            self.get_mut::<HandsBusy>(person).0 = true;
            let name = self.get::<Who>(person).name.clone();
            self.note(Happening::HandsOut { person: name, robot: self.name(robot) });
            if let Some(ask) = self.own_mut::<Asks>().open.get_mut(&number) {
                ask.under_way = Some(HandingOver { person, robot, ends });
            }
        }
    }

    /// A person free to serve the ask, and the robot with an open drawer that approached her.
    fn met(&self, ask: &Ask) -> Option<(Entity, Entity)> {
        let with = |robot: Entity| self.ready_at(robot).filter(|person| self.get::<Who>(*person).role == ask.role);
        let mut pairs = ask.into.iter().filter_map(|robot| Some((with(*robot)?, *robot)));
        pairs.find(|(person, _)| !self.get::<HandsBusy>(*person).0)
    }

    /// The person whom a robot with an open drawer is beside.
    fn ready_at(&self, robot: Entity) -> Option<Entity> {
        match *self.get::<Beside>(robot) {
            Beside::Person { person, .. } if self.get::<DrawerOpen>(robot).0 => {
                let name = &self.get::<Who>(person).name;
                (self.is_present(name) && self.is_willing(name, &self.name(robot))).then_some(person)
            }
            Beside::Person { .. } | Beside::Nobody | Beside::Robot { .. } => None,
        }
    }

    /// The time a person took is over: what she hands over changes hands, if the robot is still there for it.
    fn handed_over(&mut self, number: AskNumber) {
        let done = self.own_mut::<Asks>().open.get_mut(&number).and_then(|ask| Some((ask.id, ask.under_way.take()?)));
        let Some((id, handing)) = done else { return };
        self.get_mut::<HandsBusy>(handing.person).0 = false;
        if self.ready_at(handing.robot) == Some(handing.person) {
            let result = self.put_in(handing);
            self.end_ask(id, result);
        }
        self.serve_asks();
    }

    /// She keeps what she was about to hand over, to a robot or to whichever. The ask stays open.
    fn hold_back(&mut self, person: &PersonName, robot: Option<&RobotId>) -> Option<GoalId> {
        let person = self.people.get(person).copied()?;
        let robot = robot.and_then(|robot| self.robots.get(robot).copied());
        let (id, handing) = {
            let mut asks = self.own_mut::<Asks>();
            let is_it =
                |handing: &HandingOver| handing.person == person && robot.is_none_or(|robot| robot == handing.robot);
            let ask = asks.open.values_mut().find(|ask| ask.under_way.as_ref().is_some_and(is_it))?;
            (ask.id, ask.under_way.take()?)
        };
        self.queue.take_back(handing.ends);
        self.get_mut::<HandsBusy>(person).0 = false;
        Some(id)
    }

    /// The roles that somebody plays who is there.
    fn roles_present(&self) -> BTreeSet<RoleId> {
        let who = self.people.values().map(|person| self.get::<Who>(*person));
        who.filter(|who| self.is_present(&who.name)).map(|who| who.role.clone()).collect()
    }

    /// From now on an ask of a role that nobody here plays waits for so long and no longer; one of another has all the time.
    fn mind_who_is_away(&mut self) {
        let present = self.roles_present();
        let turned: Vec<(AskNumber, f64, Option<Ticket>)> = {
            let asks = self.own::<Asks>();
            let turned = asks.open.iter().filter(|(_, ask)| present.contains(&ask.role) == ask.given_up.is_some());
            turned.map(|(number, ask)| (*number, ask.patience_s, ask.given_up)).collect()
        };
        for (number, patience_s, given_up) in turned {
            let given_up = match given_up {
                Some(ticket) => {
                    self.queue.take_back(ticket);
                    None
                }
                None => Some(self.arrange(self.now + patience_s, self.here(), number.0 | IN_VAIN)),
            };
            if let Some(ask) = self.own_mut::<Asks>().open.get_mut(&number) {
                ask.given_up = given_up;
            }
        }
    }

    /// Nobody has come back in time.
    fn give_up_waiting(&mut self, number: AskNumber) {
        let ask = self.own::<Asks>().open.get(&number).map(|ask| (ask.id, ask.role.clone(), ask.patience_s));
        let Some((id, role, patience_s)) = ask else { return };
        let message = format!("every {role} has walked away; waited for {patience_s} s");
        self.end_ask(id, Err(refused(ErrorCode::OutOfReach, message)));
    }

    fn put_in(&mut self, handing: HandingOver) -> Result<(), ActionError> {
        self.room_in_drawer(handing.robot)?;
        let Some(sample) = self.held(Holder::Hands(handing.person)).first().copied() else {
            let who = self.get::<Who>(handing.person);
            let message = format!("{} {} has no sample to hand over", who.role, who.name);
            return Err(refused(ErrorCode::DrawerState, message));
        };
        self.hand_over(sample, Holder::Drawer(handing.robot));
        Ok(())
    }

    fn end_ask(&mut self, id: GoalId, result: Result<(), ActionError>) {
        self.close(id, Some(result.clone()));
        self.say(BodyEvent::PersonEnded { ask: id, result });
    }

    fn close(&mut self, id: GoalId, result: Option<Result<(), ActionError>>) {
        let given_up = {
            let mut asks = self.own_mut::<Asks>();
            let number = asks.ids.get(&id).copied();
            number.and_then(|number| asks.open.get_mut(&number)?.given_up.take())
        };
        if let Some(ticket) = given_up {
            self.queue.take_back(ticket);
        }
        let kept = self.limits.asks_max;
        self.own_mut::<Asks>().close(id, result, kept);
    }
}
