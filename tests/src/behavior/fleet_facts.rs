//! Facts of missions and of the fleet.

use super::fixture::Fixture;
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{FactFn, StepFailure, StepPattern, expect_that};
use crate::RoleInterval;
use consort_protocol::auction::BidVerdict as Answer;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::ledger::MissionState;

/// All of them.
pub(super) fn phrases() -> Vec<StepPattern<FactFn>> {
    let is = |pattern, example, fact: FactFn| StepPattern::new(pattern, example, fact);
    vec![
        is("{mission} is {state}", "the mission is completed", |stage, said| {
            let state = state_of(stage, &stage.mission(said.value(0))?)?;
            let wanted = match said.value(1) {
                "in need of rescue" => "needs_rescue",
                word => word,
            };
            expect_that(state.as_str() == wanted, || in_words(&state))
        }),
        is("{mission} has failed because {text}", r#"the mission has failed because "no route""#, |stage, said| {
            let state = state_of(stage, &stage.mission(said.value(0))?)?;
            let because = |cause: &str| cause.contains(said.value(1));
            expect_that(matches!(&state, MissionState::Failed { cause } if because(cause)), || in_words(&state))
        }),
        is(
            "{mission} needs rescue because {text}",
            r#"the mission needs rescue because "canceled by""#,
            |stage, said| {
                let state = state_of(stage, &stage.mission(said.value(0))?)?;
                let because = |cause: &str| cause.contains(said.value(1));
                expect_that(matches!(&state, MissionState::NeedsRescue { cause, .. } if because(cause)), || {
                    in_words(&state)
                })
            },
        ),
        is("{mission} was canceled by {text}", r#"the mission was canceled by "nurse of IC Room 6""#, |stage, said| {
            let state = state_of(stage, &stage.mission(said.value(0))?)?;
            expect_that(matches!(&state, MissionState::Canceled { by } if by == said.value(1)), || in_words(&state))
        }),
        is("{mission} is over", "the mission is over", |stage, said| {
            let state = state_of(stage, &stage.mission(said.value(0))?)?;
            expect_that(state.is_final(), || in_words(&state))
        }),
        is(
            "the request was refused because {text}",
            r#"the request was refused because "did you mean""#,
            |stage, said| {
                let Some(refused) = &stage.refused else {
                    return Err(StepFailure::NotMet("no request was refused".to_owned()));
                };
                refused.checked.set(true);
                expect_that(refused.why.contains(said.value(0)), || refused.why.clone())
            },
        ),
        is("all missions are completed", "all missions are completed", |stage, _| {
            if stage.missions.is_empty() {
                return Err(StepFailure::invalid("no mission was asked for"));
            }
            for (request, mission) in &stage.missions {
                let state = state_of(stage, mission)?;
                expect_that(state == MissionState::Completed, || format!("mission {request} {}", in_words(&state)))?;
            }
            Ok(())
        }),
        is("{name} is {name} of {mission}", "amber is r1 of the mission", |stage, said| {
            let mission = stage.mission(said.value(2))?;
            let holder = stage.fleet()?.holder(&mission, said.value(1)).map(|robot| robot.to_string());
            expect_that(holder.as_deref() == Some(said.value(0)), || match holder {
                Some(holder) => format!("{holder} is"),
                None => "nobody is".to_owned(),
            })
        }),
        is("{name} never had a role in {mission}", "amber never had a role in the mission", |stage, said| {
            stage.robot(said.value(0))?;
            let ever = stage.fleet()?.all_holders(&stage.mission(said.value(1))?);
            expect_that(!ever.contains(said.value(0)), || {
                let ever: Vec<&str> = ever.iter().map(String::as_str).collect();
                format!("roles were given to {}", ever.join(", "))
            })
        }),
        is("task {name} has begun", "task navto_lab has begun", |stage, said| {
            let begun = begun(stage, said)?;
            expect_that(!begun.is_empty(), || "it has not begun".to_owned())
        }),
        is("task {name} has begun {number} times", "task navto_room has begun 2 times", |stage, said| {
            let begun = begun(stage, said)?;
            expect_that(begun.len() as f64 == said.number(1), || {
                format!("it has begun {} times: {}", begun.len(), begun.join(", "))
            })
        }),
        is("task {name} has ended", "task navto_lab has ended", |stage, said| {
            let mission = stage.mission("the mission")?;
            let doers = stage.fleet()?.event_log.task_executors(&mission);
            expect_that(doers.get(said.value(0)).is_some_and(|(_, ended)| !ended.is_empty()), || {
                "it has not ended".to_owned()
            })
        }),
        is("{name} did task {name}", "birch did task navto_lab", |stage, said| {
            let mission = stage.mission("the mission")?;
            let doers = stage.fleet()?.event_log.task_executors(&mission);
            let ended = doers.get(said.value(1)).map(|(_, ended)| ended.clone()).unwrap_or_default();
            expect_that(ended.iter().any(|doer| doer == said.value(0)), || match ended[..] {
                [] => "nobody did".to_owned(),
                _ => format!("{} did", ended.join(", ")),
            })
        }),
        is("every task of {mission} was done once", "every task of the mission was done once", |stage, said| {
            let mission = stage.mission(said.value(0))?;
            let tasks = stage.fleet()?.task_counts(&mission);
            expect_that(!tasks.is_empty(), || "no task was begun".to_owned())?;
            let odd = tasks.iter().find(|(_, counts)| **counts != (1, 1));
            expect_that(odd.is_none(), || {
                let (task, (begun, ended)) = odd.expect("just seen");
                format!("{task} was begun {begun} times and ended {ended} times")
            })
        }),
        is("nobody acted for another", "nobody acted for another", |stage, _| {
            let spells = stage.fleet()?.event_log.role_intervals();
            let pairs =
                spells.iter().enumerate().flat_map(|(at, one)| spells[at + 1..].iter().map(move |other| (one, other)));
            let same_role =
                |one: &RoleInterval, other: &RoleInterval| (&one.mission, &one.role) == (&other.mission, &other.role);
            let mut clashes =
                pairs.filter(|(one, other)| one.overlaps(other) && (one.robot == other.robot || same_role(one, other)));
            let clash = clashes.next();
            expect_that(clash.is_none(), || {
                let (one, other) = clash.expect("just seen");
                format!(
                    "{} as {} of {}, and at the same time {} as {} of {}",
                    one.robot, one.role, one.mission, other.robot, other.role, other.mission
                )
            })
        }),
        is(
            "{name} was taken from a robot because {text}",
            r#"r1 was taken from a robot because "battery""#,
            |stage, said| {
                let causes = told(stage, |what| match what {
                    EventKind::Released { role, cause, .. } if role.as_str() == said.value(0) => Some(cause.clone()),
                    _ => None,
                })?;
                expect_that(causes.iter().any(|cause| cause.contains(said.value(1))), || {
                    listed("it was taken from one because", &causes)
                })
            },
        ),
        is("{name} did not get {name} because {text}", r#"cedar did not get r1 because "lacks""#, |stage, said| {
            let reasons: Vec<String> = told(stage, |what| match what {
                EventKind::Closed { record, .. } => Some(record.clone()),
                _ => None,
            })?
            .into_iter()
            .flat_map(|record| record.entries)
            .filter(|entry| entry.robot.as_str() == said.value(0) && entry.role.as_str() == said.value(1))
            .map(|entry| match entry.verdict {
                Answer::Viable { time, .. } => format!("nothing: it bid {:.1} s", time.get()),
                Answer::Unviable { why, .. } => why.to_string(),
                Answer::Refused { reason } => reason.to_string(),
            })
            .collect();
            expect_that(reasons.iter().any(|reason| reason.contains(said.value(2))), || {
                listed("it did not because of", &reasons)
            })
        }),
        is("{name} tried again because {text}", r#"amber tried again because "closed""#, |stage, said| {
            let fleet = stage.fleet()?;
            let entries = fleet.event_log.entries();
            let causes: Vec<String> = entries
                .iter()
                .filter(|(_, entry)| entry.node().as_str() == said.value(0))
                .filter_map(|(_, entry)| match entry.event_kind()? {
                    EventKind::TaskRetried { cause, .. } => Some(cause.clone()),
                    _ => None,
                })
                .collect();
            expect_that(causes.iter().any(|cause| cause.contains(said.value(1))), || {
                listed("it tried again because", &causes)
            })
        }),
        is("somebody coordinates", "somebody coordinates", |stage, _| {
            expect_that(stage.fleet()?.coordinating().is_some(), || "nobody does".to_owned())
        }),
        is("nobody coordinates", "nobody coordinates", |stage, _| {
            let coordinator = stage.fleet()?.coordinating();
            expect_that(coordinator.is_none(), || format!("{} does", coordinator.expect("just seen")))
        }),
        is("node {name} coordinates", "node aster coordinates", |stage, said| {
            let coordinator = stage.fleet()?.coordinating();
            expect_that(coordinator.as_ref().is_some_and(|node| node.as_str() == said.value(0)), || {
                coordinates(coordinator.as_ref())
            })
        }),
        is("somebody else coordinates", "somebody else coordinates", |stage, _| {
            let Some(former) = &stage.former_coordinator else {
                return Err(StepFailure::invalid("no coordinator has died or was cut off in this scenario"));
            };
            let coordinator = stage.fleet()?.coordinating();
            expect_that(coordinator.as_ref().is_some_and(|node| node.as_str() != former), || {
                coordinates(coordinator.as_ref())
            })
        }),
        is("the fleet has had {number} coordinator(s)", "the fleet has had 2 coordinators", |stage, said| {
            let terms = told(stage, |what| matches!(what, EventKind::Elected { .. }).then_some(()))?.len();
            expect_that(terms as f64 == said.number(0), || format!("it has had {terms}"))
        }),
    ]
}

fn coordinates(node: Option<&NodeId>) -> String {
    node.map_or_else(|| "nobody does".to_owned(), |node| format!("{node} does"))
}

fn listed(what: &str, list: &[String]) -> String {
    if list.is_empty() {
        format!("{what} … nothing of the kind was told")
    } else {
        format!("{what}: {}", list.join("; "))
    }
}

fn told<T>(stage: &Fixture, of: impl Fn(&EventKind) -> Option<T>) -> Result<Vec<T>, StepFailure> {
    Ok(stage.fleet()?.events().iter().filter_map(of).collect())
}

fn begun(stage: &Fixture, said: &StepArguments) -> Result<Vec<String>, StepFailure> {
    let task: consort_protocol::ids::TaskId = name(said.value(0))?;
    // Before anything was asked for, nothing has begun.
    let Ok(mission) = stage.mission("the mission") else { return Ok(vec![]) };
    let doers = stage.fleet()?.event_log.task_executors(&mission);
    Ok(doers.get(task.as_str()).map(|(begun, _)| begun.clone()).unwrap_or_default())
}

fn state_of(stage: &Fixture, mission: &MissionId) -> Result<MissionState, StepFailure> {
    let state = stage.fleet()?.mission_state(mission);
    state.ok_or_else(|| StepFailure::NotMet("no node that runs knows of it".to_owned()))
}

/// How a mission stands.
fn in_words(state: &MissionState) -> String {
    match state {
        MissionState::Pending => "is pending".to_owned(),
        MissionState::Running => "is running".to_owned(),
        MissionState::Completed => "is completed".to_owned(),
        MissionState::Failed { cause } => format!("has failed: {cause}"),
        MissionState::Canceled { by } => format!("was canceled by {by}"),
        MissionState::NeedsRescue { cause, items } => {
            let items: Vec<String> = items.iter().map(|item| format!("{} with {}", item.item, item.robot)).collect();
            format!("needs rescue ({}): {cause}", items.join(", "))
        }
    }
}
