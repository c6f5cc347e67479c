//! Delivery of the open requests to the host of simulated people.

use crate::robot_driver::PersonCommand;
use consort_protocol::codec;
use consort_protocol::fnv::fnv1a;
use consort_protocol::ids::{ClusterId, RoleId};
use consort_protocol::lease::RoleHolder;
use consort_protocol::ledger::{AnswerContent, Ledger, MissionEntry, PersonRequestEntry, PersonRequestId};
use consort_protocol::mission::{ValueKind, check_results};
use consort_protocol::scalar::Scalar;
use consort_skills::actions::{GoalId, PersonRequest};
use serde::Serialize;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};

/// Maximum number of cancellations that are repeated; the oldest are dropped beyond it. Raised: more queries
/// per timer to an unreachable host. A guess: each belongs to a mission that ended, or lost a robot,
/// during a person request.
const CANCELLATIONS_MAX: usize = 64;

/// Request, as sent to the people of one role. An escalated request is sent to two roles.
type RoleRequest = (PersonRequestId, RoleId);

/// Open requests, as sent to the host of simulated people. A host cancels a request that is no longer
/// repeated.
#[derive(Debug, Default)]
pub(super) struct SimulatedPeople {
    open: BTreeMap<RoleRequest, SentRequest>,
    cancellations: VecDeque<GoalId>,
    /// A host has replied. Until then a single request is repeated.
    has_host: bool,
}

#[derive(Debug)]
struct SentRequest {
    cluster: Option<ClusterId>,
    /// Number of times that the host has canceled the request while it was still needed. A canceled id
    /// is not served again.
    turn: u32,
    request: PersonRequest,
    /// The host has no such person: the request is left to others.
    left_to_others: bool,
}

/// Returns the id for the host: a hash of the content, so that every coordinator uses the same id.
pub(super) fn goal_id(content: &impl Serialize) -> GoalId {
    GoalId(fnv1a(codec::encode_record(content).expect("an id fits a record")))
}

impl SentRequest {
    fn id(&self, request: &PersonRequestId) -> GoalId {
        goal_id(&(self.cluster, request, &self.request.role, self.turn))
    }

    fn command(&self, request: &PersonRequestId) -> PersonCommand {
        PersonCommand { id: self.id(request), request: Some(self.request.clone()) }
    }
}

impl SimulatedPeople {
    /// Follows the ledger. Returns the commands for requests that were opened or closed.
    pub(super) fn follow(&mut self, ledger: &Ledger) -> Vec<PersonCommand> {
        let open: BTreeMap<RoleRequest, PersonRequest> =
            ledger.open_person_requests().into_iter().flat_map(|(entry, request)| simulated(entry, request)).collect();
        let closed: Vec<RoleRequest> = self.open.keys().filter(|id| !open.contains_key(id)).cloned().collect();
        let mut commands = vec![];
        for key in closed {
            if let Some(sent) = self.open.remove(&key) {
                let id = sent.id(&key.0);
                if self.has_host && !sent.left_to_others {
                    self.cancellations.push_back(id);
                    commands.push(PersonCommand { id, request: None });
                }
            }
        }
        while self.cancellations.len() > CANCELLATIONS_MAX {
            self.cancellations.pop_front();
        }
        for (key, request) in open {
            if let Entry::Vacant(slot) = self.open.entry(key) {
                let sent = SentRequest { cluster: ledger.cluster(), turn: 0, request, left_to_others: false };
                commands.push(sent.command(&slot.key().0));
                slot.insert(sent);
            }
        }
        commands
    }

    /// Returns the commands to be repeated.
    pub(super) fn repeated(&self) -> Vec<PersonCommand> {
        let open = self.open.iter().filter(|(_, sent)| !sent.left_to_others);
        let open = open.take(if self.has_host { usize::MAX } else { 1 }).map(|((id, _), sent)| sent.command(id));
        open.chain(self.cancellations.iter().map(|id| PersonCommand { id: *id, request: None })).collect()
    }

    /// Checks whether a host has replied.
    pub(super) fn has_host(&self) -> bool {
        self.has_host
    }

    /// A host has replied to a command.
    pub(super) fn host_replied(&mut self) {
        self.has_host = true;
    }

    /// Removes a confirmed cancellation.
    pub(super) fn confirm(&mut self, id: GoalId) {
        self.cancellations.retain(|pending| *pending != id);
    }

    /// Stops offering a request to the host, which has no such person.
    pub(super) fn leave_to_others(&mut self, id: GoalId) {
        self.sent(id).into_iter().for_each(|sent| sent.left_to_others = true);
    }

    /// Returns the open request with this id for the host, and the role of the person.
    pub(super) fn request_of(&self, id: GoalId) -> Option<(PersonRequestId, &RoleId)> {
        let ((request, role), _) = self.open.iter().find(|((request, _), sent)| sent.id(request) == id)?;
        Some((request.clone(), role))
    }

    /// Renews a request that the host has canceled or turned down for now, although it is still needed.
    /// The timer sends it.
    pub(super) fn renew(&mut self, id: GoalId) {
        self.sent(id).into_iter().for_each(|sent| sent.turn += 1);
    }

    fn sent(&mut self, id: GoalId) -> Option<&mut SentRequest> {
        self.open.iter_mut().find(|((request, _), sent)| sent.id(request) == id).map(|(_, sent)| sent)
    }
}

/// Returns the request for the simulated people of each role that is asked. Empty if the mission has taken
/// another branch since.
fn simulated(entry: &MissionEntry, request: &PersonRequestEntry) -> Vec<(RoleRequest, PersonRequest)> {
    let Some(task) = entry.requested_task(request) else { return vec![] };
    let id = PersonRequestId { mission: entry.id.clone(), number: request.number };
    let to_role = |role: &RoleId| {
        let holders = RoleHolder::robots(&request.robots);
        ((id.clone(), role.clone()), PersonRequest { role: role.clone(), task: task.clone(), holders })
    };
    request.asked_roles().map(to_role).collect()
}

/// Returns the answer of a simulated person that has done a task. Its host states all results that the domain
/// declares; in a joint task the form is empty, and the robots return them.
///
/// # Errors
/// A result is missing or does not fit the form: the host has other domain files.
pub(super) fn done(
    form: &BTreeMap<String, ValueKind>,
    mut results: BTreeMap<String, Scalar>,
) -> Result<AnswerContent, String> {
    results.retain(|name, _| form.contains_key(name));
    check_results(form, &results).map(AnswerContent::Done)
}

#[cfg(test)]
mod tests {
    use super::super::test_ledger::{asking, clerk, ledger};
    use super::*;
    use consort_protocol::ids::TaskType;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Branch, Command, PersonAnswer};
    use consort_protocol::mission::{NumberRange, TaskSpec};
    use consort_protocol::plan::StepIndex;
    use std::collections::BTreeSet;

    fn id(number: u32) -> PersonRequestId {
        format!("vital-signs-1.{number}").parse().unwrap()
    }

    fn key(number: u32) -> RoleRequest {
        (id(number), clerk())
    }

    fn sent(cluster: u64) -> SentRequest {
        let role = clerk();
        let task = TaskSpec::of(TaskType::new("deposit").unwrap(), vec![role.clone()]);
        let request = PersonRequest { role, task, holders: BTreeMap::new() };
        SentRequest { cluster: Some(ClusterId(cluster)), turn: 0, request, left_to_others: false }
    }

    #[test]
    fn a_renewed_request_has_another_id_and_every_coordinator_computes_the_same() {
        let request = id(1);
        let mut people = SimulatedPeople::default();
        people.open.insert(key(1), sent(7));
        let first = people.repeated()[0].id;
        assert_eq!(people.request_of(first).map(|(id, _)| id), Some(request.clone()));
        people.renew(first);
        people.renew(first);
        let second = people.repeated()[0].id;
        assert_ne!(second, first);
        assert_eq!(people.request_of(first), None, "it is renewed once");
        assert_eq!(SentRequest { turn: 1, ..sent(7) }.id(&request), second);
        assert_ne!(sent(8).id(&request), first, "another ledger may contain a mission of the same name");
    }

    #[test]
    fn an_answer_states_the_results_of_the_form() {
        let pulse = || ("pulse".to_owned(), Scalar::Integer(70));
        let form = BTreeMap::from([("pulse".to_owned(), ValueKind::Number(NumberRange::default()))]);
        let results = BTreeMap::from([pulse(), ("oxygen".to_owned(), Scalar::Integer(98))]);
        let stated = BTreeMap::from([("pulse".to_owned(), Scalar::Number(70.0))]);
        assert_eq!(done(&form, results.clone()), Ok(AnswerContent::Done(stated)));
        assert_eq!(done(&BTreeMap::new(), results), Ok(AnswerContent::Done(BTreeMap::new())), "a joint task");
        let missing = done(&form, BTreeMap::new()).unwrap_err();
        assert!(missing.starts_with("the result `pulse` is missing"), "{missing}");
        let wrong = done(&form, BTreeMap::from([("pulse".to_owned(), Scalar::Bool(true))])).unwrap_err();
        assert!(wrong.starts_with("the result `pulse` is `true`, but it must be"), "{wrong}");
    }

    #[test]
    fn a_cancellation_is_repeated_until_it_is_confirmed_and_their_number_is_bounded() {
        let mut people = SimulatedPeople { has_host: true, ..SimulatedPeople::default() };
        people.open.insert(key(1), sent(7));
        let commands = people.follow(&Ledger::default());
        let [PersonCommand { id: canceled, request: None }] = commands[..] else { panic!("{commands:?}") };
        assert_eq!(people.repeated(), commands);
        assert_eq!(people.repeated(), commands, "reading them does not remove them");
        people.confirm(canceled);
        assert_eq!(people.repeated(), []);
        for number in 0..200 {
            people.open.insert(key(number + 1), sent(7));
        }
        people.follow(&Ledger::default());
        assert_eq!(people.repeated().len(), CANCELLATIONS_MAX);
    }

    #[test]
    fn without_a_host_a_single_request_is_repeated_and_nothing_is_canceled() {
        let mut people = SimulatedPeople::default();
        (1..200).for_each(|number| drop(people.open.insert(key(number), sent(7))));
        assert_eq!(people.repeated().len(), 1);
        people.host_replied();
        assert_eq!(people.repeated().len(), 199);
        people.leave_to_others(people.repeated()[0].id);
        assert_eq!(people.repeated().len(), 198, "the host has nobody for it");
        let mut people = SimulatedPeople::default();
        people.open.insert(key(1), sent(7));
        assert_eq!(people.follow(&Ledger::default()), []);
    }

    const ASKED_MS: u64 = 1_700_000_000_000;

    #[test]
    fn an_escalated_request_is_sent_to_the_other_role_too() {
        let (ledger, mission) = ledger(false);
        let (role, step) = (clerk(), clerk_deposit(&ledger));
        let ask = Command::AskPerson { mission, branch: Branch::Main, role, step, asked_ms: ASKED_MS };
        assert_asks_both_roles(ledger, ask, AnswerContent::Done(BTreeMap::new()));
    }

    #[test]
    fn an_escalated_question_is_sent_to_the_other_role_which_may_decline() {
        for content in [AnswerContent::Declined, AnswerContent::Cannot] {
            let (ledger, _) = ledger(false);
            let ask = asking(&ledger, true, ASKED_MS);
            assert_asks_both_roles(ledger, ask, content);
        }
    }

    /// Both roles are asked with ids of their own; the answer of the other role cancels both.
    fn assert_asks_both_roles(mut ledger: Ledger, ask: Command, content: AnswerContent) {
        let mission = ledger.missions().next().unwrap().id.clone();
        let mut people = SimulatedPeople { has_host: true, ..SimulatedPeople::default() };
        let mut follow = |ledger: &mut Ledger, command| {
            ledger.apply(Epoch { term: 2, index: 9 }, command);
            people.follow(ledger)
        };
        let role_of = |command: &PersonCommand| command.request.as_ref().map(|request| request.role.to_string());
        let first = follow(&mut ledger, ask);
        assert_eq!(first.iter().map(role_of).collect::<Vec<_>>(), [Some("clerk".to_owned())]);
        let request = PersonRequestId { mission, number: 1 };
        let escalate = Command::EscalatePersonRequest { request: request.clone(), now_ms: ASKED_MS + 30_000 };
        let second = follow(&mut ledger, escalate);
        assert_eq!(second.iter().map(role_of).collect::<Vec<_>>(), [Some("head".to_owned())]);
        let (by, at_ms) = ("head".to_owned(), ASKED_MS + 40_000);
        let answer = PersonAnswer { by, content, note: String::new(), at_ms };
        let canceled = follow(&mut ledger, Command::AnswerPerson { request, answer, places: BTreeMap::new() });
        let ids = |commands: &[PersonCommand]| commands.iter().map(|command| command.id).collect::<BTreeSet<_>>();
        assert_eq!(ids(&canceled), ids(&[first, second].concat()), "both are canceled");
        assert!(canceled.iter().all(|command| command.request.is_none()), "{canceled:?}");
    }

    /// Returns the step of the clerk's first task.
    fn clerk_deposit(ledger: &Ledger) -> StepIndex {
        let entry = ledger.missions().next().unwrap();
        let steps = entry.plan(&clerk()).unwrap().steps.len();
        let is_task = |step: &StepIndex| entry.plan(&clerk()).unwrap().step_task(*step).is_some();
        (0..u32::try_from(steps).unwrap()).find(is_task).unwrap()
    }
}
