//! Facts about missions and the fleet.

use super::fixture::Fixture;
use super::robot_facts::expect_value;
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{FactStep, fact};
use super::step_result::{StepFailure, expect_that};
use crate::RoleInterval;
use consort_protocol::auction::BidVerdict;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::ledger::{MissionEntry, MissionState};

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<FactStep> {
    vec![
        mission_state_is(),
        mission_has_failed(),
        mission_needs_intervention(),
        mission_was_canceled(),
        mission_has_ended(),
        mission_result_is(),
        request_was_refused(),
        all_missions_are_completed(),
        robot_holds_role(),
        robot_never_had_a_role(),
        task_has_begun(),
        task_has_begun_times(),
        task_has_ended(),
        robot_did_task(),
        every_task_was_done_once(),
        every_active_role_had_its_own_robot(),
        role_was_taken(),
        robot_did_not_get_role(),
        robot_retried_a_task(),
        coordinator_exists(),
        no_coordinator_exists(),
        node_is_coordinator(),
        another_node_is_coordinator(),
        number_of_coordinators(),
    ]
}

fn mission_state_is() -> FactStep {
    fact("{mission} is {state}", "the mission is completed", |fixture, arguments| {
        let state = state_of(fixture, &fixture.mission(arguments.value(0))?)?;
        let wanted = match arguments.value(1) {
            "in need of intervention" => "needs_intervention",
            word => word,
        };
        expect_that(state.as_str() == wanted, || state_text(&state))
    })
}

fn mission_has_failed() -> FactStep {
    fact("{mission} has failed because {text}", r#"the mission has failed because "no route""#, |fixture, arguments| {
        let state = state_of(fixture, &fixture.mission(arguments.value(0))?)?;
        let because = |cause: &str| cause.contains(arguments.value(1));
        expect_that(matches!(&state, MissionState::Failed { cause, .. } if because(cause)), || state_text(&state))
    })
}

fn mission_needs_intervention() -> FactStep {
    fact(
        "{mission} needs intervention because {text}",
        r#"the mission needs intervention because "canceled by""#,
        |fixture, arguments| {
            let state = state_of(fixture, &fixture.mission(arguments.value(0))?)?;
            let because = |cause: &str| cause.contains(arguments.value(1));
            expect_that(matches!(&state, MissionState::NeedsIntervention { cause, .. } if because(cause)), || {
                state_text(&state)
            })
        },
    )
}

fn mission_was_canceled() -> FactStep {
    fact(
        "{mission} was canceled by {text}",
        r#"the mission was canceled by "nurse of IC Room 6""#,
        |fixture, arguments| {
            let state = state_of(fixture, &fixture.mission(arguments.value(0))?)?;
            expect_that(matches!(&state, MissionState::Canceled { by } if by == arguments.value(1)), || {
                state_text(&state)
            })
        },
    )
}

fn mission_has_ended() -> FactStep {
    fact("{mission} has ended", "the mission has ended", |fixture, arguments| {
        let state = state_of(fixture, &fixture.mission(arguments.value(0))?)?;
        expect_that(state.is_final(), || state_text(&state))
    })
}

fn mission_result_is() -> FactStep {
    let (pattern, example) =
        ("the result {text} of {mission} is {value}", r#"the result "dust_g" of the mission is 2.5"#);
    fact(pattern, example, |fixture, arguments| {
        let mission = fixture.mission(arguments.value(1))?;
        let results = fixture.fleet()?.ledger(|ledger| ledger.mission(&mission).map(MissionEntry::results)).flatten();
        match results.unwrap_or_default().get(arguments.value(0)) {
            Some(result) => expect_value(result, arguments.value(2)),
            None => Err(StepFailure::NotMet("it is not known".to_owned())),
        }
    })
}

fn request_was_refused() -> FactStep {
    fact(
        "the request was refused because {text}",
        r#"the request was refused because "did you mean""#,
        |fixture, arguments| {
            let Some(refused) = &fixture.refused else {
                return Err(StepFailure::NotMet("no request was refused".to_owned()));
            };
            refused.checked.set(true);
            expect_that(refused.why.contains(arguments.value(0)), || refused.why.clone())
        },
    )
}

fn all_missions_are_completed() -> FactStep {
    fact("all missions are completed", "all missions are completed", |fixture, _| {
        if fixture.missions.is_empty() {
            return Err(StepFailure::invalid("no mission was requested"));
        }
        for (request, mission) in &fixture.missions {
            let state = state_of(fixture, mission)?;
            expect_that(state == MissionState::Completed, || format!("mission {request} {}", state_text(&state)))?;
        }
        Ok(())
    })
}

fn robot_holds_role() -> FactStep {
    fact("{name} is {name} of {mission}", "amber is r1 of the mission", |fixture, arguments| {
        let mission = fixture.mission(arguments.value(2))?;
        let holder = fixture.fleet()?.holder(&mission, arguments.value(1)).map(|robot| robot.to_string());
        expect_that(holder.as_deref() == Some(arguments.value(0)), || match holder {
            Some(holder) => format!("{holder} is"),
            None => "no robot is".to_owned(),
        })
    })
}

fn robot_never_had_a_role() -> FactStep {
    fact("{name} never had a role in {mission}", "amber never had a role in the mission", |fixture, arguments| {
        fixture.robot(arguments.value(0))?;
        let ever = fixture.fleet()?.all_holders(&fixture.mission(arguments.value(1))?);
        expect_that(!ever.contains(arguments.value(0)), || {
            let ever: Vec<&str> = ever.iter().map(String::as_str).collect();
            format!("roles were given to {}", ever.join(", "))
        })
    })
}

fn task_has_begun() -> FactStep {
    fact("task {name} has begun", "task navto_lab has begun", |fixture, arguments| {
        let task_starts = task_starts(fixture, arguments)?;
        expect_that(!task_starts.is_empty(), || "it has not begun".to_owned())
    })
}

fn task_has_begun_times() -> FactStep {
    fact("task {name} has begun {number} times", "task navto_room has begun 2 times", |fixture, arguments| {
        let task_starts = task_starts(fixture, arguments)?;
        expect_that(task_starts.len() as f64 == arguments.number(1), || {
            format!("it has begun {} times: {}", task_starts.len(), task_starts.join(", "))
        })
    })
}

fn task_has_ended() -> FactStep {
    fact("task {name} has ended", "task navto_lab has ended", |fixture, arguments| {
        let mission = fixture.mission("the mission")?;
        let executors = fixture.fleet()?.event_log.task_executors(&mission);
        expect_that(executors.get(arguments.value(0)).is_some_and(|(_, ended)| !ended.is_empty()), || {
            "it has not ended".to_owned()
        })
    })
}

fn robot_did_task() -> FactStep {
    fact("{name} did task {name}", "birch did task navto_lab", |fixture, arguments| {
        let mission = fixture.mission("the mission")?;
        let executors = fixture.fleet()?.event_log.task_executors(&mission);
        let ended = executors.get(arguments.value(1)).map(|(_, ended)| ended.clone()).unwrap_or_default();
        expect_that(ended.iter().any(|executor| executor == arguments.value(0)), || match ended[..] {
            [] => "no robot did".to_owned(),
            _ => format!("{} did", ended.join(", ")),
        })
    })
}

fn every_task_was_done_once() -> FactStep {
    fact("every task of {mission} was done once", "every task of the mission was done once", |fixture, arguments| {
        let mission = fixture.mission(arguments.value(0))?;
        let tasks = fixture.fleet()?.task_counts(&mission);
        expect_that(!tasks.is_empty(), || "no task was begun".to_owned())?;
        let repeated = tasks.iter().find(|(_, counts)| **counts != (1, 1));
        expect_that(repeated.is_none(), || {
            let (task, (task_starts, ended)) = repeated.expect("checked before");
            format!("{task} was begun {task_starts} times and ended {ended} times")
        })
    })
}

fn every_active_role_had_its_own_robot() -> FactStep {
    fact("every active role had its own robot", "every active role had its own robot", |fixture, _| {
        let intervals = fixture.fleet()?.event_log.role_intervals();
        let pairs = intervals
            .iter()
            .enumerate()
            .flat_map(|(at, first)| intervals[at + 1..].iter().map(move |second| (first, second)));
        let same_role = |first: &RoleInterval, second: &RoleInterval| {
            (&first.mission, &first.role) == (&second.mission, &second.role)
        };
        let mut clashes = pairs.filter(|(first, second)| {
            first.overlaps(second) && (first.robot == second.robot || same_role(first, second))
        });
        let clash = clashes.next();
        expect_that(clash.is_none(), || {
            let (first, second) = clash.expect("checked before");
            format!(
                "{} as {} of {}, and at the same time {} as {} of {}",
                first.robot, first.role, first.mission, second.robot, second.role, second.mission
            )
        })
    })
}

fn role_was_taken() -> FactStep {
    fact(
        "{name} was taken from a robot because {text}",
        r#"r1 was taken from a robot because "battery""#,
        |fixture, arguments| {
            let causes = matching_events(fixture, |what| match what {
                EventKind::Released { role, cause, .. } if role.as_str() == arguments.value(0) => Some(cause.clone()),
                _ => None,
            })?;
            expect_that(causes.iter().any(|cause| cause.contains(arguments.value(1))), || {
                causes_text("it was taken because", &causes)
            })
        },
    )
}

fn robot_did_not_get_role() -> FactStep {
    fact("{name} did not get {name} because {text}", r#"cedar did not get r1 because "lacks""#, |fixture, arguments| {
        let reasons: Vec<String> = matching_events(fixture, |what| match what {
            EventKind::Closed { record, .. } => Some(record.clone()),
            _ => None,
        })?
        .into_iter()
        .flat_map(|record| record.entries)
        .filter(|entry| entry.robots().any(|robot| robot.as_str() == arguments.value(0)))
        .filter(|entry| entry.role.as_str() == arguments.value(1))
        .map(|entry| match entry.verdict {
            BidVerdict::Viable { time, .. } => format!("nothing: it bid {:.1} s", time.get()),
            BidVerdict::Unviable { why, .. } => why.to_string(),
            BidVerdict::Refused { reason } => reason.to_string(),
            BidVerdict::NotAsked { reason, .. } => reason.to_string(),
        })
        .collect();
        expect_that(reasons.iter().any(|reason| reason.contains(arguments.value(2))), || {
            causes_text("it did not because of", &reasons)
        })
    })
}

fn robot_retried_a_task() -> FactStep {
    fact("{name} retried a task because {text}", r#"amber retried a task because "closed""#, |fixture, arguments| {
        let fleet = fixture.fleet()?;
        let entries = fleet.event_log.entries();
        let causes: Vec<String> = entries
            .iter()
            .filter(|(_, entry)| entry.node().as_str() == arguments.value(0))
            .filter_map(|(_, entry)| match entry.event_kind()? {
                EventKind::TaskRetried { cause, .. } => Some(cause.clone()),
                _ => None,
            })
            .collect();
        expect_that(causes.iter().any(|cause| cause.contains(arguments.value(1))), || {
            causes_text("it retried a task because", &causes)
        })
    })
}

fn coordinator_exists() -> FactStep {
    fact("there is a coordinator", "there is a coordinator", |fixture, _| {
        expect_that(fixture.fleet()?.coordinating().is_some(), || "there is none".to_owned())
    })
}

fn no_coordinator_exists() -> FactStep {
    fact("there is no coordinator", "there is no coordinator", |fixture, _| {
        let coordinator = fixture.fleet()?.coordinating();
        expect_that(coordinator.is_none(), || format!("{} is", coordinator.expect("checked before")))
    })
}

fn node_is_coordinator() -> FactStep {
    fact("node {name} is the coordinator", "node aster is the coordinator", |fixture, arguments| {
        let coordinator = fixture.fleet()?.coordinating();
        expect_that(coordinator.as_ref().is_some_and(|node| node.as_str() == arguments.value(0)), || {
            coordinator_text(coordinator.as_ref())
        })
    })
}

fn another_node_is_coordinator() -> FactStep {
    fact("another node is the coordinator", "another node is the coordinator", |fixture, _| {
        let Some(previous) = &fixture.former_coordinator else {
            return Err(StepFailure::invalid("no coordinator was killed or cut off in this scenario"));
        };
        let coordinator = fixture.fleet()?.coordinating();
        expect_that(coordinator.as_ref().is_some_and(|node| node.as_str() != previous), || {
            coordinator_text(coordinator.as_ref())
        })
    })
}

fn number_of_coordinators() -> FactStep {
    fact("the fleet has had {number} coordinator(s)", "the fleet has had 2 coordinators", |fixture, arguments| {
        let terms = matching_events(fixture, |what| matches!(what, EventKind::Elected { .. }).then_some(()))?.len();
        expect_that(terms as f64 == arguments.number(0), || format!("it has had {terms}"))
    })
}

fn coordinator_text(node: Option<&NodeId>) -> String {
    node.map_or_else(|| "there is none".to_owned(), |node| format!("{node} is"))
}

fn causes_text(what: &str, list: &[String]) -> String {
    if list.is_empty() { format!("{what} … there was no such event") } else { format!("{what}: {}", list.join("; ")) }
}

fn matching_events<T>(fixture: &Fixture, of: impl Fn(&EventKind) -> Option<T>) -> Result<Vec<T>, StepFailure> {
    Ok(fixture.fleet()?.events().iter().filter_map(of).collect())
}

fn task_starts(fixture: &Fixture, arguments: &StepArguments) -> Result<Vec<String>, StepFailure> {
    let task: consort_protocol::ids::TaskId = name(arguments.value(0))?;
    // Before the first request no task has begun.
    let Ok(mission) = fixture.mission("the mission") else { return Ok(vec![]) };
    let executors = fixture.fleet()?.event_log.task_executors(&mission);
    Ok(executors.get(task.as_str()).map(|(task_starts, _)| task_starts.clone()).unwrap_or_default())
}

fn state_of(fixture: &Fixture, mission: &MissionId) -> Result<MissionState, StepFailure> {
    let state = fixture.fleet()?.mission_state(mission);
    state.ok_or_else(|| StepFailure::NotMet("no running node has it".to_owned()))
}

/// Describes the state of a mission.
fn state_text(state: &MissionState) -> String {
    match state {
        MissionState::Pending => "is pending".to_owned(),
        MissionState::Running => "is running".to_owned(),
        MissionState::Completed => "is completed".to_owned(),
        MissionState::Failed { cause, .. } => format!("has failed: {cause}"),
        MissionState::Canceled { by } => format!("was canceled by {by}"),
        MissionState::NeedsIntervention { cause, items, .. } => {
            let items: Vec<String> = items.iter().map(|item| format!("{} with {}", item.item, item.robot)).collect();
            format!("needs intervention ({}): {cause}", items.join(", "))
        }
    }
}
