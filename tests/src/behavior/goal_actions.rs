//! Goals that a scenario sends to robots without nodes: the goals of Nav2 and the other goals of
//! the simulator.

use super::declared_goal::declared_goal;
use super::fixture::Fixture;
use super::scenario_setup::coordinates;
use super::step_arguments::{StepArguments, name, split_list};
use super::step_pattern::{ActionStep, action};
use super::step_result::{StepFailure, StepResult};
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Seconds;
use consort_skills::actions::{
    Dock, FollowWaypoints, Goal, GoalId, NavigateToPose, RobotBackend, Spin, Undock, Wait, Waypoint,
};
use consort_skills::domain::standard_domain;
use consort_skills::domain_file::DomainFile;
use consort_skills::environment::Routes;
use consort_world::world::actions::{ApproachPerson, ApproachRobot, Deposit, Grasp, OperateDrawer, PickUp};

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<ActionStep> {
    vec![
        drive_to(),
        drive_through(),
        go_to_position(),
        turn_by(),
        wait_for(),
        dock(),
        undock(),
        grasp(),
        put_down(),
        open_drawer(),
        close_drawer(),
        approach_nurse(),
        approach_robot(),
        take_from(),
        perform(),
        perform_with(),
        stop_goal(),
    ]
}

fn drive_to() -> ActionStep {
    goal("{name} is told to drive to {text}", r#"amber is told to drive to "Laboratory""#, |fixture, arguments| {
        plan_drive(fixture, arguments.value(0), arguments.value(1))
    })
}

fn drive_through() -> ActionStep {
    goal(
        "{name} is told to drive through {text}",
        r#"amber is told to drive through "A, B, C""#,
        |fixture, arguments| {
            let places = split_list(arguments.value(1));
            let waypoints = places.iter().map(|place| waypoint(fixture, place)).collect::<Result<_, _>>()?;
            Ok(Goal::from(FollowWaypoints { waypoints }))
        },
    )
}

fn go_to_position() -> ActionStep {
    goal("{name} is told to go to position {text}", r#"amber is told to go to position "12.5, 10""#, |_, arguments| {
        let (x, y) = coordinates(arguments.value(1))?;
        Ok(Goal::from(NavigateToPose::to(Pose::new(x, y, 0.0), None)))
    })
}

fn turn_by() -> ActionStep {
    goal("{name} is told to turn by {number} degrees", "amber is told to turn by 90 degrees", |_, arguments| {
        Ok(Goal::from(Spin { angle_rad: arguments.number(1).to_radians() }))
    })
}

fn wait_for() -> ActionStep {
    goal("{name} is told to wait for {time}", "amber is told to wait for 10 s", |_, arguments| {
        Ok(Goal::from(Wait { time: Seconds::new(arguments.seconds(1)).map_err(StepFailure::invalid)? }))
    })
}

fn dock() -> ActionStep {
    goal("{name} is told to dock", "amber is told to dock", |_, _| Ok(Goal::from(Dock { charger: None })))
}

fn undock() -> ActionStep {
    goal("{name} is told to undock", "amber is told to undock", |_, _| Ok(Goal::from(Undock {})))
}

fn grasp() -> ActionStep {
    goal("{name} is told to grasp {text}", r#"amber is told to grasp "tray""#, |_, arguments| {
        Ok(Goal::from(Grasp { object: arguments.value(1).to_owned() }))
    })
}

fn put_down() -> ActionStep {
    goal("{name} is told to put down what it holds", "amber is told to put down what it holds", |_, _| {
        Ok(Goal::from(Deposit { into: None }))
    })
}

fn open_drawer() -> ActionStep {
    goal("{name} is told to open its drawer", "amber is told to open its drawer", |_, _| {
        Ok(Goal::from(OperateDrawer { open: true }))
    })
}

fn close_drawer() -> ActionStep {
    goal("{name} is told to close its drawer", "amber is told to close its drawer", |_, _| {
        Ok(Goal::from(OperateDrawer { open: false }))
    })
}

fn approach_nurse() -> ActionStep {
    goal("{name} is told to approach the nurse", "amber is told to approach the nurse", |_, _| {
        Ok(Goal::from(ApproachPerson { role: name("nurse")? }))
    })
}

fn approach_robot() -> ActionStep {
    goal("{name} is told to approach robot {name}", "amber is told to approach robot lab-arm", |_, arguments| {
        Ok(Goal::from(ApproachRobot { robot: arguments.parse_name(1)? }))
    })
}

fn take_from() -> ActionStep {
    goal("{name} is told to take from {name}", "lab-arm is told to take from amber", |_, arguments| {
        Ok(Goal::from(PickUp { from: arguments.parse_name(1)? }))
    })
}

fn perform() -> ActionStep {
    let (pattern, example) =
        ("{name} is told to perform the action {name}", "amber is told to perform the action empty_bag");
    goal(pattern, example, declared)
}

fn perform_with() -> ActionStep {
    let (pattern, example) =
        ("{name} is told to perform the action {name} with:", "amber is told to perform the action vacuum with:");
    goal(pattern, example, declared)
}

/// Returns the goal of an action that a domain declares. The table has a column per parameter.
fn declared(fixture: &Fixture, arguments: &StepArguments) -> Result<Goal, StepFailure> {
    let domains = fixture.setup.extensions.files().chain([standard_domain()]);
    let actions = domains.flat_map(DomainFile::action_forms).collect();
    declared_goal(&actions, &arguments.parse_name(1)?, &arguments.named_values()?)
}

fn stop_goal() -> ActionStep {
    action("{name} is told to stop", "amber is told to stop", async |fixture, arguments| {
        let robot = fixture.robot(arguments.value(0))?;
        let Some((goal, _)) = fixture.goals.get(&robot).copied() else {
            return Err(StepFailure::Invalid(format!("{robot} has no goal yet")));
        };
        fixture.with_world(|world| world.cancel(&robot, goal));
        Ok(())
    })
}

/// Goal of a step, from its arguments.
type GoalFn = fn(&Fixture, &StepArguments) -> Result<Goal, StepFailure>;

/// Defines an action that sends a goal to the robot of its first argument.
fn goal(pattern: &'static str, example: &'static str, goal: GoalFn) -> ActionStep {
    action(pattern, example, async move |fixture, arguments| send_goal(fixture, arguments, goal))
}

fn send_goal(fixture: &mut Fixture, arguments: &StepArguments, goal: GoalFn) -> StepResult {
    let robot = fixture.robot(arguments.value(0))?;
    if fixture.running().fleet.is_some() {
        let what = format!(
            "{robot} has a node, which sends its goals: a scenario either requests missions from the fleet \
             or sends goals to robots"
        );
        return Err(StepFailure::Invalid(what));
    }
    let goal = goal(fixture, arguments)?;
    let id = GoalId(fixture.goals.get(&robot).map_or(1, |(GoalId(last), _)| last + 1));
    let since = fixture.now_s();
    fixture.with_world(|world| world.start(&robot, id, goal));
    fixture.goals.insert(robot, (id, since));
    Ok(())
}

/// Plans a drive to a place along the shortest path, in a single leg or several.
fn plan_drive(fixture: &Fixture, robot: &str, to: &str) -> Result<Goal, StepFailure> {
    let (robot, to): (_, PlaceId) = (fixture.robot(robot)?, name(to)?);
    let here = fixture.running().world.telemetry(&robot).expect("a robot of this world");
    let routes = Routes::new(&fixture.with_world(|world| world.map().topology())).map_err(StepFailure::invalid)?;
    let legs = routes.legs(&here.place, here.pose, &to).map_err(StepFailure::invalid)?;
    let waypoints = legs.iter().map(|place| waypoint(fixture, place.as_str())).collect::<Result<Vec<_>, _>>()?;
    match <[Waypoint; 1]>::try_from(waypoints) {
        Ok([Waypoint { pose, place }]) => Ok(Goal::from(NavigateToPose::to(pose, place))),
        Err(waypoints) => Ok(Goal::from(FollowWaypoints { waypoints })),
    }
}

fn waypoint(fixture: &Fixture, place: &str) -> Result<Waypoint, StepFailure> {
    let id: PlaceId = name(place)?;
    let pose = fixture.with_world(|world| world.map().place(&id).map(|place| place.pose));
    let pose = pose.ok_or_else(|| StepFailure::Invalid(format!("there is no place {place:?} on this map")))?;
    Ok(Waypoint { pose, place: Some(id) })
}
