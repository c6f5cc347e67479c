//! Deeds against a fleet: nodes die, links are cut, batteries run down, corridors close, people change their minds.

use super::fixture::Fixture;
use super::settings::{obstacle_name, person_action};
use super::step_arguments::{StepArguments, name};
use super::step_pattern::{ActionFn, StepFailure, StepPattern, ready};
use consort_protocol::units::BatteryShare;
use consort_sim::world::{Obstacle, PersonName};
use futures::FutureExt;

/// All of them.
pub(super) fn phrases() -> Vec<StepPattern<ActionFn>> {
    let does = |pattern, example, does: ActionFn| StepPattern::new(pattern, example, does);
    vec![
        does("the coordinator dies", "the coordinator dies", |stage, _| {
            async move {
                let coordinator = stage.coordinator().await?;
                stage.ends(&coordinator).await
            }
            .boxed_local()
        }),
        does("node {name} dies", "node amber dies", |stage, said| {
            async move { stage.ends(said.value(0)).await }.boxed_local()
        }),
        does("node {name} starts again", "node amber starts again", |stage, said| {
            async move {
                let node = said.value(0).to_owned();
                let known = stage.setup.robots.iter().any(|part| part.setup.name == node);
                let place = stage.stopped_nodes.iter().position(|dead| *dead == node);
                let Some(place) = place.filter(|_| known) else {
                    let what = format!("{node} is no robot whose node this scenario has ended");
                    return Err(StepFailure::Invalid(what));
                };
                stage.stopped_nodes.remove(place);
                stage.ensure_fleet().await?.restart(&node).await;
                Ok(())
            }
            .boxed_local()
        }),
        does("nodes {names} are cut off", "nodes amber and birch are cut off", |stage, said| {
            async move {
                let names = said.names(0);
                for name in &names {
                    stage.runs(name)?;
                }
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                stage.ensure_fleet().await?.cut_off(&names);
                Ok(())
            }
            .boxed_local()
        }),
        does("the coordinator is cut off", "the coordinator is cut off", |stage, _| {
            async move {
                let coordinator = stage.coordinator().await?;
                stage.former_coordinator = Some(coordinator.clone());
                stage.ensure_fleet().await?.cut_off(&[&coordinator]);
                Ok(())
            }
            .boxed_local()
        }),
        does("all can hear each other again", "all can hear each other again", |stage, _| {
            async move {
                stage.ensure_fleet().await?.heal();
                Ok(())
            }
            .boxed_local()
        }),
        does("the battery of {name} drops to {percent}", "the battery of amber drops to 20 %", |stage, said| {
            ready(drops(stage, said))
        }),
        does("the battery of {name} is exchanged", "the battery of amber is exchanged", |stage, said| {
            ready(stage.robot(said.value(0)).map(|robot| stage.with_world(|world| world.replace_battery(&robot))))
        }),
        does(
            "the corridor between {text} and {text} closes",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes"#,
            |stage, said| ready(closes(stage, said)),
        ),
        does(
            "the corridor between {text} and {text} opens",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" opens"#,
            |stage, said| {
                let barrier = obstacle_name(said.value(0), said.value(1));
                stage.with_world(|world| world.remove_obstacle(&barrier));
                ready(Ok(()))
            },
        ),
        does("the nurse in {text} {deed}", r#"the nurse in "IC Room 6" walks away"#, |stage, said| {
            ready(changes_her_mind(stage, said.value(0), said.value(1), None))
        }),
        does(
            "the nurse in {text} tells {name} that she {deed}",
            r#"the nurse in "IC Room 6" tells amber that she cancels"#,
            |stage, said| ready(changes_her_mind(stage, said.value(0), said.value(2), Some(said.value(1)))),
        ),
    ]
}

fn drops(stage: &mut Fixture, said: &StepArguments) -> Result<(), StepFailure> {
    let robot = stage.robot(said.value(0))?;
    let charge = BatteryShare::new(said.share(1)).map_err(StepFailure::invalid)?;
    stage.with_world(|world| world.set_charge(&robot, charge));
    Ok(())
}

fn closes(stage: &mut Fixture, said: &StepArguments) -> Result<(), StepFailure> {
    let (a, b) = (said.value(0), said.value(1));
    let barrier = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
    stage.with_world(|world| world.add_obstacle(&barrier)).map_err(StepFailure::invalid)
}

fn changes_her_mind(stage: &mut Fixture, place: &str, does: &str, robot: Option<&str>) -> Result<(), StepFailure> {
    let people = stage.with_world(|world| world.people());
    let person: Option<PersonName> =
        people.into_iter().find(|person| person.place.as_str() == place).map(|person| person.name);
    let person = person.ok_or_else(|| StepFailure::Invalid(format!("there is nobody at {place:?}")))?;
    let robot = robot.map(|robot| stage.robot(robot)).transpose()?;
    if does != "walks away" && robot.is_none() {
        return Err(StepFailure::invalid("say which robot she tells: the nurse in … tells … that she …"));
    }
    stage.with_world(|world| world.trigger_person_action(&person, person_action(does), robot.as_ref()));
    Ok(())
}

impl Fixture {
    /// Who coordinates, as soon as somebody does.
    async fn coordinator(&mut self) -> Result<String, StepFailure> {
        self.start_nodes().await?;
        let coordinates = |stage: &Fixture| Ok(stage.fleet()?.coordinating().is_some());
        if !self.advance(300.0, coordinates).await? {
            return Err(StepFailure::NotMet("nobody has coordinated for 5 minutes".to_owned()));
        }
        Ok(self.fleet()?.coordinating().expect("just seen").to_string())
    }

    /// That a node runs.
    fn runs(&self, node: &str) -> Result<(), StepFailure> {
        let running = self.fleet()?.running();
        if running.iter().any(|name| name == node) {
            return Ok(());
        }
        Err(StepFailure::Invalid(format!("no node {node} runs; there are: {}", running.join(", "))))
    }

    /// Ends a node as if it were killed.
    async fn ends(&mut self, node: &str) -> Result<(), StepFailure> {
        self.start_nodes().await?;
        self.runs(node)?;
        let coordinates = self.fleet()?.coordinating().is_some_and(|coordinator| coordinator.as_str() == node);
        if coordinates {
            self.former_coordinator = Some(node.to_owned());
        }
        self.stopped_nodes.push(node.to_owned());
        self.ensure_fleet().await?.kill(node).await;
        Ok(())
    }
}
