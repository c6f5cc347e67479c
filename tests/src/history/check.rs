//! Checks of a history.

use super::mission_spec::{MissionOp, MissionResult, MissionSpec};
use super::{ClientCall, ClientReply, EndedMissions, MAYBE_REPEATED, Operation, Pause};
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use stateright::semantics::{ConsistencyTester, LinearizabilityTester};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::time::Duration;

/// Time that comes on top of the age that a reply states: the delay of a leader's message, up to
/// 1.2 s in these runs, and the time for which a leader without a majority continues.
const AGE_TOLERANCE: Duration = Duration::from_secs(3);

/// Checks the requests and the linearizable reads of all clients.
pub(super) fn check_linearizable(operations: &[Operation], ended: EndedMissions) -> Result<(), String> {
    check_missions(operations, ended)?;
    check_revisions(operations)
}

/// Operation on a single mission.
struct MissionOperation {
    op: MissionOp,
    invoked: u64,
    returned: Option<(u64, MissionResult)>,
}

/// Checks each mission by itself. Linearizability is local: a history is linearizable if its part
/// about each object is.
fn check_missions(operations: &[Operation], ended: EndedMissions) -> Result<(), String> {
    for (name, operations) in by_mission(operations, ended) {
        if !is_linearizable(&operations) {
            return Err(format!("the calls about {name} have no linearization:{}", text(&operations)));
        }
    }
    Ok(())
}

/// Divides the history by mission. A mission is named by its request, or by its id if the request has
/// no name.
fn by_mission(operations: &[Operation], ended: EndedMissions) -> BTreeMap<String, Vec<MissionOperation>> {
    let (names, missions) = names(operations);
    let name = |mission: &MissionId| names.get(mission).cloned().unwrap_or_else(|| mission.to_string());
    let mut parts: BTreeMap<String, Vec<MissionOperation>> =
        missions.iter().map(|mission| (name(mission), vec![])).collect();
    let is_unnamed = |part: &String| !names.values().any(|name| name == part);
    for Operation { call, invoked, returned } in operations {
        let reply = returned.as_ref().map(|(_, reply)| reply);
        let mut add = |part: String, op, result: Option<MissionResult>| {
            let returned = returned.as_ref().zip(result).map(|((at, _), result)| (at.order, result));
            parts.entry(part).or_default().push(MissionOperation { op, invoked: invoked.order, returned });
        };
        match (call, reply) {
            (ClientCall::Submit { request }, Some(ClientReply::Submitted(reply))) => {
                let part = request.clone().unwrap_or_else(|| reply.mission.to_string());
                let (mission, again, outcome) = (reply.mission.clone(), reply.again, reply.outcome.clone());
                add(part, MissionOp::Submit, Some(MissionResult::Submitted { mission, again, outcome }));
            }
            (ClientCall::Submit { request: Some(request) }, reply) => {
                add(request.clone(), MissionOp::Submit, reply.map(refusal));
            }
            (ClientCall::Submit { request: None }, Some(_)) => {}
            // It may have created any of the missions without a name.
            (ClientCall::Submit { request: None }, None) => {
                for part in missions.iter().map(name).filter(is_unnamed) {
                    add(part, MissionOp::Submit, None);
                }
            }
            (ClientCall::Cancel { mission } | ClientCall::Resolve { mission }, reply) => {
                let op = if matches!(call, ClientCall::Cancel { .. }) { MissionOp::Cancel } else { MissionOp::Resolve };
                let result = reply.map(|reply| match reply {
                    ClientReply::Changed(state) => MissionResult::Changed(state.clone()),
                    _ => MissionResult::Refused,
                });
                add(name(mission), op, result);
            }
            (ClientCall::Get { mission }, Some(ClientReply::Read { states, .. })) => {
                add(name(mission), MissionOp::Read, Some(MissionResult::Read(states.get(mission).cloned())));
            }
            (ClientCall::Get { mission }, Some(_)) => {
                let result = if ended.are_forgotten { MissionResult::Forgotten } else { MissionResult::Read(None) };
                add(name(mission), MissionOp::Read, Some(result));
            }
            (ClientCall::List { linearizable: true }, Some(ClientReply::Read { states, .. })) => {
                for mission in &missions {
                    let result = match states.get(mission) {
                        None if lacks_ended(states, ended.listed_max) => MissionResult::NotListed,
                        state => MissionResult::Read(state.cloned()),
                    };
                    add(name(mission), MissionOp::Read, Some(result));
                }
            }
            (ClientCall::Get { .. } | ClientCall::List { .. }, _) => {}
        }
    }
    parts
}

/// Returns the result of a refused submission.
fn refusal(reply: &ClientReply) -> MissionResult {
    match reply {
        ClientReply::Refused(error) if error.contains(MAYBE_REPEATED) => MissionResult::Forgotten,
        _ => MissionResult::Refused,
    }
}

/// Checks whether a list may lack missions that have ended.
fn lacks_ended(states: &BTreeMap<MissionId, MissionState>, listed_max: usize) -> bool {
    states.values().filter(|state| state.has_ended()).count() >= listed_max
}

/// Returns the requests of missions with named requests, and all missions of the history.
fn names(operations: &[Operation]) -> (BTreeMap<MissionId, String>, BTreeSet<MissionId>) {
    let (mut names, mut missions) = (BTreeMap::new(), BTreeSet::new());
    for Operation { call, returned, .. } in operations {
        match (call, returned) {
            (ClientCall::Submit { request }, Some((_, ClientReply::Submitted(reply)))) => {
                missions.insert(reply.mission.clone());
                request.iter().for_each(|request| drop(names.insert(reply.mission.clone(), request.clone())));
            }
            (ClientCall::List { linearizable: true }, Some((_, ClientReply::Read { states, .. }))) => {
                missions.extend(states.keys().cloned());
            }
            _ => {}
        }
    }
    (names, missions)
}

/// Thread number of the first operation without a result. The tester tries threads in ascending order,
/// and these may also never have been executed.
const FIRST_UNKNOWN: usize = 1_000_000;

fn is_linearizable(operations: &[MissionOperation]) -> bool {
    enum Step {
        Invoke(MissionOp),
        Return(MissionResult),
    }
    let mut steps: Vec<(u64, usize, Step)> = vec![];
    // Each thread has one operation at a time: the last return of each.
    let mut threads: Vec<u64> = vec![];
    for MissionOperation { op, invoked, returned } in without_redundant(operations) {
        let thread = match returned {
            None => FIRST_UNKNOWN + *op as usize,
            Some((returned, _)) => {
                let free = threads.iter().position(|last| last < invoked).unwrap_or(threads.len());
                threads.resize(threads.len().max(free + 1), 0);
                threads[free] = *returned;
                free
            }
        };
        steps.push((*invoked, thread, Step::Invoke(*op)));
        if let Some((returned, result)) = returned {
            steps.push((*returned, thread, Step::Return(result.clone())));
        }
    }
    steps.sort_by_key(|(order, thread, _)| (*order, *thread));
    let mut tester = LinearizabilityTester::new(MissionSpec::default());
    let recorded = steps.into_iter().try_for_each(|(_, thread, step)| match step {
        Step::Invoke(op) => tester.on_invoke(thread, op).map(drop),
        Step::Return(result) => tester.on_return(thread, result).map(drop),
    });
    recorded.is_ok() && tester.is_consistent()
}

/// Returns the operations in the order of their invocations, without those that add no condition: an
/// operation without a result, if the same was invoked before; and a read, if a read that was invoked
/// at the same moment returned the same earlier.
fn without_redundant(operations: &[MissionOperation]) -> Vec<&MissionOperation> {
    let mut sorted: Vec<&MissionOperation> = operations.iter().collect();
    sorted.sort_by_key(|operation| (operation.invoked, operation.returned.as_ref().map(|(at, _)| *at)));
    let mut unknown = BTreeSet::new();
    let mut kept: Vec<&MissionOperation> = vec![];
    for operation in sorted {
        let is_redundant = match &operation.returned {
            None => operation.op == MissionOp::Read || !unknown.insert(operation.op),
            Some((_, result)) => {
                let same_call = kept.iter().rev().take_while(|other| other.invoked == operation.invoked);
                operation.op == MissionOp::Read
                    && same_call.filter_map(|other| other.returned.as_ref()).any(|(_, known)| known == result)
            }
        };
        if !is_redundant {
            kept.push(operation);
        }
    }
    kept
}

/// Checks that a linearizable read is never older than one that had returned before it began.
fn check_revisions(operations: &[Operation]) -> Result<(), String> {
    let mut returned: Vec<(u64, u64)> =
        linearizable_reads(operations).map(|read| (read.returned, read.revision)).collect();
    returned.sort_unstable();
    // The greatest revision up to each return.
    let mut greatest = 0;
    for (_, revision) in &mut returned {
        greatest = greatest.max(*revision);
        *revision = greatest;
    }
    for read in linearizable_reads(operations) {
        let before = returned.partition_point(|(order, _)| *order < read.invoked);
        let floor = before.checked_sub(1).map_or(0, |last| returned[last].1);
        if read.revision < floor {
            let at = read.at.as_secs_f64();
            return Err(format!(
                "a linearizable read at {at:.3} s returned revision {}, after another had returned {floor}",
                read.revision
            ));
        }
    }
    Ok(())
}

/// Linearizable read of any missions.
struct LinearizableRead {
    invoked: u64,
    returned: u64,
    at: Duration,
    revision: u64,
}

fn linearizable_reads(operations: &[Operation]) -> impl Iterator<Item = LinearizableRead> {
    operations.iter().filter(|operation| operation.call != ClientCall::List { linearizable: false }).filter_map(
        |Operation { invoked, returned, .. }| match returned {
            Some((returned, ClientReply::Read { copy, .. })) => Some(LinearizableRead {
                invoked: invoked.order,
                returned: returned.order,
                at: returned.at,
                revision: copy.revision,
            }),
            _ => None,
        },
    )
}

/// Checks that a read from any node contains everything that was acknowledged before its stated age,
/// except by nodes that were paused: the age counts from the arrival of messages, and a pause delays
/// them.
pub(super) fn check_ages(operations: &[Operation], pauses: &[Pause], listed_max: usize) -> Result<(), String> {
    for Operation { call, invoked, returned } in operations {
        let (ClientCall::List { linearizable: false }, Some((_, ClientReply::Read { node, copy, states }))) =
            (call, returned)
        else {
            continue;
        };
        let Some(age) = copy.age_ms.map(Duration::from_millis) else { continue };
        let complete_until = invoked.at.saturating_sub(age + AGE_TOLERANCE);
        let is_paused = |pause: &Pause| {
            pause.node == *node && pause.began <= invoked.at && pause.ended.is_none_or(|ended| ended >= complete_until)
        };
        if pauses.iter().any(is_paused) {
            continue;
        }
        let error = |problem: String| {
            let (at, age) = (invoked.at.as_secs_f64(), age.as_secs_f64());
            Err(format!("{node} answered a read at {at:.3} s from a copy that should be {age:.3} s old: {problem}"))
        };
        for Operation { returned, .. } in operations {
            if let Some((returned, ClientReply::Submitted(reply))) = returned
                && returned.at < complete_until
                && !states.contains_key(&reply.mission)
                && !lacks_ended(states, listed_max)
            {
                let at = returned.at.as_secs_f64();
                return error(format!("{} is missing, acknowledged at {at:.3} s", reply.mission));
            }
        }
        let newer = |read: &LinearizableRead| read.at < complete_until && read.revision > copy.revision;
        if let Some(newer) = linearizable_reads(operations).find(newer) {
            let (at, known) = (newer.at.as_secs_f64(), newer.revision);
            return error(format!("it has revision {}, but at {at:.3} s there was {known}", copy.revision));
        }
    }
    Ok(())
}

fn text(operations: &[MissionOperation]) -> String {
    let mut text = String::new();
    for MissionOperation { op, invoked, returned } in without_redundant(operations) {
        let (returned, result) = match returned {
            Some((returned, result)) => (returned.to_string(), result),
            None => ("…".to_owned(), &MissionResult::Unknown),
        };
        write!(text, "\n  {invoked}–{returned} {op:?}: {result:?}").expect("a string can be written");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::Moment;
    use super::*;
    use consort_protocol::api::SubmitReply;
    use consort_protocol::view::LedgerCopy;

    const REQUEST: &str = "r1";
    const LISTED_MAX: usize = 500;
    const REMEMBERED: EndedMissions = EndedMissions { listed_max: LISTED_MAX, are_forgotten: false };

    fn mission() -> MissionId {
        "lab-samples-1".parse().unwrap()
    }

    fn moment(order: u64) -> Moment {
        Moment { order, at: Duration::from_secs(order) }
    }

    /// Creates an operation with the seconds of its invocation and its return.
    fn call(call: ClientCall, invoked: u64, returned: u64, reply: ClientReply) -> Operation {
        Operation { call, invoked: moment(invoked), returned: Some((moment(returned), reply)) }
    }

    fn submit(invoked: u64, returned: u64, again: bool) -> Operation {
        let reply = SubmitReply { mission: mission(), again, outcome: None };
        let request = Some(REQUEST.to_owned());
        call(ClientCall::Submit { request }, invoked, returned, ClientReply::Submitted(reply))
    }

    fn submit_without_reply(invoked: u64) -> Operation {
        let call = ClientCall::Submit { request: Some(REQUEST.to_owned()) };
        Operation { call, invoked: moment(invoked), returned: None }
    }

    fn read(list: ClientCall, invoked: u64, returned: u64, revision: u64, state: Option<MissionState>) -> Operation {
        let linearizable = list != ClientCall::List { linearizable: false };
        let copy = LedgerCopy { revision, age_ms: Some(0), linearizable };
        let states = state.into_iter().map(|state| (mission(), state)).collect();
        call(list, invoked, returned, ClientReply::Read { node: "aster".parse().unwrap(), copy, states })
    }

    fn list(invoked: u64, returned: u64, revision: u64, state: Option<MissionState>) -> Operation {
        read(ClientCall::List { linearizable: true }, invoked, returned, revision, state)
    }

    fn get(invoked: u64, returned: u64, state: MissionState) -> Operation {
        read(ClientCall::Get { mission: mission() }, invoked, returned, 9, Some(state))
    }

    fn cancel(invoked: u64, returned: u64) -> Operation {
        let reply = ClientReply::Changed(Some(canceled()));
        call(ClientCall::Cancel { mission: mission() }, invoked, returned, reply)
    }

    fn canceled() -> MissionState {
        MissionState::Canceled { by: super::super::CLIENT.to_owned() }
    }

    #[track_caller]
    fn assert_holds(operations: &[Operation]) {
        assert_eq!(check_linearizable(operations, REMEMBERED), Ok(()));
    }

    #[track_caller]
    fn assert_violated(operations: &[Operation], reason: &str) {
        let error = check_linearizable(operations, REMEMBERED).unwrap_err();
        assert!(error.contains(reason), "{error}");
    }

    const NO_LINEARIZATION: &str = "the calls about r1 have no linearization";

    #[test]
    fn reads_during_a_submission_may_or_may_not_contain_it() {
        let pending = || Some(MissionState::Pending);
        assert_holds(&[submit(1, 6, false), list(2, 3, 1, None), list(4, 5, 2, pending())]);
        assert_violated(&[submit(1, 6, false), list(2, 3, 2, pending()), list(4, 5, 2, None)], NO_LINEARIZATION);
    }

    #[test]
    fn an_acknowledged_mission_is_in_every_later_read() {
        assert_violated(&[submit(1, 2, false), list(3, 4, 1, None)], NO_LINEARIZATION);
    }

    #[test]
    fn a_request_creates_a_single_mission() {
        assert_holds(&[submit(1, 2, false), submit(3, 4, true)]);
        assert_holds(&[submit_without_reply(1), submit(2, 3, true)]);
        assert_violated(&[submit(1, 2, false), submit(3, 4, false)], NO_LINEARIZATION);
        assert_violated(&[submit(1, 2, true)], NO_LINEARIZATION);
    }

    #[test]
    fn an_acknowledged_cancellation_has_taken_effect() {
        assert_holds(&[submit(1, 2, false), cancel(3, 4), get(5, 6, canceled())]);
        assert_violated(&[submit(1, 2, false), cancel(3, 4), get(5, 6, MissionState::Running)], NO_LINEARIZATION);
        assert_violated(&[submit(1, 2, false), get(5, 6, canceled())], NO_LINEARIZATION);
    }

    #[test]
    fn an_ended_mission_does_not_continue() {
        let operations = [submit(1, 2, false), get(3, 4, MissionState::Completed), get(5, 6, MissionState::Running)];
        assert_violated(&operations, NO_LINEARIZATION);
    }

    #[test]
    fn a_forgotten_mission_is_neither_found_nor_executed_again() {
        let refused = |asked: ClientCall, invoked, text: &str| {
            call(asked, invoked, invoked + 1, ClientReply::Refused(text.to_owned()))
        };
        let not_found = |invoked| refused(ClientCall::Get { mission: mission() }, invoked, "no such mission");
        let repeated = |invoked| {
            let asked = ClientCall::Submit { request: Some(REQUEST.to_owned()) };
            refused(asked, invoked, &format!("it is old; {MAYBE_REPEATED} 7"))
        };
        let forgotten = EndedMissions { are_forgotten: true, ..REMEMBERED };
        let holds = |operations: &[Operation]| check_linearizable(operations, forgotten).is_ok();
        let completed = || get(3, 4, MissionState::Completed);
        assert!(holds(&[submit(1, 2, false), completed(), not_found(5), repeated(7)]));
        assert_violated(&[submit(1, 2, false), completed(), not_found(5)], NO_LINEARIZATION);
        for gone in [not_found(5), repeated(5)] {
            let again = |last| holds(&[submit(1, 2, false), gone.clone(), last]);
            assert!(!again(submit(7, 8, false)) && !again(submit(7, 8, true)), "{gone:?}");
            assert!(!again(get(7, 8, MissionState::Completed)), "{gone:?}");
        }
    }

    #[test]
    fn revisions_of_linearizable_reads_never_decrease() {
        assert_holds(&[list(1, 4, 7, None), list(2, 3, 8, None)]);
        assert_violated(
            &[list(1, 2, 8, None), list(3, 4, 7, None)],
            "returned revision 7, after another had returned 8",
        );
    }

    #[test]
    fn other_reads_are_at_most_as_old_as_they_say() {
        let local = |invoked, state| read(ClientCall::List { linearizable: false }, invoked, invoked + 1, 1, state);
        assert_eq!(check_ages(&[submit(1, 2, false), local(4, None)], &[], LISTED_MAX), Ok(()), "within the tolerance");
        let operations = [submit(1, 2, false), local(20, None)];
        let error = check_ages(&operations, &[], LISTED_MAX).unwrap_err();
        assert!(error.contains("lab-samples-1 is missing, acknowledged at 2.000 s"), "{error}");
        let pause =
            Pause { node: "aster".parse().unwrap(), began: Duration::ZERO, ended: Some(Duration::from_secs(19)) };
        assert_eq!(check_ages(&operations, &[pause], LISTED_MAX), Ok(()), "the node was paused shortly before");
    }
}
