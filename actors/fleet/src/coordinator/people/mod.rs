//! Unmanaged roles: the coordinator executes the local plans of people, and escalates and expires
//! the questions of robots to them.
//!
//! ```text
//!  ledger ─▶ next_command ─▶ ask, progress, escalate, expire ─▶ ledger ─▶ view/requests ─▶ people ─▶ api/answer
//!                                                                 │
//!                                                                 └─▶ wire/people/ask ─▶ host of simulated people
//! ```
//!
//! All state is in the ledger. The next coordinator continues from there, so no node is needed for
//! the roles of people. What this session remembers only avoids repeated proposals and events.

mod cancel_orders;
mod changes;
mod host;
mod next_command;
mod removals;
mod simulated;
#[cfg(test)]
pub(super) mod test_ledger;

use super::message::CoordinatorMessage;
use super::scope::Scope;
use super::session_context::SessionContext;
use crate::robot_driver::{PersonCommand, PersonEvent, PersonRequestState};
use cancel_orders::{CancelOrder, RecentCancelOrders};
use changes::{PeopleChanges, has_people};
use consort_bus::{Author, Delivery, Encoding, Sample};
use consort_protocol::cause::CauseClass;
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::keys::Key;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{AnswerContent, Command, MissionChanges, MissionEntry, PersonAnswer};
use consort_protocol::message::SignalHistory;
use consort_protocol::plan::Signal;
use consort_protocol::units::NodeTime;
use consort_skills::actions::{ErrorCode, GoalId, PersonResult};
pub(super) use host::PeopleHost;
use next_command::{PersonStep, next_step, question_steps};
use removals::Removals;
pub(super) use removals::removals;
use simulated::SimulatedPeople;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tracing::{debug, warn};

/// Time after which a proposal without effect is repeated.
const PROPOSAL_RETRY: Duration = Duration::from_secs(1);

/// The unmanaged roles of a session.
pub(super) struct People {
    /// Latest proposal for each role, with its time.
    proposed: BTreeMap<(MissionId, RoleId), (PersonStep, NodeTime)>,
    changes: PeopleChanges,
    simulated: SimulatedPeople,
    removals: Removals,
    host: PeopleHost,
    cancel_orders: RecentCancelOrders,
}

impl People {
    pub(super) fn new(context: &SessionContext) -> People {
        People {
            proposed: BTreeMap::new(),
            changes: context.read_ledger(PeopleChanges::of),
            simulated: SimulatedPeople::default(),
            removals: Removals::default(),
            host: PeopleHost::new(&context.settings.parts.bus, &context.settings.parts.keys),
            cancel_orders: RecentCancelOrders::default(),
        }
    }

    /// Publishes what has changed in the ledger, of which `changes` names the missions, and proposes the next commands.
    /// Unless the scope is all missions, nothing is done if the changes concern no people. `confirmed_ms` is the
    /// time of day that a majority of the voters confirms.
    pub(super) fn follow(
        &mut self,
        context: &mut SessionContext,
        (changes, scope): (&MissionChanges, Scope<'_>),
        now: NodeTime,
        confirmed_ms: Option<u64>,
    ) {
        if let Scope::Changed { missions, .. } = scope
            && !context.read_ledger(|ledger| missions.iter().any(|id| ledger.mission(id).is_none_or(has_people)))
        {
            return;
        }
        let (changes, opened) =
            context.read_ledger(|ledger| (self.changes.follow(ledger, changes), self.simulated.follow(ledger)));
        changes.events.into_iter().for_each(|event| context.publish_event(event));
        for (mission, signal) in changes.signals {
            publish_signal(context, mission, signal);
        }
        for command in opened {
            self.send_to_host(context, command);
        }
        let steps: Vec<((MissionId, RoleId), PersonStep)> = context.read_ledger(|ledger| {
            let missions = ledger.missions_with_people();
            let roles = missions
                .iter()
                .copied()
                .filter(|entry| entry.submission.may_start(confirmed_ms))
                .flat_map(|entry| entry.unmanaged_roles().map(move |role| (entry, role)));
            let of_roles = roles.filter_map(|(entry, role)| {
                Some(((entry.id.clone(), role.clone()), next_step(entry, role, confirmed_ms)?))
            });
            let of_questions = missions.iter().flat_map(|entry| question_steps(entry, confirmed_ms));
            of_roles.chain(of_questions).collect()
        });
        let due: BTreeSet<_> = steps.iter().map(|(key, _)| key.clone()).collect();
        self.proposed.retain(|key, _| due.contains(key));
        for (key, step) in steps {
            let repeated = |(before, at): &(PersonStep, NodeTime)| *before == step && now.since(*at) < PROPOSAL_RETRY;
            if !self.proposed.get(&key).is_some_and(repeated) {
                self.proposed.insert(key.clone(), (step.clone(), now));
                self.propose(context, key, step, confirmed_ms);
            }
        }
    }

    fn propose(
        &self,
        context: &mut SessionContext,
        (mission, role): (MissionId, RoleId),
        step: PersonStep,
        confirmed_ms: Option<u64>,
    ) {
        match (step, confirmed_ms) {
            (PersonStep::Progress(command), _) => context.propose(command),
            // The results that the task uses are unknown, for every person.
            (PersonStep::Fail { cause, branch }, _) => {
                context.fail_mission(mission, (cause, CauseClass::Task), Some(branch));
            }
            (PersonStep::Ask { branch, step }, Some(asked_ms)) => {
                context.propose(Command::AskPerson { mission, branch, role, step, asked_ms });
            }
            (PersonStep::Escalate(request), Some(now_ms)) => {
                context.propose(Command::EscalatePersonRequest { request, now_ms });
            }
            (PersonStep::Expire(request), Some(now_ms)) => {
                let places = context.places_of(&mission);
                context.propose(Command::ExpirePersonRequest { request, now_ms, places });
            }
            (PersonStep::Ask { .. } | PersonStep::Escalate(_) | PersonStep::Expire(_), None) => {}
        }
    }

    /// Repeats the open requests to simulated people, what was withdrawn and not confirmed, and the removals of items that
    /// were not confirmed. `confirmed_ms` is the time of day that a majority of the voters confirms.
    pub(super) fn tick(&mut self, context: &mut SessionContext, now: NodeTime, confirmed_ms: Option<u64>) {
        let has_host = self.simulated.has_host();
        let removals = context.read_ledger(|ledger| self.removals.due(ledger, has_host, now, confirmed_ms));
        for command in self.simulated.repeated().into_iter().chain(removals) {
            self.send_to_host(context, command);
        }
    }

    fn send_to_host(&self, context: &mut SessionContext, command: PersonCommand) {
        let (host, to) = (self.host.clone(), context.mailbox.clone());
        context.tasks.spawn(async move {
            // The actor ends with the node.
            let receive = |state, author| drop(to.cast(CoordinatorMessage::PersonReplied(command.id, state, author)));
            host.send(&command, receive).await;
        });
    }

    /// Handles the reply of a host to a person request.
    pub(super) fn handle_reply(
        &mut self,
        context: &mut SessionContext,
        id: GoalId,
        state: PersonRequestState,
        author: &Author,
        confirmed_ms: Option<u64>,
    ) {
        self.simulated.host_replied();
        match state {
            PersonRequestState::Requested => {}
            PersonRequestState::Ended(result) => {
                self.simulated.confirm(id);
                if result.is_ok() {
                    self.removals.confirm(id);
                }
                self.answer(context, id, result, author, confirmed_ms);
            }
            PersonRequestState::Canceled => {
                self.simulated.confirm(id);
                self.simulated.renew(id);
            }
        }
    }

    /// Handles the published event of a host.
    pub(super) fn handle_event(&mut self, context: &mut SessionContext, sample: &Sample, confirmed_ms: Option<u64>) {
        match codec::decode::<PersonEvent>(&sample.payload) {
            Ok(PersonEvent::RequestEnded { id, result }) => {
                self.answer(context, id, result, &sample.author, confirmed_ms);
            }
            Ok(PersonEvent::CancelMission { role, .. }) if !sample.author.may_serve(role.as_str()) => {
                warn!(author = %sample.author, %role, "the author does not serve this person: event ignored");
            }
            Ok(PersonEvent::CancelMission { by, role, robot, at_ms }) => {
                let by = sample.author.name().map_or(by.clone(), |host| format!("{by}, according to {host}"));
                self.cancel_mission(context, CancelOrder { by, robot, at_ms }, &role, confirmed_ms);
            }
            Err(problem) => warn!(%problem, "event of a person cannot be decoded"),
        }
    }

    /// Proposes the answer of a simulated person. A host without such a person, or without such results,
    /// leaves the request to others.
    fn answer(
        &mut self,
        context: &mut SessionContext,
        id: GoalId,
        result: PersonResult,
        author: &Author,
        confirmed_ms: Option<u64>,
    ) {
        let Some((request, role)) = self.simulated.request_of(id) else { return };
        if !author.may_serve(role.as_str()) {
            return warn!(%author, %role, "the author does not serve this person: result ignored");
        }
        let role = role.as_str().to_owned();
        let form = context.read_ledger(|ledger| ledger.form_of(&request)).unwrap_or_default();
        let (content, note) = match result.map(|results| simulated::done(&form, results)) {
            Ok(Ok(content)) => (content, String::new()),
            Ok(Err(problem)) => {
                warn!(%request, problem, "results of a simulated person do not fit: request left to others");
                return self.simulated.leave_to_others(id);
            }
            Err(problem) if problem.code == ErrorCode::Unknown => return self.simulated.leave_to_others(id),
            Err(problem) if problem.code == ErrorCode::Busy => return self.simulated.renew(id),
            Err(problem) => (AnswerContent::Cannot, problem.to_string()),
        };
        let at_ms = confirmed_ms.unwrap_or_else(|| context.settings.parts.clock.wall_ms());
        let answer = PersonAnswer { by: role, content, note, at_ms };
        let places = context.places_of(&request.mission);
        context.propose(Command::AnswerPerson { request, answer, places });
    }

    /// Cancels the mission for which a robot came to a simulated person: the mission in which both the
    /// robot and the person's role take part. The host repeats its order, and so does the proposal.
    fn cancel_mission(
        &mut self,
        context: &mut SessionContext,
        order: CancelOrder,
        role: &RoleId,
        confirmed_ms: Option<u64>,
    ) {
        let mission = match self.cancel_orders.mission(&order) {
            Some(mission) => mission.clone(),
            None => {
                let holds = |entry: &MissionEntry| entry.held_roles().any(|(.., held)| held.robot == order.robot);
                let found = context.read_ledger(|ledger| {
                    let mut missions = ledger.active_missions().into_iter();
                    let found = missions.find(|entry| holds(entry) && entry.unmanaged_roles().any(|of| of == role));
                    found.map(|entry| entry.id.clone())
                });
                let Some(mission) = found else { return };
                self.cancel_orders.add(order.clone(), mission.clone());
                mission
            }
        };
        if context.read_ledger(|ledger| ledger.mission(&mission).is_some_and(|entry| !entry.state.is_final())) {
            let places = context.places_of(&mission);
            // An unknown time: the trail would keep that of a wrong clock.
            let at_ms = confirmed_ms.unwrap_or_default();
            context.propose(Command::Cancel { mission, by: order.by, places, at_ms });
        }
    }
}

/// Publishes a signal of a person. Its receiver then queries the coordinator: only its reply counts.
fn publish_signal(context: &mut SessionContext, mission: MissionId, signal: Signal) {
    let key = context.settings.parts.keys.write(&Key::Signal(mission.clone(), signal.to.clone()));
    let history = SignalHistory { mission, epoch: Epoch::default(), signals: BTreeSet::from([signal]) };
    let bytes = codec::encode(&history).expect("a signal fits a message").into();
    let bus = context.settings.parts.bus.clone();
    context.tasks.spawn(async move {
        if let Err(problem) = bus.publish(&key, bytes, Encoding::Wire, Delivery::Drop).await {
            debug!(%problem, "signal was not published; its receiver will query it");
        }
    });
}
