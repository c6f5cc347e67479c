//! People, and the tasks requested of them.
//!
//! A task type is a handover if a robot would do it with a goal of the kind [`Deposit`], by the declarations of the
//! domain. A request for a handover waits until a robot that holds a role of the mission has approached a person
//! in the requested role and stands there with an open drawer. The approached person hands over: of
//! several nurses, the nurse at the robot's place. A handover takes time. If the robot leaves or
//! closes its drawer meanwhile, the person keeps the sample and the request waits on. Any other task is
//! done by a free person in the role, in the time of the parameter `seconds`, or else in the time that the domain
//! declares in `simulate`, or else of a handover. It ends with the declared results or failures.
//!
//! While every person in the role is away, a request waits for a return: for the seconds of the
//! task's parameter `timeout_s`, or two minutes. A robot that has stayed at the place is next
//! to the person again after the return.
//!
//! A request to take the items off robots is done at once, by a person who is not simulated further.

mod requests;

pub(crate) use requests::PersonRequests;

use crate::component_types;
use crate::world::actions::Deposit;
use crate::world::components::{CoPresence, DrawerOpen, HandsBusy, PersonInfo, PersonRng, SampleLabel, SimRobot};
use crate::world::event::WorldEvent;
use crate::world::event_queue::TimerId;
use crate::world::location::RobotLocation;
use crate::world::names::PersonName;
use crate::world::preconditions::action_error;
use crate::world::samples::{Custody, HandoverCount, HolderEntity, PayloadData};
use crate::world::setup::{PersonSetup, WorldSetup};
use crate::world::sim_state::SimState;
use crate::world::system::System;
use crate::world::system_access::{ComponentType, SystemTimer};
use crate::world::systems::declared_actions::{ActionModels, declared_duration, draw_duration_s, draw_end};
use crate::world::systems::spontaneous_actions::PersonStates;
use consort_protocol::ids::{RobotId, RoleId, TaskType};
use consort_skills::actions::{
    ActionError, ActionParameters as _, BackendEvent, ErrorCode, GoalId, PersonRequest, PersonResult,
};
use consort_skills::domain_file::SimulatedDuration;
use hecs::Entity;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use requests::{Handover, Request, RequestNumber, Work};
use std::collections::{BTreeMap, BTreeSet};

/// Task parameter with the duration of a task that is no handover, in seconds.
const SECONDS: &str = "seconds";

/// Task parameter with the role of the robot that receives the sample. Without it, any robot of the
/// mission may come.
const INTO_ROLE: &str = "into_role";

/// Time for which a person waits for a robot, in seconds of world time, unless the task states another.
const PATIENCE_S: f64 = 120.0;

/// Task parameter with that time, in seconds.
const PATIENCE_PARAMETER: &str = "timeout_s";

/// Bit in the number of a timer that distinguishes a timeout from the end of a handover.
const TIMEOUT_FLAG: u64 = 1 << 63;

/// Number of samples of a person with endless samples from which on used samples are taken again.
const SUPPLY_MAX: usize = 20;

/// Samples that a person without a sample makes, as a component.
pub(crate) struct SampleSupply {
    endless: bool,
    made: Vec<Entity>,
}

/// Person that is free for a request.
struct Ready {
    person: Entity,
    /// The robot of a handover.
    robot: Option<Entity>,
    duration: SimulatedDuration,
}

/// See the [module](self).
pub(crate) struct People;

impl System for People {
    fn name(&self) -> &'static str {
        "people"
    }

    fn reads(&self) -> Vec<ComponentType> {
        component_types![CoPresence, SimRobot, DrawerOpen, PersonStates, RobotLocation, ActionModels]
    }

    fn writes(&self) -> Vec<ComponentType> {
        component_types![
            PersonRequests,
            Custody,
            HandsBusy,
            HandoverCount,
            SampleLabel,
            PayloadData,
            PersonRng,
            PersonInfo,
            SampleSupply
        ]
    }

    fn init_world(&self, state: &mut SimState, setup: &WorldSetup) {
        let is_handover = |task: &TaskType| {
            let kind = setup.tasks.get(task).and_then(|form| form.simulate.goal_kind.as_ref());
            kind.is_some_and(|kind| kind.as_str() == Deposit::ACTION)
        };
        let handovers = setup.tasks.keys().filter(|task| is_handover(task)).cloned().collect();
        state.insert_resource(PersonRequests::new(handovers));
        for (index, person) in setup.people.iter().enumerate() {
            let mut rng = ChaCha8Rng::seed_from_u64(setup.seed);
            rng.set_stream(index as u64);
            state.spawn_person(person, rng);
        }
    }

    fn request_person(&self, state: &mut SimState, id: GoalId, request_person: &PersonRequest) -> bool {
        state.accept_request(id, request_person);
        true
    }

    fn cancel_person_request(&self, state: &mut SimState, id: GoalId) {
        state.cancel_request(id);
    }

    fn on_timer(&self, state: &mut SimState, SystemTimer { number, .. }: SystemTimer) {
        match number & TIMEOUT_FLAG {
            0 => state.finish_handover(RequestNumber(number)),
            _ => state.time_out_request(RequestNumber(number & !TIMEOUT_FLAG)),
        }
    }

    fn on_event(&self, state: &mut SimState, event: &WorldEvent) {
        match event {
            WorldEvent::GoalEnded { .. } => state.serve_requests(),
            WorldEvent::PersonReturned { .. } => {
                state.update_timeouts();
                state.serve_requests();
            }
            WorldEvent::MissionCanceled { person, robot } => {
                state.interrupt_handover(person, Some(robot));
                state.serve_requests();
            }
            WorldEvent::HandoverDeclined { person, robot } => {
                if let Some(id) = state.interrupt_handover(person, Some(robot)) {
                    let error = action_error(ErrorCode::NotAuthenticated, format!("{person} declines"));
                    state.end_request(id, Err(error));
                    state.serve_requests();
                }
            }
            WorldEvent::PersonLeft { person } => {
                state.interrupt_handover(person, None);
                state.update_timeouts();
                state.serve_requests();
            }
            _ => {}
        }
    }
}

impl SimState {
    fn spawn_person(&mut self, person: &PersonSetup, rng: ChaCha8Rng) {
        let place = self.map.index(&person.place).expect("checked: the place is on the map");
        let entity = self.spawn();
        let PersonSetup { name, role, on_call, .. } = person.clone();
        self.insert(entity, PersonInfo { name, role, place, on_call });
        self.insert(entity, HandsBusy(false));
        self.insert(entity, PersonRng(rng));
        self.insert(entity, SampleSupply { endless: person.endless_samples, made: vec![] });
        self.people.insert(person.name.clone(), entity);
        for sample in &person.samples {
            self.spawn_sample(sample.clone(), HolderEntity::Hands(entity), PayloadData::of_sample());
        }
    }

    /// Accepts a request, or ends it at once with the reason why it is impossible. An id seen
    /// before changes nothing.
    fn accept_request(&mut self, id: GoalId, request: &PersonRequest) {
        if self.resource::<PersonRequests>().is_known(id) {
            return;
        }
        if request.takes_items() {
            let robots: Vec<Entity> =
                request.holders.values().filter_map(|robot| self.robots.get(robot).copied()).collect();
            let result = match robots.is_empty() {
                true => Err(action_error(ErrorCode::Unknown, "none of the robots is here".to_owned())),
                false => Ok(BTreeMap::new()),
            };
            robots.into_iter().for_each(|robot| self.take_samples_off(robot));
            self.end_request(id, result);
            return;
        }
        match self.requested_work(request) {
            Ok(work) => {
                let timeout = request.task.parameters.get(PATIENCE_PARAMETER).and_then(|seconds| seconds.parse().ok());
                let timeout_s = timeout.filter(|seconds| (0.0..=f64::MAX).contains(seconds)).unwrap_or(PATIENCE_S);
                let (role, task) = (request.role.clone(), request.task.task_type.clone());
                self.resource_mut::<PersonRequests>().open(Request {
                    id,
                    role,
                    task,
                    work,
                    under_way: None,
                    timeout_s,
                    timeout_timer: None,
                });
                self.update_timeouts();
                self.serve_requests();
            }
            Err(error) => {
                self.end_request(id, Err(error));
            }
        }
    }

    /// Cancels a request without emitting an event. A request that is canceled before it arrives is
    /// not served.
    fn cancel_request(&mut self, id: GoalId) {
        if self.resource::<PersonRequests>().ended.contains_key(&id) {
            return;
        }
        let handover = self.resource::<PersonRequests>().under_way(id);
        if let Some(handover) = handover {
            self.queue.cancel(handover.ends);
            self.get_mut::<HandsBusy>(handover.person).0 = false;
        }
        self.close(id, None);
        self.serve_requests();
    }

    /// Returns the requested work: for a handover, with the robots that have an acceptable drawer.
    fn requested_work(&self, request: &PersonRequest) -> Result<Work, ActionError> {
        let roles: BTreeSet<RoleId> =
            self.people.values().map(|person| self.get::<PersonInfo>(*person).role.clone()).collect();
        let unknown = |message| Err(action_error(ErrorCode::Unknown, message));
        if !roles.contains(&request.role) {
            let known = roles.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
            let known = if known.is_empty() { "none".to_owned() } else { known };
            return unknown(format!("no {} is here; roles present: {known}", request.role));
        }
        let waiting = self.resource::<PersonRequests>().open.len();
        if waiting >= self.limits.person_requests_max {
            let message = format!("{waiting} person requests are open already");
            return Err(action_error(ErrorCode::Busy, message));
        }
        if !self.resource::<PersonRequests>().is_handover(&request.task.task_type) {
            let seconds = request.task.parameters.get(SECONDS).and_then(|text| text.parse().ok());
            return Ok(Work::Task { seconds: seconds.filter(|seconds| (0.0..=f64::MAX).contains(seconds)) });
        }
        let wanted = request.task.parameters.get(INTO_ROLE);
        let holders = request.holders.iter().filter(|(role, _)| wanted.is_none_or(|wanted| role.as_str() == wanted));
        let into: BTreeSet<Entity> = holders
            .filter_map(|(_, robot)| self.robots.get(robot).copied())
            .filter(|robot| self.get::<SimRobot>(*robot).0.has_drawer)
            .collect();
        match (into.is_empty(), wanted) {
            (false, _) => Ok(Work::Handover { into }),
            (true, Some(role)) => unknown(format!("no robot here that has a drawer holds role {role}")),
            (true, None) => unknown("no robot here that has a drawer holds a role".to_owned()),
        }
    }

    /// Starts the work on each request with its conditions met, earlier requests first.
    fn serve_requests(&mut self) {
        let waiting = self.resource::<PersonRequests>().waiting();
        for number in waiting {
            let ready = self.resource::<PersonRequests>().open.get(&number).and_then(|request| self.ready(request));
            let Some(Ready { person, robot, duration }) = ready else { continue };
            let duration_s = draw_duration_s(duration, &mut self.get_mut::<PersonRng>(person).0);
            let ends = self.schedule(self.now + duration_s, person, number.0);
            self.get_mut::<HandsBusy>(person).0 = true;
            if let Some(robot) = robot {
                let name = self.get::<PersonInfo>(person).name.clone();
                self.log_event(WorldEvent::HandoverStarted { person: name, robot: self.robot_id(robot) });
            }
            if let Some(request) = self.resource_mut::<PersonRequests>().open.get_mut(&number) {
                request.under_way = Some(Handover { person, robot, ends });
            }
        }
    }

    /// Returns a free person for the request, and for a handover the robot with an open drawer that has
    /// approached them.
    fn ready(&self, request: &Request) -> Option<Ready> {
        let is_free = |person: Entity| !self.get::<HandsBusy>(person).0;
        let of_handover = SimulatedDuration::Range([self.durations.person_min_s, self.durations.person_max_s]);
        match &request.work {
            Work::Handover { into } => {
                let with = |robot: Entity| {
                    self.person_ready_at(robot).filter(|person| self.get::<PersonInfo>(*person).role == request.role)
                };
                let mut pairs = into.iter().filter_map(|robot| Some((with(*robot)?, *robot)));
                let (person, robot) = pairs.find(|(person, _)| is_free(*person))?;
                Some(Ready { person, robot: Some(robot), duration: of_handover })
            }
            Work::Task { seconds } => {
                let can_do = |person: &Entity| {
                    let info = self.get::<PersonInfo>(*person);
                    info.role == request.role && self.is_present(&info.name)
                };
                let person = self.people.values().copied().find(|person| can_do(person) && is_free(*person))?;
                let stated = seconds.map(|seconds| SimulatedDuration::Range([seconds, seconds]));
                let duration = stated.or_else(|| self.task_duration(&request.task)).unwrap_or(of_handover);
                Some(Ready { person, robot: None, duration })
            }
        }
    }

    /// Returns the person next to a robot with an open drawer.
    fn person_ready_at(&self, robot: Entity) -> Option<Entity> {
        match *self.get::<CoPresence>(robot) {
            CoPresence::Person { person, .. } if self.get::<DrawerOpen>(robot).0 => {
                let name = &self.get::<PersonInfo>(person).name;
                (self.is_present(name) && self.is_willing(name, &self.robot_id(robot))).then_some(person)
            }
            CoPresence::Person { .. } | CoPresence::None | CoPresence::Robot { .. } => None,
        }
    }

    /// Handles the end of a handover or of another task. A handover transfers the sample, if the robot is still
    /// there.
    fn finish_handover(&mut self, number: RequestNumber) {
        let done = self
            .resource_mut::<PersonRequests>()
            .open
            .get_mut(&number)
            .and_then(|request| Some((request.id, request.task.clone(), request.under_way.take()?)));
        let Some((id, task, handover)) = done else { return };
        self.get_mut::<HandsBusy>(handover.person).0 = false;
        match handover.robot {
            Some(robot) if self.person_ready_at(robot) == Some(handover.person) => {
                let result = self.transfer_to_drawer(handover.person, robot);
                self.end_request(id, result.map(|()| BTreeMap::new()));
            }
            Some(_) => {}
            None => {
                let result = self.task_result(&task, handover.person);
                self.end_request(id, result);
            }
        }
        self.serve_requests();
    }

    /// Returns the duration of a task, if a domain declares it.
    fn task_duration(&self, task: &TaskType) -> Option<SimulatedDuration> {
        declared_duration(self.find::<ActionModels>(self.resource_entity())?.of_task(task)?)
    }

    /// Draws the result of a task that a person has done.
    fn task_result(&self, task: &TaskType, person: Entity) -> PersonResult {
        let Some(models) = self.find::<ActionModels>(self.resource_entity()) else { return Ok(BTreeMap::new()) };
        let Some(action) = models.of_task(task) else { return Ok(BTreeMap::new()) };
        let chance = &mut self.get_mut::<PersonRng>(person).0;
        draw_end(action, chance, || format!("{} failed at {task}", self.get::<PersonInfo>(person).name))
    }

    /// Interrupts a person's handover, to the given robot or to any. The request stays open.
    fn interrupt_handover(&mut self, person: &PersonName, robot: Option<&RobotId>) -> Option<GoalId> {
        let person = self.people.get(person).copied()?;
        let robot = robot.and_then(|robot| self.robots.get(robot).copied());
        let (id, handover) = {
            let mut requests = self.resource_mut::<PersonRequests>();
            let matches = |handover: &Handover| {
                handover.person == person && robot.is_none_or(|robot| handover.robot == Some(robot))
            };
            let request = requests.open.values_mut().find(|request| request.under_way.as_ref().is_some_and(matches))?;
            (request.id, request.under_way.take()?)
        };
        self.queue.cancel(handover.ends);
        self.get_mut::<HandsBusy>(person).0 = false;
        Some(id)
    }

    /// Roles of the people present.
    fn roles_present(&self) -> BTreeSet<RoleId> {
        let info = self.people.values().map(|person| self.get::<PersonInfo>(*person));
        info.filter(|info| self.is_present(&info.name)).map(|info| info.role.clone()).collect()
    }

    /// Starts the timeout of each request with an absent role, and stops it for roles that are
    /// present.
    fn update_timeouts(&mut self) {
        let present = self.roles_present();
        let changed: Vec<(RequestNumber, f64, Option<TimerId>)> = {
            let requests = self.resource::<PersonRequests>();
            let changed = requests
                .open
                .iter()
                .filter(|(_, request)| present.contains(&request.role) == request.timeout_timer.is_some());
            changed.map(|(number, request)| (*number, request.timeout_s, request.timeout_timer)).collect()
        };
        for (number, timeout_s, timeout_timer) in changed {
            let timeout_timer = match timeout_timer {
                Some(timer) => {
                    self.queue.cancel(timer);
                    None
                }
                None => Some(self.schedule(self.now + timeout_s, self.resource_entity(), number.0 | TIMEOUT_FLAG)),
            };
            if let Some(request) = self.resource_mut::<PersonRequests>().open.get_mut(&number) {
                request.timeout_timer = timeout_timer;
            }
        }
    }

    /// Handles the timeout of a request: no person has returned in time.
    fn time_out_request(&mut self, number: RequestNumber) {
        let request = self
            .resource::<PersonRequests>()
            .open
            .get(&number)
            .map(|request| (request.id, request.role.clone(), request.timeout_s));
        let Some((id, role, timeout_s)) = request else { return };
        let message = format!("every {role} has walked away; waited for {timeout_s} s");
        self.end_request(id, Err(action_error(ErrorCode::OutOfReach, message)));
    }

    fn transfer_to_drawer(&mut self, person: Entity, robot: Entity) -> Result<(), ActionError> {
        self.check_drawer_space(robot)?;
        let held = self.held(HolderEntity::Hands(person)).first().copied();
        let Some(sample) = held.or_else(|| self.supplied_sample(person)) else {
            let info = self.get::<PersonInfo>(person);
            let message = format!("{} {} has no sample to hand over", info.role, info.name);
            return Err(action_error(ErrorCode::ContainerState, message));
        };
        self.transfer_sample(sample, HolderEntity::Drawer(robot));
        Ok(())
    }

    /// Returns a new sample of a person with endless samples: one that has ended up on a table, once there
    /// are [`SUPPLY_MAX`], so that their number stays bounded.
    fn supplied_sample(&mut self, person: Entity) -> Option<Entity> {
        let mut made = {
            let supply = self.get::<SampleSupply>(person);
            if !supply.endless {
                return None;
            }
            supply.made.clone()
        };
        // Goals may have consumed some.
        made.retain(|sample| self.find::<Custody>(*sample).is_some());
        if made.len() >= SUPPLY_MAX
            && let Some(used) = self.first_on_a_table(&made)
        {
            self.transfer_sample(used, HolderEntity::Hands(person));
            return Some(used);
        }
        let id = self.free_sample_id(self.get::<PersonInfo>(person).name.as_str(), made.len() + 1);
        self.spawn_sample(id.clone(), HolderEntity::Hands(person), PayloadData::of_sample());
        let sample = self.samples.get(&id).copied()?;
        made.push(sample);
        self.get_mut::<SampleSupply>(person).made = made;
        Some(sample)
    }

    fn end_request(&mut self, id: GoalId, result: PersonResult) {
        self.close(id, Some(result.clone()));
        self.emit(BackendEvent::PersonRequestEnded { request: id, result });
    }

    fn close(&mut self, id: GoalId, result: Option<PersonResult>) {
        let timeout_timer = {
            let mut requests = self.resource_mut::<PersonRequests>();
            let number = requests.ids.get(&id).copied();
            number.and_then(|number| requests.open.get_mut(&number)?.timeout_timer.take())
        };
        if let Some(timer) = timeout_timer {
            self.queue.cancel(timer);
        }
        let kept = self.limits.person_requests_max;
        self.resource_mut::<PersonRequests>().close(id, result, kept);
    }
}
