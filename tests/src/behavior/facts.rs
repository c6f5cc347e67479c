//! Facts of missions and of the fleet.

use super::phrase::{Fact, Phrase, Wrong, so};
use super::said::{Said, name};
use super::stage::Stage;
use crate::Spell;
use consort_protocol::auction::Verdict as Answer;
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::ledger::MissionState;

/// All of them.
pub(super) fn phrases() -> Vec<Phrase<Fact>> {
    let is = |pattern, example, fact: Fact| Phrase::new(pattern, example, fact);
    vec![
        is("{mission} is {state}", "the mission is completed", |stage, said| {
            let state = state_of(stage, &stage.mission(said.word(0))?)?;
            let wanted = match said.word(1) {
                "in need of rescue" => "needs_rescue",
                word => word,
            };
            so(state.word() == wanted, || in_words(&state))
        }),
        is("{mission} has failed because {text}", r#"the mission has failed because "no route""#, |stage, said| {
            let state = state_of(stage, &stage.mission(said.word(0))?)?;
            let because = |cause: &str| cause.contains(said.word(1));
            so(matches!(&state, MissionState::Failed { cause } if because(cause)), || in_words(&state))
        }),
        is(
            "{mission} needs rescue because {text}",
            r#"the mission needs rescue because "canceled by""#,
            |stage, said| {
                let state = state_of(stage, &stage.mission(said.word(0))?)?;
                let because = |cause: &str| cause.contains(said.word(1));
                so(matches!(&state, MissionState::NeedsRescue { cause, .. } if because(cause)), || in_words(&state))
            },
        ),
        is("{mission} was canceled by {text}", r#"the mission was canceled by "nurse of IC Room 6""#, |stage, said| {
            let state = state_of(stage, &stage.mission(said.word(0))?)?;
            so(matches!(&state, MissionState::Canceled { by } if by == said.word(1)), || in_words(&state))
        }),
        is("{mission} is over", "the mission is over", |stage, said| {
            let state = state_of(stage, &stage.mission(said.word(0))?)?;
            so(state.is_end(), || in_words(&state))
        }),
        is(
            "the request was refused because {text}",
            r#"the request was refused because "did you mean""#,
            |stage, said| {
                let Some(refused) = &stage.refused else {
                    return Err(Wrong::Instead("no request was refused".to_owned()));
                };
                refused.heeded.set(true);
                so(refused.why.contains(said.word(0)), || refused.why.clone())
            },
        ),
        is("all missions are completed", "all missions are completed", |stage, _| {
            if stage.missions.is_empty() {
                return Err(Wrong::nonsense("no mission was asked for"));
            }
            for (request, mission) in &stage.missions {
                let state = state_of(stage, mission)?;
                so(state == MissionState::Completed, || format!("mission {request} {}", in_words(&state)))?;
            }
            Ok(())
        }),
        is("{name} is {name} of {mission}", "amber is r1 of the mission", |stage, said| {
            let mission = stage.mission(said.word(2))?;
            let holder = stage.fleet()?.holder(&mission, said.word(1)).map(|robot| robot.to_string());
            so(holder.as_deref() == Some(said.word(0)), || match holder {
                Some(holder) => format!("{holder} is"),
                None => "nobody is".to_owned(),
            })
        }),
        is("{name} never had a role in {mission}", "amber never had a role in the mission", |stage, said| {
            stage.robot(said.word(0))?;
            let ever = stage.fleet()?.holders_ever(&stage.mission(said.word(1))?);
            so(!ever.contains(said.word(0)), || {
                let ever: Vec<&str> = ever.iter().map(String::as_str).collect();
                format!("roles were given to {}", ever.join(", "))
            })
        }),
        is("task {name} has begun", "task navto_lab has begun", |stage, said| {
            let begun = begun(stage, said)?;
            so(!begun.is_empty(), || "it has not begun".to_owned())
        }),
        is("task {name} has begun {number} times", "task navto_room has begun 2 times", |stage, said| {
            let begun = begun(stage, said)?;
            so(begun.len() as f64 == said.number(1), || {
                format!("it has begun {} times: {}", begun.len(), begun.join(", "))
            })
        }),
        is("task {name} has ended", "task navto_lab has ended", |stage, said| {
            let mission = stage.mission("the mission")?;
            let doers = stage.fleet()?.chronicle.doers(&mission);
            so(doers.get(said.word(0)).is_some_and(|(_, ended)| !ended.is_empty()), || "it has not ended".to_owned())
        }),
        is("{name} did task {name}", "birch did task navto_lab", |stage, said| {
            let mission = stage.mission("the mission")?;
            let doers = stage.fleet()?.chronicle.doers(&mission);
            let ended = doers.get(said.word(1)).map(|(_, ended)| ended.clone()).unwrap_or_default();
            so(ended.iter().any(|doer| doer == said.word(0)), || match ended[..] {
                [] => "nobody did".to_owned(),
                _ => format!("{} did", ended.join(", ")),
            })
        }),
        is("every task of {mission} was done once", "every task of the mission was done once", |stage, said| {
            let mission = stage.mission(said.word(0))?;
            let tasks = stage.fleet()?.tasks(&mission);
            so(!tasks.is_empty(), || "no task was begun".to_owned())?;
            let odd = tasks.iter().find(|(_, counts)| **counts != (1, 1));
            so(odd.is_none(), || {
                let (task, (begun, ended)) = odd.expect("just seen");
                format!("{task} was begun {begun} times and ended {ended} times")
            })
        }),
        is("nobody acted for another", "nobody acted for another", |stage, _| {
            let spells = stage.fleet()?.chronicle.spells();
            let pairs =
                spells.iter().enumerate().flat_map(|(at, one)| spells[at + 1..].iter().map(move |other| (one, other)));
            let same_role = |one: &Spell, other: &Spell| (&one.mission, &one.role) == (&other.mission, &other.role);
            let mut clashes =
                pairs.filter(|(one, other)| one.overlaps(other) && (one.robot == other.robot || same_role(one, other)));
            let clash = clashes.next();
            so(clash.is_none(), || {
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
                    Happening::Released { role, cause, .. } if role.as_str() == said.word(0) => Some(cause.clone()),
                    _ => None,
                })?;
                so(causes.iter().any(|cause| cause.contains(said.word(1))), || {
                    listed("it was taken from one because", &causes)
                })
            },
        ),
        is("{name} did not get {name} because {text}", r#"cedar did not get r1 because "lacks""#, |stage, said| {
            let reasons: Vec<String> = told(stage, |what| match what {
                Happening::Closed { record, .. } => Some(record.clone()),
                _ => None,
            })?
            .into_iter()
            .flat_map(|record| record.entries)
            .filter(|entry| entry.robot.as_str() == said.word(0) && entry.role.as_str() == said.word(1))
            .map(|entry| match entry.verdict {
                Answer::Viable { time, .. } => format!("nothing: it bid {:.1} s", time.get()),
                Answer::Unviable { why, .. } => why.to_string(),
                Answer::Refused { reason } => reason.to_string(),
            })
            .collect();
            so(reasons.iter().any(|reason| reason.contains(said.word(2))), || listed("it did not because of", &reasons))
        }),
        is("{name} tried again because {text}", r#"amber tried again because "closed""#, |stage, said| {
            let fleet = stage.fleet()?;
            let entries = fleet.chronicle.entries();
            let causes: Vec<String> = entries
                .iter()
                .filter(|(_, entry)| entry.node().as_str() == said.word(0))
                .filter_map(|(_, entry)| match entry.happening()? {
                    Happening::TaskRetried { cause, .. } => Some(cause.clone()),
                    _ => None,
                })
                .collect();
            so(causes.iter().any(|cause| cause.contains(said.word(1))), || listed("it tried again because", &causes))
        }),
        is("somebody coordinates", "somebody coordinates", |stage, _| {
            so(stage.fleet()?.coordinating().is_some(), || "nobody does".to_owned())
        }),
        is("nobody coordinates", "nobody coordinates", |stage, _| {
            let coordinator = stage.fleet()?.coordinating();
            so(coordinator.is_none(), || format!("{} does", coordinator.expect("just seen")))
        }),
        is("node {name} coordinates", "node aster coordinates", |stage, said| {
            let coordinator = stage.fleet()?.coordinating();
            so(coordinator.as_ref().is_some_and(|node| node.as_str() == said.word(0)), || {
                coordinates(coordinator.as_ref())
            })
        }),
        is("somebody else coordinates", "somebody else coordinates", |stage, _| {
            let Some(former) = &stage.former else {
                return Err(Wrong::nonsense("no coordinator has died or was cut off in this scenario"));
            };
            let coordinator = stage.fleet()?.coordinating();
            so(coordinator.as_ref().is_some_and(|node| node.as_str() != former), || coordinates(coordinator.as_ref()))
        }),
        is("the fleet has had {number} coordinator(s)", "the fleet has had 2 coordinators", |stage, said| {
            let terms = told(stage, |what| matches!(what, Happening::Elected { .. }).then_some(()))?.len();
            so(terms as f64 == said.number(0), || format!("it has had {terms}"))
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

fn told<T>(stage: &Stage, of: impl Fn(&Happening) -> Option<T>) -> Result<Vec<T>, Wrong> {
    Ok(stage.fleet()?.happenings().iter().filter_map(of).collect())
}

fn begun(stage: &Stage, said: &Said) -> Result<Vec<String>, Wrong> {
    let task: consort_protocol::ids::TaskId = name(said.word(0))?;
    // Before anything was asked for, nothing has begun.
    let Ok(mission) = stage.mission("the mission") else { return Ok(vec![]) };
    let doers = stage.fleet()?.chronicle.doers(&mission);
    Ok(doers.get(task.as_str()).map(|(begun, _)| begun.clone()).unwrap_or_default())
}

fn state_of(stage: &Stage, mission: &MissionId) -> Result<MissionState, Wrong> {
    let state = stage.fleet()?.state_of(mission);
    state.ok_or_else(|| Wrong::Instead("no node that runs knows of it".to_owned()))
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
