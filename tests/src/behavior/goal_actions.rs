//! Deeds of bodies: what a robot without a node is told, in the words of Nav2 and of the simulator's other goals.

use super::fixture::Fixture;
use super::scenario_setup::coordinates;
use super::step_arguments::{StepArguments, name, split_list};
use super::step_pattern::{ActionFn, StepFailure, StepPattern, ready};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Seconds;
use consort_skills::actions::{Goal, GoalId, RobotBackend, Waypoint};
use consort_skills::environment::Routes;

/// All of them.
pub(super) fn phrases() -> Vec<StepPattern<ActionFn>> {
    let tells = |pattern, example, does: ActionFn| StepPattern::new(pattern, example, does);
    vec![
        tells("{name} is told to drive to {text}", r#"amber is told to drive to "Laboratory""#, |stage, said| {
            ready(tell(stage, said, |stage, said| drive(stage, said.value(0), said.value(1))))
        }),
        tells(
            "{name} is told to drive through {text}",
            r#"amber is told to drive through "A, B, C""#,
            |stage, said| {
                ready(tell(stage, said, |stage, said| {
                    let waypoints = split_list(said.value(1))
                        .iter()
                        .map(|place| waypoint(stage, place))
                        .collect::<Result<_, _>>()?;
                    Ok(Goal::FollowWaypoints { waypoints })
                }))
            },
        ),
        tells(
            "{name} is told to go to position {text}",
            r#"amber is told to go to position "12.5, 10""#,
            |stage, said| {
                ready(tell(stage, said, |_, said| {
                    let (x, y) = coordinates(said.value(1))?;
                    Ok(Goal::NavigateToPose { pose: Pose::new(x, y, 0.0), place: None })
                }))
            },
        ),
        tells("{name} is told to turn by {number} degrees", "amber is told to turn by 90 degrees", |stage, said| {
            ready(tell(stage, said, |_, said| Ok(Goal::Spin { angle_rad: said.number(1).to_radians() })))
        }),
        tells("{name} is told to wait for {time}", "amber is told to wait for 10 s", |stage, said| {
            ready(tell(stage, said, |_, said| {
                Ok(Goal::Wait { time: Seconds::new(said.seconds(1)).map_err(StepFailure::invalid)? })
            }))
        }),
        tells("{name} is told to dock", "amber is told to dock", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::Dock { charger: None })))
        }),
        tells("{name} is told to undock", "amber is told to undock", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::Undock)))
        }),
        tells("{name} is told to grasp {text}", r#"amber is told to grasp "tray""#, |stage, said| {
            ready(tell(stage, said, |_, said| Ok(Goal::Grasp { object: said.value(1).to_owned() })))
        }),
        tells("{name} is told to put down what it holds", "amber is told to put down what it holds", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::Deposit { into: None })))
        }),
        tells("{name} is told to open its drawer", "amber is told to open its drawer", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::OperateDrawer { open: true })))
        }),
        tells("{name} is told to close its drawer", "amber is told to close its drawer", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::OperateDrawer { open: false })))
        }),
        tells("{name} is told to approach the nurse", "amber is told to approach the nurse", |stage, said| {
            ready(tell(stage, said, |_, _| Ok(Goal::ApproachPerson { role: name("nurse")? })))
        }),
        tells("{name} is told to approach robot {name}", "amber is told to approach robot lab-arm", |stage, said| {
            ready(tell(stage, said, |_, said| Ok(Goal::ApproachRobot { robot: said.parse_name(1)? })))
        }),
        tells("{name} is told to take from {name}", "lab-arm is told to take from amber", |stage, said| {
            ready(tell(stage, said, |_, said| Ok(Goal::PickUp { from: said.parse_name(1)? })))
        }),
        tells("{name} is told to stop", "amber is told to stop", |stage, said| ready(stop(stage, said))),
    ]
}

fn stop(stage: &mut Fixture, said: &StepArguments) -> Result<(), StepFailure> {
    let robot = stage.robot(said.value(0))?;
    let Some((goal, _)) = stage.goals.get(&robot).copied() else {
        return Err(StepFailure::Invalid(format!("{robot} was told nothing yet")));
    };
    stage.with_world(|world| world.cancel(&robot, goal));
    Ok(())
}

fn tell(
    stage: &mut Fixture,
    said: &StepArguments,
    goal: fn(&Fixture, &StepArguments) -> Result<Goal, StepFailure>,
) -> Result<(), StepFailure> {
    let robot = stage.robot(said.value(0))?;
    if stage.running().fleet.is_some() {
        let what = format!(
            "{robot} has a node, which tells it what to do: a scenario asks the fleet for missions, or \
                            gives goals to robots, not both"
        );
        return Err(StepFailure::Invalid(what));
    }
    let goal = goal(stage, said)?;
    let id = GoalId(stage.goals.get(&robot).map_or(1, |(GoalId(last), _)| last + 1));
    let since = stage.now_s();
    stage.with_world(|world| world.start(&robot, id, goal));
    stage.goals.insert(robot, (id, since));
    Ok(())
}

/// To a place along the shortest way, one leg or several.
fn drive(stage: &Fixture, robot: &str, to: &str) -> Result<Goal, StepFailure> {
    let (robot, to): (_, PlaceId) = (stage.robot(robot)?, name(to)?);
    let here = stage.running().world.telemetry(&robot).expect("a robot that is here");
    let routes = Routes::new(&stage.with_world(|world| world.map().topology())).map_err(StepFailure::invalid)?;
    let legs = routes.legs(&here.place, here.pose, &to).map_err(StepFailure::invalid)?;
    let waypoints = legs.iter().map(|place| waypoint(stage, place.as_str())).collect::<Result<Vec<_>, _>>()?;
    match <[Waypoint; 1]>::try_from(waypoints) {
        Ok([Waypoint { pose, place }]) => Ok(Goal::NavigateToPose { pose, place }),
        Err(waypoints) => Ok(Goal::FollowWaypoints { waypoints }),
    }
}

fn waypoint(stage: &Fixture, place: &str) -> Result<Waypoint, StepFailure> {
    let id: PlaceId = name(place)?;
    let pose = stage.with_world(|world| world.map().place(&id).map(|place| place.pose));
    let pose = pose.ok_or_else(|| StepFailure::Invalid(format!("there is no place {place:?} on this map")))?;
    Ok(Waypoint { pose, place: Some(id) })
}
