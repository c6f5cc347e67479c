//! People who are asked to do something.
//!
//! An ask waits until a robot that holds a role of the mission has approached someone who plays the asked role and
//! stands there with an open drawer. Whom it approached is who hands over: of several nurses, the one where the robot
//! is. She takes her time; if the robot leaves or shuts its drawer meanwhile, she keeps her sample and waits on.
//!
//! While all who play the role are away, an ask waits for one to come back: for the seconds that its task gives in `patience`,
//! or two minutes. A robot that has stayed where it was is beside her again when she is back.

use crate::world::components::{CoPresence, DrawerOpen, HandoverRng, HandsBusy, PersonInfo, SampleLabel, SimRobot};
use crate::world::environment_setup::sample_kg;
use crate::world::event_log::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::location::RobotLocation;
use crate::world::names::PersonName;
use crate::world::preconditions::action_error;
use crate::world::samples::{Custody, HandoverCount, HolderEntity, PayloadData};
use crate::world::setup::{PersonSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::{ComponentType, System, SystemTimer, kinds};
use crate::world::systems::spontaneous_actions::PersonStates;
use consort_protocol::ids::{RobotId, RoleId};
use consort_skills::actions::{
    ActionError, BackendEvent, ErrorCode, GoalId, PERSON_TIMEOUT_PARAMETER, PERSON_TIMEOUT_S, PersonRequest,
};
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
pub(crate) struct PersonRequests {
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
    given_up: Option<TimerId>,
}

#[derive(Clone, Copy)]
struct HandingOver {
    person: Entity,
    robot: Entity,
    ends: TimerId,
}

impl PersonRequests {
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
    pub(crate) fn open_requests(&self) -> Vec<GoalId> {
        self.open.values().map(|ask| ask.id).collect()
    }

    /// Whether an ask was lately withdrawn.
    pub(crate) fn was_canceled(&self, id: GoalId) -> bool {
        self.ended.get(&id).is_some_and(Option::is_none)
    }

    /// What came of an ask that lately ended.
    pub(crate) fn result(&self, id: GoalId) -> Option<Result<(), ActionError>> {
        self.ended.get(&id).cloned().flatten()
    }
}

/// See the [module](self).
pub(crate) struct People;

impl System for People {
    fn name(&self) -> &'static str {
        "people"
    }

    fn reads(&self) -> Vec<ComponentType> {
        kinds![CoPresence, SimRobot, DrawerOpen, PersonStates, RobotLocation]
    }

    fn writes(&self) -> Vec<ComponentType> {
        kinds![PersonRequests, Custody, HandsBusy, HandoverCount, SampleLabel, PayloadData, HandoverRng, PersonInfo]
    }

    fn init_world(&self, floor: &mut SimState, setup: &WorldSetup) {
        floor.insert_resource(PersonRequests::default());
        for (index, person) in setup.people.iter().enumerate() {
            let mut pace = ChaCha8Rng::seed_from_u64(setup.seed);
            pace.set_stream(index as u64);
            floor.spawn_person(person, pace);
        }
    }

    fn request_person(&self, floor: &mut SimState, id: GoalId, request_person: &PersonRequest) -> bool {
        floor.take_ask(id, request_person);
        true
    }

    fn cancel_person_request(&self, floor: &mut SimState, id: GoalId) {
        floor.withdraw(id);
    }

    fn on_timer(&self, floor: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        match number & IN_VAIN {
            0 => floor.handed_over(AskNumber(number)),
            _ => floor.give_up_waiting(AskNumber(number & !IN_VAIN)),
        }
    }

    fn on_event(&self, floor: &mut SimState, what: &WorldEvent) {
        match what {
            WorldEvent::GoalEnded { .. } => floor.serve_asks(),
            WorldEvent::PersonReturned { .. } => {
                floor.mind_who_is_away();
                floor.serve_asks();
            }
            WorldEvent::MissionCanceled { person, robot } => {
                floor.hold_back(person, Some(robot));
                floor.serve_asks();
            }
            WorldEvent::HandoverDeclined { person, robot } => {
                if let Some(id) = floor.hold_back(person, Some(robot)) {
                    let why = action_error(ErrorCode::NotAuthenticated, format!("{person} declines"));
                    floor.end_ask(id, Err(why));
                    floor.serve_asks();
                }
            }
            WorldEvent::PersonLeft { person } => {
                floor.hold_back(person, None);
                floor.mind_who_is_away();
                floor.serve_asks();
            }
            _ => {}
        }
    }
}

impl SimState {
    fn spawn_person(&mut self, person: &PersonSetup, pace: ChaCha8Rng) {
        let place = self.map.index(&person.place).expect("checked: the place is on the map");
        let hands = self.spawn();
        self.insert(hands, PersonInfo { name: person.name.clone(), role: person.role.clone(), place });
        self.insert(hands, HandsBusy(false));
        self.insert(hands, HandoverRng(pace));
        self.people.insert(person.name.clone(), hands);
        for sample in &person.samples {
            let load = PayloadData { weight_kg: sample_kg(), distance_m: 0.0 };
            self.spawn_sample(sample.clone(), HolderEntity::Hands(hands), load);
        }
    }

    /// Takes an ask, or answers at once why nobody can do it; an id that was seen before changes nothing.
    fn take_ask(&mut self, id: GoalId, ask: &PersonRequest) {
        if self.resource::<PersonRequests>().knows(id) {
            return;
        }
        match self.who_will_do(ask) {
            Ok(into) => {
                let patience =
                    ask.task.parameters.get(PERSON_TIMEOUT_PARAMETER).and_then(|seconds| seconds.parse().ok());
                let patience_s =
                    patience.filter(|seconds| (0.0..=f64::MAX).contains(seconds)).unwrap_or(PERSON_TIMEOUT_S);
                let role = ask.role.clone();
                self.resource_mut::<PersonRequests>().open(Ask {
                    id,
                    role,
                    into,
                    under_way: None,
                    patience_s,
                    given_up: None,
                });
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
        if self.resource::<PersonRequests>().ended.contains_key(&id) {
            return;
        }
        let handing = self.resource::<PersonRequests>().under_way(id);
        if let Some(handing) = handing {
            self.queue.cancel(handing.ends);
            self.get_mut::<HandsBusy>(handing.person).0 = false;
        }
        self.close(id, None);
        self.serve_asks();
    }

    /// The robots whose drawers will do.
    fn who_will_do(&self, ask: &PersonRequest) -> Result<BTreeSet<Entity>, ActionError> {
        let roles: BTreeSet<RoleId> =
            self.people.values().map(|person| self.get::<PersonInfo>(*person).role.clone()).collect();
        let unknown = |message| Err(action_error(ErrorCode::Unknown, message));
        if !roles.contains(&ask.role) {
            let known = roles.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
            let known = if known.is_empty() { "nobody".to_owned() } else { known };
            return unknown(format!("no {} is here; there is: {known}", ask.role));
        }
        if !CAN.contains(&ask.task.task_type.as_str()) {
            return unknown(format!("a {} cannot {}; can: {}", ask.role, ask.task.task_type, CAN.join(", ")));
        }
        let waiting = self.resource::<PersonRequests>().open.len();
        if waiting >= self.limits.asks_max {
            let message = format!("{waiting} asks are waiting already");
            return Err(action_error(ErrorCode::Busy, message));
        }
        let wanted = ask.task.parameters.get(INTO_ROLE);
        let holders = ask.holders.iter().filter(|(role, _)| wanted.is_none_or(|wanted| role.as_str() == wanted));
        let into: BTreeSet<Entity> = holders
            .filter_map(|(_, robot)| self.robots.get(robot).copied())
            .filter(|robot| self.get::<SimRobot>(*robot).0.has_drawer)
            .collect();
        match (into.is_empty(), wanted) {
            (false, _) => Ok(into),
            (true, Some(role)) => unknown(format!("no robot here that has a drawer holds role {role}")),
            (true, None) => unknown("no robot here that has a drawer holds a role".to_owned()),
        }
    }

    /// Begins to hand over wherever what an ask waits for has come about, earlier asks first.
    fn serve_asks(&mut self) {
        let waiting = self.resource::<PersonRequests>().waiting();
        for number in waiting {
            let met = self.resource::<PersonRequests>().open.get(&number).and_then(|ask| self.met(ask));
            let Some((person, robot)) = met else { continue };
            let (least, most) = (self.durations.person_min_s, self.durations.person_max_s);
            let takes = self.get_mut::<HandoverRng>(person).0.random_range(least..=most);
            let ends = self.schedule(self.now + takes, person, number.0);
            self.get_mut::<HandsBusy>(person).0 = true;
            let name = self.get::<PersonInfo>(person).name.clone();
            self.log_event(WorldEvent::HandoverStarted { person: name, robot: self.robot_id(robot) });
            if let Some(ask) = self.resource_mut::<PersonRequests>().open.get_mut(&number) {
                ask.under_way = Some(HandingOver { person, robot, ends });
            }
        }
    }

    /// A person free to serve the ask, and the robot with an open drawer that approached her.
    fn met(&self, ask: &Ask) -> Option<(Entity, Entity)> {
        let with =
            |robot: Entity| self.ready_at(robot).filter(|person| self.get::<PersonInfo>(*person).role == ask.role);
        let mut pairs = ask.into.iter().filter_map(|robot| Some((with(*robot)?, *robot)));
        pairs.find(|(person, _)| !self.get::<HandsBusy>(*person).0)
    }

    /// The person whom a robot with an open drawer is beside.
    fn ready_at(&self, robot: Entity) -> Option<Entity> {
        match *self.get::<CoPresence>(robot) {
            CoPresence::Person { person, .. } if self.get::<DrawerOpen>(robot).0 => {
                let name = &self.get::<PersonInfo>(person).name;
                (self.is_present(name) && self.is_willing(name, &self.robot_id(robot))).then_some(person)
            }
            CoPresence::Person { .. } | CoPresence::None | CoPresence::Robot { .. } => None,
        }
    }

    /// The time a person took is over: what she hands over changes hands, if the robot is still there for it.
    fn handed_over(&mut self, number: AskNumber) {
        let done = self
            .resource_mut::<PersonRequests>()
            .open
            .get_mut(&number)
            .and_then(|ask| Some((ask.id, ask.under_way.take()?)));
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
            let mut asks = self.resource_mut::<PersonRequests>();
            let is_it =
                |handing: &HandingOver| handing.person == person && robot.is_none_or(|robot| robot == handing.robot);
            let ask = asks.open.values_mut().find(|ask| ask.under_way.as_ref().is_some_and(is_it))?;
            (ask.id, ask.under_way.take()?)
        };
        self.queue.cancel(handing.ends);
        self.get_mut::<HandsBusy>(person).0 = false;
        Some(id)
    }

    /// The roles that somebody plays who is there.
    fn roles_present(&self) -> BTreeSet<RoleId> {
        let who = self.people.values().map(|person| self.get::<PersonInfo>(*person));
        who.filter(|who| self.is_present(&who.name)).map(|who| who.role.clone()).collect()
    }

    /// From now on an ask of a role that nobody here plays waits for so long and no longer; one of another has all the time.
    fn mind_who_is_away(&mut self) {
        let present = self.roles_present();
        let turned: Vec<(AskNumber, f64, Option<TimerId>)> = {
            let asks = self.resource::<PersonRequests>();
            let turned = asks.open.iter().filter(|(_, ask)| present.contains(&ask.role) == ask.given_up.is_some());
            turned.map(|(number, ask)| (*number, ask.patience_s, ask.given_up)).collect()
        };
        for (number, patience_s, given_up) in turned {
            let given_up = match given_up {
                Some(ticket) => {
                    self.queue.cancel(ticket);
                    None
                }
                None => Some(self.schedule(self.now + patience_s, self.resource_entity(), number.0 | IN_VAIN)),
            };
            if let Some(ask) = self.resource_mut::<PersonRequests>().open.get_mut(&number) {
                ask.given_up = given_up;
            }
        }
    }

    /// Nobody has come back in time.
    fn give_up_waiting(&mut self, number: AskNumber) {
        let ask =
            self.resource::<PersonRequests>().open.get(&number).map(|ask| (ask.id, ask.role.clone(), ask.patience_s));
        let Some((id, role, patience_s)) = ask else { return };
        let message = format!("every {role} has walked away; waited for {patience_s} s");
        self.end_ask(id, Err(action_error(ErrorCode::OutOfReach, message)));
    }

    fn put_in(&mut self, handing: HandingOver) -> Result<(), ActionError> {
        self.check_drawer_space(handing.robot)?;
        let Some(sample) = self.held(HolderEntity::Hands(handing.person)).first().copied() else {
            let who = self.get::<PersonInfo>(handing.person);
            let message = format!("{} {} has no sample to hand over", who.role, who.name);
            return Err(action_error(ErrorCode::DrawerState, message));
        };
        self.transfer_sample(sample, HolderEntity::Drawer(handing.robot));
        Ok(())
    }

    fn end_ask(&mut self, id: GoalId, result: Result<(), ActionError>) {
        self.close(id, Some(result.clone()));
        self.emit(BackendEvent::PersonRequestEnded { ask: id, result });
    }

    fn close(&mut self, id: GoalId, result: Option<Result<(), ActionError>>) {
        let given_up = {
            let mut asks = self.resource_mut::<PersonRequests>();
            let number = asks.ids.get(&id).copied();
            number.and_then(|number| asks.open.get_mut(&number)?.given_up.take())
        };
        if let Some(ticket) = given_up {
            self.queue.cancel(ticket);
        }
        let kept = self.limits.asks_max;
        self.resource_mut::<PersonRequests>().close(id, result, kept);
    }
}
