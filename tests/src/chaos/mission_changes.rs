//! Changes of missions by people, which some runs contain: other priorities, reassigned and pinned roles, and
//! cancelations of several missions.

use super::chaos_fleet::{ChaosFleet, MISSIONS};
use super::person_action::{CancelSelection, MissionAction};
use super::schedule::{ChaosAction, ScheduledAction};
use consort_protocol::keys::ApiCall;
use rand::seq::{IndexedRandom, SliceRandom};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::{Range, RangeInclusive};

/// Role of the carrier. The ledger refuses an order about it in a mission without this role (`shared-rounds`).
const ROLE: &str = "r1";

/// Share of the runs with changes, and their number.
const RUNS: f64 = 0.7;
const CHANGES: RangeInclusive<usize> = 2..=5;

/// Time from a request to the change of its mission: the role waits, is held or is promised then.
const AFTER_REQUEST_MS: RangeInclusive<u64> = 500..=25_000;

/// Shares of the reassignments to a named robot, and of those that permit to repeat tasks.
const TO_ROBOT: f64 = 0.5;
const REPEATED: f64 = 0.5;

/// Share of the pins that a person ends while there are faults, and their durations. The others are ended when all faults
/// have ended.
const UNPINNED: f64 = 0.5;
const UNPIN_AFTER_MS: RangeInclusive<u64> = 5_000..=40_000;

/// Shares of the runs that cancel several missions, and of these that select them by a condition.
const CANCELED: f64 = 0.25;
const BY_CONDITION: f64 = 0.3;

/// Largest number of requests that are canceled together.
const TOGETHER: usize = 2;

/// Adds changes in this period, from a generator of their own.
pub(super) fn add_mission_changes(
    seed: u64,
    composition: &ChaosFleet,
    period_ms: Range<u64>,
    steps: &mut Vec<ScheduledAction>,
) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x31_5510_4c11);
    let (is_changed, is_canceled) = (chance.random_bool(RUNS), chance.random_bool(CANCELED));
    let requests: Vec<(u64, String, bool)> = steps
        .iter()
        .filter_map(|step| match &step.action {
            ChaosAction::Submit { request, unnamed, .. } => Some((step.at_ms, request.clone(), *unnamed)),
            _ => None,
        })
        .collect();
    let latest_ms = period_ms.end - 1_000;
    if is_changed {
        for _ in 0..chance.random_range(CHANGES) {
            let Some((asked_ms, request, _)) = requests.choose(&mut chance) else { break };
            let at_ms = (asked_ms + chance.random_range(AFTER_REQUEST_MS)).clamp(period_ms.start, latest_ms);
            let robot = (*composition.carriers.choose(&mut chance).expect("a fleet has carriers")).to_owned();
            let mut push = |at_ms, change| {
                let action = ChaosAction::ChangeMission { request: request.clone(), change };
                steps.push(ScheduledAction { at_ms, action });
            };
            match chance.random_range(0..3) {
                0 => push(at_ms, MissionAction::Prioritize { priority: chance.random_range(-20..=20) }),
                1 => {
                    let to = chance.random_bool(TO_ROBOT).then_some(robot);
                    push(at_ms, MissionAction::Reassign { to, repeat: chance.random_bool(REPEATED) });
                }
                _ => {
                    push(at_ms, MissionAction::Pin { robot });
                    if chance.random_bool(UNPINNED) {
                        let end_ms = (at_ms + chance.random_range(UNPIN_AFTER_MS)).min(period_ms.end);
                        push(end_ms, MissionAction::Unpin);
                    }
                }
            }
        }
    }
    if is_canceled {
        // The ledger does not contain the name of an unnamed request, so a check could not tell what was selected.
        let mut named: Vec<&String> =
            requests.iter().filter(|(.., unnamed)| !unnamed).map(|(_, name, _)| name).collect();
        named.shuffle(&mut chance);
        named.truncate(TOGETHER);
        let selection = match chance.random_bool(BY_CONDITION) {
            true => CancelSelection::Named((*MISSIONS.choose(&mut chance).expect("there are two")).to_owned()),
            false => CancelSelection::Requests(named.into_iter().cloned().collect()),
        };
        let at_ms = chance.random_range(period_ms.start..latest_ms);
        steps.push(ScheduledAction { at_ms, action: ChaosAction::CancelMissions { selection } });
    }
}

/// Returns the request of a person for a change of a mission.
pub(super) fn request(mission: &str, change: &MissionAction) -> (ApiCall, Value) {
    let of_role = |key: &str, value: Value| {
        let mut request = json!({ "mission": mission, "role": ROLE });
        request[key] = value;
        (ApiCall::Reassign, request)
    };
    match change {
        MissionAction::Prioritize { priority } => {
            (ApiCall::Priority, json!({ "mission": mission, "priority": priority }))
        }
        MissionAction::Reassign { to, repeat } => {
            let (call, mut request) = of_role("repeat", json!(repeat));
            if let Some(to) = to {
                request["to"] = json!(to);
            }
            (call, request)
        }
        MissionAction::Pin { robot } => of_role("pin", json!(robot)),
        MissionAction::Unpin => of_role("unpin", json!(true)),
    }
}

/// Returns the condition that selects the active missions of this name.
pub(super) fn condition(mission: &str) -> String {
    format!("mission.name == {mission:?}")
}

/// Returns the request of a person that cancels several missions; `None` if it selects none. `mission_of` returns the mission
/// of an acknowledged request.
pub(super) fn cancelation(
    selection: &CancelSelection,
    mission_of: impl Fn(&String) -> Option<String>,
) -> Option<(ApiCall, Value)> {
    let missions = match selection {
        CancelSelection::Requests(requests) => {
            let missions: Vec<String> = requests.iter().filter_map(mission_of).collect();
            if missions.is_empty() {
                return None;
            }
            json!(missions)
        }
        CancelSelection::Named(mission) => json!({ "where": condition(mission) }),
    };
    Some((ApiCall::CancelMissions, json!({ "missions": missions })))
}

#[cfg(test)]
mod tests {
    use super::super::alarms::FIRST_SEED;
    use super::super::fault_kind::FaultKind;
    use super::super::generate::generate;
    use super::*;
    use consort_protocol::api::{CancelMissionsRequest, PriorityRequest, ReassignRequest};
    use consort_protocol::ledger::MissionFilter;

    #[test]
    fn some_later_runs_change_missions_in_each_way() {
        let composition = ChaosFleet::of(7);
        let changes = |seed| -> Vec<ChaosAction> {
            let steps = generate(seed, &composition, 2.0, &FaultKind::FAULTS).steps.into_iter();
            let is_change = |action: &ChaosAction| {
                matches!(action, ChaosAction::ChangeMission { .. } | ChaosAction::CancelMissions { .. })
            };
            steps.map(|step| step.action).filter(is_change).collect()
        };
        assert!((1..FIRST_SEED).all(|seed| changes(seed).is_empty()));
        let later: Vec<_> = (FIRST_SEED..FIRST_SEED + 80).map(changes).collect();
        assert!(later.iter().filter(|changes| changes.is_empty()).count() >= 5);
        let count = |is: &dyn Fn(&MissionAction) -> bool| {
            let has = |action: &ChaosAction| matches!(action, ChaosAction::ChangeMission { change, .. } if is(change));
            later.iter().filter(|changes| changes.iter().any(has)).count()
        };
        assert!(count(&|change| matches!(change, MissionAction::Prioritize { .. })) >= 5);
        assert!(count(&|change| matches!(change, MissionAction::Reassign { to: None, .. })) >= 5);
        assert!(count(&|change| matches!(change, MissionAction::Reassign { to: Some(_), .. })) >= 5);
        assert!(count(&|change| matches!(change, MissionAction::Pin { .. })) >= 5);
        assert!(count(&|change| matches!(change, MissionAction::Unpin)) >= 3);
        let canceled = |is: &dyn Fn(&CancelSelection) -> bool| {
            let has =
                |action: &ChaosAction| matches!(action, ChaosAction::CancelMissions { selection } if is(selection));
            later.iter().filter(|changes| changes.iter().any(has)).count()
        };
        assert!(canceled(&|selection| matches!(selection, CancelSelection::Requests(_))) >= 3);
        assert!(canceled(&|selection| matches!(selection, CancelSelection::Named(_))) >= 1);
    }

    #[test]
    fn requests_are_those_of_the_api() {
        use MissionAction::{Pin, Prioritize, Reassign, Unpin};
        let (call, payload) = request("lab-samples-1", &Prioritize { priority: -5 });
        assert_eq!(call, ApiCall::Priority);
        assert_eq!(serde_json::from_value::<PriorityRequest>(payload).unwrap().priority, -5);
        let robot = || "garnet".to_owned();
        for change in [
            Reassign { to: None, repeat: true },
            Reassign { to: Some(robot()), repeat: false },
            Pin { robot: robot() },
            Unpin,
        ] {
            let (call, payload) = request("lab-samples-1", &change);
            let parsed: ReassignRequest = serde_json::from_value(payload).unwrap();
            assert_eq!((call, parsed.role.as_str()), (ApiCall::Reassign, ROLE));
            let given = [parsed.to.is_some(), parsed.pin.is_some(), parsed.unpin];
            let expected = match change {
                Reassign { to, .. } => [to.is_some(), false, false],
                Pin { .. } => [false, true, false],
                Unpin => [false, false, true],
                Prioritize { .. } => [false; 3],
            };
            assert_eq!(given, expected);
        }
        let mission_of = |request: &String| (request == "r0").then(|| "lab-samples-1".to_owned());
        let selected = |requests: &[&str]| {
            let requests = requests.iter().map(|request| (*request).to_owned()).collect();
            cancelation(&CancelSelection::Requests(requests), mission_of)
        };
        assert_eq!(selected(&["r1"]), None, "it is not acknowledged");
        let by_condition = cancelation(&CancelSelection::Named("lab-samples".to_owned()), mission_of);
        for (call, payload) in [selected(&["r0", "r1"]), by_condition].into_iter().flatten() {
            assert_eq!(call, ApiCall::CancelMissions);
            serde_json::from_value::<CancelMissionsRequest>(payload).unwrap();
        }
        MissionFilter::compile(&condition("lab-samples")).unwrap_or_else(|problem| panic!("{problem}"));
    }
}
