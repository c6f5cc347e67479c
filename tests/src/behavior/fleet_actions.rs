//! Actions on a fleet: nodes are killed, links are cut, batteries drain, corridors close, people
//! change their minds.

use super::fixture::Fixture;
use super::settings::{obstacle_name, person_action};
use super::step_arguments::name;
use super::step_pattern::{ActionStep, action};
use super::step_result::{StepFailure, StepResult};
use consort_protocol::units::BatteryShare;
use consort_world::world::{Obstacle, PersonName};

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<ActionStep> {
    vec![
        kill_coordinator(),
        kill_named_node(),
        restart_node(),
        cut_off_nodes(),
        cut_off_coordinator(),
        heal_network(),
        drain_battery(),
        exchange_battery(),
        close_corridor(),
        open_corridor(),
        nurse_acts(),
        nurse_acts_towards_robot(),
    ]
}

fn kill_coordinator() -> ActionStep {
    action("the coordinator is killed", "the coordinator is killed", async |fixture, _| {
        let coordinator = fixture.wait_for_coordinator().await?;
        fixture.kill_node(&coordinator).await
    })
}

fn kill_named_node() -> ActionStep {
    action("node {name} is killed", "node amber is killed", async |fixture, arguments| {
        fixture.kill_node(arguments.value(0)).await
    })
}

fn restart_node() -> ActionStep {
    action("node {name} starts again", "node amber starts again", async |fixture, arguments| {
        let node = arguments.value(0);
        let known = fixture.setup.robots.iter().any(|part| part.setup.name == node);
        let place = fixture.stopped_nodes.iter().position(|dead| dead == node);
        let Some(place) = place.filter(|_| known) else {
            return Err(StepFailure::Invalid(format!("{node} is not a robot that this scenario has killed")));
        };
        fixture.stopped_nodes.remove(place);
        fixture.ensure_fleet().await?.restart(node).await;
        Ok(())
    })
}

fn cut_off_nodes() -> ActionStep {
    action("nodes {names} are cut off", "nodes amber and birch are cut off", async |fixture, arguments| {
        let names = arguments.names(0);
        for name in &names {
            fixture.check_runs(name)?;
        }
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        fixture.ensure_fleet().await?.cut_off(&names);
        Ok(())
    })
}

fn cut_off_coordinator() -> ActionStep {
    action("the coordinator is cut off", "the coordinator is cut off", async |fixture, _| {
        let coordinator = fixture.wait_for_coordinator().await?;
        fixture.former_coordinator = Some(coordinator.clone());
        fixture.ensure_fleet().await?.cut_off(&[&coordinator]);
        Ok(())
    })
}

fn heal_network() -> ActionStep {
    action("the network is healed", "the network is healed", async |fixture, _| {
        fixture.ensure_fleet().await?.heal();
        Ok(())
    })
}

fn drain_battery() -> ActionStep {
    action(
        "the battery of {name} drops to {percent}",
        "the battery of amber drops to 20 %",
        async |fixture, arguments| {
            let robot = fixture.robot(arguments.value(0))?;
            let charge = BatteryShare::new(arguments.share(1)).map_err(StepFailure::invalid)?;
            fixture.with_world(|world| world.set_charge(&robot, charge));
            Ok(())
        },
    )
}

fn exchange_battery() -> ActionStep {
    action("the battery of {name} is exchanged", "the battery of amber is exchanged", async |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        fixture.with_world(|world| world.replace_battery(&robot));
        Ok(())
    })
}

fn close_corridor() -> ActionStep {
    action(
        "the corridor between {text} and {text} closes",
        r#"the corridor between "IC Corridor 3" and "IC Corridor 6" closes"#,
        async |fixture, arguments| {
            let (a, b) = (arguments.value(0), arguments.value(1));
            let barrier = Obstacle::between(&obstacle_name(a, b), name(a)?, name(b)?);
            fixture.with_world(|world| world.add_obstacle(&barrier)).map_err(StepFailure::invalid)
        },
    )
}

fn open_corridor() -> ActionStep {
    action(
        "the corridor between {text} and {text} opens",
        r#"the corridor between "IC Corridor 3" and "IC Corridor 6" opens"#,
        async |fixture, arguments| {
            let barrier = obstacle_name(arguments.value(0), arguments.value(1));
            fixture.with_world(|world| world.remove_obstacle(&barrier));
            Ok(())
        },
    )
}

fn nurse_acts() -> ActionStep {
    action(
        "the nurse in {text} {person_action}",
        r#"the nurse in "IC Room 6" walks away"#,
        async |fixture, arguments| trigger_nurse_action(fixture, arguments.value(0), arguments.value(1), None),
    )
}

fn nurse_acts_towards_robot() -> ActionStep {
    action(
        "the nurse in {text} tells {name} that she {person_action}",
        r#"the nurse in "IC Room 6" tells amber that she cancels"#,
        async |fixture, arguments| {
            trigger_nurse_action(fixture, arguments.value(0), arguments.value(2), Some(arguments.value(1)))
        },
    )
}

fn trigger_nurse_action(fixture: &Fixture, place: &str, action: &str, robot: Option<&str>) -> StepResult {
    let people = fixture.with_world(|world| world.people());
    let person: Option<PersonName> =
        people.into_iter().find(|person| person.place.as_str() == place).map(|person| person.name);
    let person = person.ok_or_else(|| StepFailure::Invalid(format!("there is no person at {place:?}")))?;
    let robot = robot.map(|robot| fixture.robot(robot)).transpose()?;
    if action != "walks away" && robot.is_none() {
        return Err(StepFailure::invalid("this action needs a robot: the nurse in … tells … that she …"));
    }
    fixture.with_world(|world| world.trigger_person_action(&person, person_action(action), robot.as_ref()));
    Ok(())
}

impl Fixture {
    /// Waits for a coordinator and returns its name.
    async fn wait_for_coordinator(&mut self) -> Result<String, StepFailure> {
        self.start_nodes().await?;
        let has_coordinator = |fixture: &Fixture| Ok(fixture.fleet()?.coordinating().is_some());
        if !self.advance(300.0, has_coordinator).await? {
            return Err(StepFailure::NotMet("there was no coordinator for 5 minutes".to_owned()));
        }
        Ok(self.fleet()?.coordinating().expect("checked before").to_string())
    }

    /// Checks that a node runs.
    fn check_runs(&self, node: &str) -> StepResult {
        let running = self.fleet()?.running();
        if running.iter().any(|name| name == node) {
            return Ok(());
        }
        Err(StepFailure::Invalid(format!("there is no running node {node}; there are: {}", running.join(", "))))
    }

    /// Kills a node.
    async fn kill_node(&mut self, node: &str) -> StepResult {
        self.start_nodes().await?;
        self.check_runs(node)?;
        let has_coordinator = self.fleet()?.coordinating().is_some_and(|coordinator| coordinator.as_str() == node);
        if has_coordinator {
            self.former_coordinator = Some(node.to_owned());
        }
        self.stopped_nodes.push(node.to_owned());
        self.ensure_fleet().await?.kill(node).await;
        Ok(())
    }
}
