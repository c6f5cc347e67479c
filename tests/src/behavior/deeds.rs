//! Deeds against a fleet: nodes die, links are cut, batteries run down, corridors close, people change their minds.

use super::phrase::{Deed, Phrase, Wrong, now};
use super::said::{Said, name};
use super::settings::{deed, obstacle_name};
use super::stage::Stage;
use consort_protocol::units::BatteryShare;
use consort_sim::world::{Obstacle, PersonName};
use futures::FutureExt;

/// All of them.
pub(super) fn phrases() -> Vec<Phrase<Deed>> {
    let does = |pattern, example, does: Deed| Phrase::new(pattern, example, does);
    vec![
        does("the coordinator dies", "the coordinator dies", |stage, _| {
            async move {
                let coordinator = stage.coordinator().await?;
                stage.ends(&coordinator).await
            }
            .boxed_local()
        }),
        does("node {name} dies", "node amber dies", |stage, said| {
            async move { stage.ends(said.word(0)).await }.boxed_local()
        }),
        does("node {name} starts again", "node amber starts again", |stage, said| {
            async move {
                let node = said.word(0).to_owned();
                let known = stage.cast.robots.iter().any(|part| part.member.name == node);
                let place = stage.dead.iter().position(|dead| *dead == node);
                let Some(place) = place.filter(|_| known) else {
                    let what = format!("{node} is no robot whose node this scenario has ended");
                    return Err(Wrong::Nonsense(what));
                };
                stage.dead.remove(place);
                stage.nodes().await?.restart(&node).await;
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
                stage.nodes().await?.cut_off(&names);
                Ok(())
            }
            .boxed_local()
        }),
        does("the coordinator is cut off", "the coordinator is cut off", |stage, _| {
            async move {
                let coordinator = stage.coordinator().await?;
                stage.former = Some(coordinator.clone());
                stage.nodes().await?.cut_off(&[&coordinator]);
                Ok(())
            }
            .boxed_local()
        }),
        does("all can hear each other again", "all can hear each other again", |stage, _| {
            async move {
                stage.nodes().await?.heal();
                Ok(())
            }
            .boxed_local()
        }),
        does("the battery of {name} drops to {percent}", "the battery of amber drops to 20 %", |stage, said| {
            now(drops(stage, said))
        }),
        does("the battery of {name} is exchanged", "the battery of amber is exchanged", |stage, said| {
            now(stage.robot(said.word(0)).map(|robot| stage.with_world(|world| world.exchange_battery(&robot))))
        }),
        does(
            "the corridor between {text} and {text} closes",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes"#,
            |stage, said| now(closes(stage, said)),
        ),
        does(
            "the corridor between {text} and {text} opens",
            r#"the corridor between "IC Corridor 3" and "IC Corridor 6" opens"#,
            |stage, said| {
                let barrier = obstacle_name(said.word(0), said.word(1));
                stage.with_world(|world| world.open_way(&barrier));
                now(Ok(()))
            },
        ),
        does("the nurse in {text} {deed}", r#"the nurse in "IC Room 6" walks away"#, |stage, said| {
            now(changes_her_mind(stage, said.word(0), said.word(1), None))
        }),
        does(
            "the nurse in {text} tells {name} that she {deed}",
            r#"the nurse in "IC Room 6" tells amber that she cancels"#,
            |stage, said| now(changes_her_mind(stage, said.word(0), said.word(2), Some(said.word(1)))),
        ),
    ]
}

fn drops(stage: &mut Stage, said: &Said) -> Result<(), Wrong> {
    let robot = stage.robot(said.word(0))?;
    let charge = BatteryShare::new(said.share(1)).map_err(Wrong::nonsense)?;
    stage.with_world(|world| world.set_charge(&robot, charge));
    Ok(())
}

fn closes(stage: &mut Stage, said: &Said) -> Result<(), Wrong> {
    let (a, b) = (said.word(0), said.word(1));
    let barrier = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
    stage.with_world(|world| world.close_way(&barrier)).map_err(Wrong::nonsense)
}

fn changes_her_mind(stage: &mut Stage, place: &str, does: &str, robot: Option<&str>) -> Result<(), Wrong> {
    let people = stage.with_world(|world| world.people());
    let person: Option<PersonName> =
        people.into_iter().find(|person| person.place.as_str() == place).map(|person| person.name);
    let person = person.ok_or_else(|| Wrong::Nonsense(format!("there is nobody at {place:?}")))?;
    let robot = robot.map(|robot| stage.robot(robot)).transpose()?;
    if does != "walks away" && robot.is_none() {
        return Err(Wrong::nonsense("say which robot she tells: the nurse in … tells … that she …"));
    }
    stage.with_world(|world| world.has_person_do(&person, deed(does), robot.as_ref()));
    Ok(())
}

impl Stage {
    /// Who coordinates, as soon as somebody does.
    async fn coordinator(&mut self) -> Result<String, Wrong> {
        self.run().await?;
        let coordinates = |stage: &Stage| Ok(stage.fleet()?.coordinating().is_some());
        if !self.pass(300.0, coordinates).await? {
            return Err(Wrong::Instead("nobody has coordinated for 5 minutes".to_owned()));
        }
        Ok(self.fleet()?.coordinating().expect("just seen").to_string())
    }

    /// That a node runs.
    fn runs(&self, node: &str) -> Result<(), Wrong> {
        let running = self.fleet()?.running();
        if running.iter().any(|name| name == node) {
            return Ok(());
        }
        Err(Wrong::Nonsense(format!("no node {node} runs; there are: {}", running.join(", "))))
    }

    /// Ends a node as if it were killed.
    async fn ends(&mut self, node: &str) -> Result<(), Wrong> {
        self.run().await?;
        self.runs(node)?;
        let coordinates = self.fleet()?.coordinating().is_some_and(|coordinator| coordinator.as_str() == node);
        if coordinates {
            self.former = Some(node.to_owned());
        }
        self.dead.push(node.to_owned());
        self.nodes().await?.kill(node).await;
        Ok(())
    }
}
