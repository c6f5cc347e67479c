//! People who are asked to do something.
//!
//! An ask waits until a robot that holds a role of the mission has approached someone who plays the asked role and
//! stands there with an open drawer. Whom it approached is who hands over: of several nurses, the one where the robot
//! is. She takes her time; if the robot leaves or shuts its drawer meanwhile, she keeps her sample and waits on.

use super::actions::refused;
use super::components::{Beside, Body, DrawerOpen, HandsBusy, Pace, Who};
use super::journal::Happening;
use super::queue::Ticket;
use super::samples::Holder;
use super::{Due, World};
use consort_protocol::ids::RoleId;
use consort_skills::actions::{ActionError, BodyEvent, ErrorCode, GoalId, PersonAsk};
use hecs::Entity;
use rand::RngExt;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// What people can do, by task type.
const CAN: &[&str] = &["deposit"];

/// The parameter of a task that names the role whose drawer is meant; without it any robot of the mission may come.
const INTO_ROLE: &str = "into_role";

/// Running number of an ask: earlier ones are served first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct AskNumber(u64);

/// The asks that have not ended, and the ids of those that lately did.
#[derive(Default)]
pub(super) struct Asks {
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
}

#[derive(Clone, Copy)]
struct HandingOver {
    person: Entity,
    robot: Entity,
    ends: Ticket,
}

impl World {
    /// Takes an ask, or answers at once why nobody can do it; an id that was seen before changes nothing.
    pub(super) fn take_ask(&mut self, id: GoalId, ask: &PersonAsk) {
        if self.asks.ids.contains_key(&id) || self.asks.ended.contains_key(&id) {
            return;
        }
        match self.who_will_do(ask) {
            Ok(into) => {
                let number = AskNumber(self.asks.next);
                self.asks.next += 1;
                self.asks.ids.insert(id, number);
                self.asks.open.insert(number, Ask { id, role: ask.role.clone(), into, under_way: None });
                self.serve_asks();
            }
            Err(error) => {
                let event = self.end_ask(id, Err(error));
                self.say(event);
            }
        }
    }

    /// Withdraws an ask: nobody waits any longer, and nothing is said. One that was withdrawn before it was heard of is not
    /// served when it comes.
    pub(super) fn withdraw(&mut self, id: GoalId) {
        if self.asks.ended.contains_key(&id) {
            return;
        }
        let number = self.asks.ids.get(&id);
        if let Some(handing) = number.and_then(|number| self.asks.open.get(number)?.under_way) {
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
        if self.asks.open.len() >= self.limits.asks_max {
            let message = format!("{} asks are waiting already", self.asks.open.len());
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
    pub(super) fn serve_asks(&mut self) {
        let waiting: Vec<AskNumber> =
            self.asks.open.iter().filter(|(_, ask)| ask.under_way.is_none()).map(|(number, _)| *number).collect();
        for number in waiting {
            let Some((person, robot)) = self.asks.open.get(&number).and_then(|ask| self.met(ask)) else { continue };
            let (least, most) = (self.durations.person_min_s, self.durations.person_max_s);
            let takes = self.get_mut::<Pace>(person).0.random_range(least..=most);
            let ends = self.queue.arrange(self.now + takes, Due::HandedOver(number));
            self.get_mut::<HandsBusy>(person).0 = true;
            let name = self.get::<Who>(person).name.clone();
            self.note(Happening::HandsOut { person: name, robot: self.name(robot) });
            if let Some(ask) = self.asks.open.get_mut(&number) {
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
            Beside::Person { person, .. } if self.get::<DrawerOpen>(robot).0 => Some(person),
            Beside::Person { .. } | Beside::Nobody | Beside::Robot { .. } => None,
        }
    }

    /// The time a person took is over: what she hands over changes hands, if the robot is still there for it.
    pub(super) fn handed_over(&mut self, number: AskNumber) -> Option<BodyEvent> {
        let ask = self.asks.open.get_mut(&number)?;
        let (id, handing) = (ask.id, ask.under_way.take()?);
        self.get_mut::<HandsBusy>(handing.person).0 = false;
        let event = (self.ready_at(handing.robot) == Some(handing.person)).then(|| {
            let result = self.put_in(handing);
            self.end_ask(id, result)
        });
        self.serve_asks();
        event
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

    fn end_ask(&mut self, id: GoalId, result: Result<(), ActionError>) -> BodyEvent {
        self.close(id, Some(result.clone()));
        BodyEvent::PersonEnded { ask: id, result }
    }

    fn close(&mut self, id: GoalId, result: Option<Result<(), ActionError>>) {
        if let Some(number) = self.asks.ids.remove(&id) {
            self.asks.open.remove(&number);
        }
        if self.asks.ended.insert(id, result).is_none() {
            self.asks.ended_order.push_back(id);
        }
        if self.asks.ended.len() > self.limits.asks_max
            && let Some(oldest) = self.asks.ended_order.pop_front()
        {
            self.asks.ended.remove(&oldest);
        }
    }

    /// The asks that have not ended, earlier ones first.
    pub(super) fn open_asks(&self) -> Vec<GoalId> {
        self.asks.open.values().map(|ask| ask.id).collect()
    }

    /// Whether an ask was lately withdrawn.
    pub(super) fn was_withdrawn(&self, id: GoalId) -> bool {
        self.asks.ended.get(&id).is_some_and(Option::is_none)
    }

    /// What came of an ask that lately ended.
    pub(super) fn answer_to(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        self.asks.ended.get(&id).cloned().flatten()
    }
}
