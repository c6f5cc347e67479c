//! A robot of the fleet under Nav2: our own skill drives an action server, which is hiroz's own.

use crate::support::{LIMIT, Router, bus, carrier, hospital, host, keys, until, within};
use bytes::Bytes;
use consort_actors::body::{Body, BodyCommand, BodyLinkSettings, BodyState};
use consort_actors::bus::{Bus, Encoding, ZenohBus};
use consort_protocol::codec;
use consort_protocol::ids::{RobotId, TaskType};
use consort_protocol::keys::{BodyCall, Key};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_ros2::drive::{DriveSettings, drive};
use consort_ros2::mapping::from_ros;
use consort_ros2::messages::{NavigateToPose, Outcome, Progress};
use consort_ros2::ros::Ros;
use consort_skills::actions::{Goal, GoalStatus, RobotActions, Telemetry};
use consort_skills::environment::{Environment, Routes};
use consort_skills::library::{ActiveSkill, SkillContext, SkillLibrary, SkillStatus};
use hiroz::Builder;
use hiroz::action::messages::CancelGoalServiceResponse;
use hiroz::action::server::{ExecutingGoal, ZActionServer};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// Something for a link to a body to belong to.
struct Nobody;

#[ractor::async_trait]
impl Actor for Nobody {
    type Msg = ();
    type State = ();
    type Arguments = ();

    async fn pre_start(&self, _: ActorRef<()>, (): ()) -> Result<(), ActorProcessingErr> {
        Ok(())
    }
}

fn ada() -> RobotId {
    "ada".parse().unwrap()
}

/// A robot of the fleet at the dock, whose body acts through `/navigate_to_pose`.
struct Driven {
    router: Router,
    body: Body,
    bus: ZenohBus,
    _tasks: JoinSet<()>,
}

impl Driven {
    async fn new() -> Driven {
        let (router, bus_of_driver) = (Router::start().await, bus(None).await);
        let bus_of_robot = bus(Some(&bus_of_driver)).await;
        // The fleet has a simulated robot, too, whose host hears all commands to bodies and refuses ada's.
        host(&bus_of_robot, vec![carrier("bob", "Crossing", 1.0)]).await;
        let ros = router.join("consort_driver");
        let settings = DriveSettings {
            bus: Arc::new(bus_of_driver),
            keys: keys(),
            robot: ada(),
            place: "Dock".parse().unwrap(),
            places: hospital().topology().places,
            action: "/navigate_to_pose".to_owned(),
        };
        let mut tasks = JoinSet::new();
        tasks.spawn(async move { panic!("it drives no longer: {}", drive(&ros, settings).await.unwrap_err()) });
        let body = driver(&bus_of_robot).await;
        until("word of the body", async || body.is_at_rest()).await;
        Driven { router, body, bus: bus_of_robot, _tasks: tasks }
    }

    /// A Nav2 of its own machine, seen by the driver's graph by the time that this returns.
    async fn nav2(&self) -> (Ros, ZActionServer<NavigateToPose>) {
        let ros = self.router.join("bt_navigator");
        let server = ros.node.create_action_server::<NavigateToPose>("/navigate_to_pose").build().unwrap();
        let onlooker = self.router.join("onlooker");
        until("the action server", async || onlooker.node.graph().has_action_server("/navigate_to_pose")).await;
        (ros, server)
    }

    async fn tick(&mut self, skill: &mut ActiveSkill) -> SkillStatus {
        self.body.refresh();
        let status = skill.tick(&mut self.body);
        tokio::time::sleep(Duration::from_millis(20)).await;
        status
    }

    async fn run(&mut self, skill: &mut ActiveSkill) -> SkillStatus {
        let end = tokio::time::Instant::now() + LIMIT;
        loop {
            match self.tick(skill).await {
                SkillStatus::Running => assert!(tokio::time::Instant::now() < end, "it still runs after {LIMIT:?}"),
                ended => return ended,
            }
        }
    }
}

/// A driver of ada's body.
async fn driver(bus: &ZenohBus) -> Body {
    let (supervisor, _) = Actor::spawn(None, Nobody, ()).await.unwrap();
    let (bus, beat) = (Arc::new(bus.clone()), Duration::from_millis(300));
    let link = BodyLinkSettings { robot: ada(), keys: keys(), bus, first_goal: 1, beat };
    Body::link(link, &supervisor.get_cell()).await.unwrap()
}

/// Our navigation skill.
fn navigation(to: &str) -> ActiveSkill {
    let environment = Environment::new().with(Routes::new(&hospital().topology()).unwrap());
    let task = TaskSpec {
        parameters: [("to".to_owned(), to.to_owned())].into(),
        ..TaskSpec::of(TaskType::new("navigation").unwrap(), vec!["r1".parse().unwrap()])
    };
    let context = SkillContext { holders: [("r1".parse().unwrap(), ada())].into() };
    SkillLibrary::standard(environment).load(&task, &context).unwrap()
}

async fn next(server: &ZActionServer<NavigateToPose>) -> ExecutingGoal<NavigateToPose> {
    within("a goal", server.recv_goal()).await.unwrap().accept().execute()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_navigation_skill_drives_nav2_leg_by_leg() {
    let mut driven = Driven::new().await;
    let (_ros, server) = driven.nav2().await;
    let nav2 = tokio::spawn(async move {
        let mut poses = vec![];
        for _ in 0..3 {
            let goal = next(&server).await;
            let pose = from_ros(&goal.goal().pose).unwrap();
            let progress = Progress { current_pose: goal.goal().pose.clone(), ..Progress::default() };
            goal.publish_feedback(progress).unwrap();
            poses.push((pose.x, pose.y));
            goal.succeed(Outcome::default()).unwrap();
        }
        // It stays on the graph: what is asked for after the end is still answered.
        (server, poses)
    });
    assert_eq!(driven.run(&mut navigation("Laboratory")).await, SkillStatus::Succeeded);
    let (_server, poses) = nav2.await.unwrap();
    assert_eq!(poses, [(6.0, 7.0), (13.5, 7.0), (13.5, 11.0)]);
    driven.body.refresh();
    assert_eq!(driven.body.telemetry().unwrap().place.as_str(), "Laboratory");
    assert_eq!(driven.run(&mut navigation("Laboratory")).await, SkillStatus::Succeeded, "it is there");
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_refuses_a_command_is_not_the_bodys_host_however_soon_it_answers() {
    let (bus_of_world, place) = (bus(None).await, Pose::default());
    let bus_of_robot = bus(Some(&bus_of_world)).await;
    host(&bus_of_world, vec![carrier("bob", "Crossing", 1.0)]).await;
    // Ada's host takes its time: the world has refused long before.
    let command = keys().write(&Key::Body(ada(), BodyCall::Command));
    let mut commands = bus_of_world.serve(&command).await.unwrap();
    let serves = tokio::spawn(async move {
        let mut number = 0;
        while let Some(query) = commands.recv().await {
            let BodyCommand { order } = codec::decode(&query.payload).unwrap();
            let goals = order.iter().map(|order| (order.goal(), GoalStatus::Succeeded)).collect();
            let telemetry = Telemetry {
                time: WorldTime::ZERO,
                pose: place,
                place: "Dock".parse().unwrap(),
                battery: BatteryShare::FULL,
                able: true,
                closed: vec![],
            };
            number += 1;
            let state = BodyState { robot: ada(), number, telemetry, goals, done: vec![] };
            tokio::time::sleep(Duration::from_millis(100)).await;
            let bytes = Bytes::from(codec::encode(&state).unwrap());
            query.replier.reply(&query.key, bytes, Encoding::Wire).await.unwrap();
        }
    });
    let mut body = driver(&bus_of_robot).await;
    let goal = body.send_goal(Goal::Undock);
    until("the end of the goal", async || body.status(goal) == Some(GoalStatus::Succeeded)).await;
    serves.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_world_answers_for_people_and_for_what_there_is_to_see() {
    let driven = Driven::new().await;
    let mut answers = driven.bus.query(&keys().write(&Key::World), Bytes::new(), LIMIT).await.unwrap();
    let view = within("the world", answers.recv()).await.unwrap().payload.unwrap();
    assert!(view.starts_with(b"{"), "{view:?}");
    assert!(within("the end", answers.recv()).await.is_none(), "the adapter has answered, too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_skill_that_is_halted_cancels_at_nav2_and_the_body_is_where_nav2_said() {
    let mut driven = Driven::new().await;
    let (_ros, server) = driven.nav2().await;
    let mut skill = navigation("Laboratory");
    let goal = loop {
        tokio::select! {
            goal = next(&server) => break goal,
            status = driven.tick(&mut skill) => assert_eq!(status, SkillStatus::Running),
        }
    };
    let mut halfway = goal.goal().pose.clone();
    halfway.pose.position.y = 5.0;
    let halfway = Progress { current_pose: halfway, distance_remaining: 2.0, ..Progress::default() };
    until("word of where it is", async || {
        goal.publish_feedback(halfway.clone()).unwrap();
        driven.body.refresh();
        driven.body.telemetry().is_some_and(|telemetry| (telemetry.pose.x, telemetry.pose.y) == (6.0, 5.0))
    })
    .await;
    skill.halt(&mut driven.body);
    let (request, query) = within("a wish to cancel", server.recv_cancel()).await.unwrap();
    assert_eq!(request.goal_info.goal_id, goal.info().goal_id);
    let response = CancelGoalServiceResponse { return_code: 0, goals_canceling: vec![request.goal_info] };
    server.send_cancel_response_low(&query, &response).unwrap();
    assert!(!skill.is_settled(&driven.body), "it has not stopped yet");
    goal.canceled(Outcome::default()).unwrap();
    until("rest", async || driven.body.is_at_rest()).await;
    assert!(skill.is_settled(&driven.body));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_fails_at_nav2_fails_the_skill_in_its_words() {
    let mut driven = Driven::new().await;
    let failed = |cause: &str| SkillStatus::Failed { cause: cause.to_owned() };
    let nobody = failed("NavigateToPose: unknown: no server of Nav2 has answered");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, nobody, "before Nav2 has started");

    let (ros, server) = driven.nav2().await;
    let rejects = tokio::spawn(async move {
        within("a goal", server.recv_goal()).await.unwrap().reject().unwrap();
        next(&server).await.abort(Outcome { error_code: 208, error_msg: "no valid path".to_owned() }).unwrap();
        let goal = next(&server).await;
        (server, goal)
    });
    let rejected = failed("NavigateToPose: unknown: Nav2 has rejected the goal");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, rejected);
    let no_path = failed("NavigateToPose: no route: Nav2 error 208: no valid path");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, no_path);

    // Nav2 dies with the third goal under way.
    let mut skill = navigation("Crossing");
    let (server, goal) = loop {
        tokio::select! {
            biased;
            status = driven.tick(&mut skill) => assert_eq!(status, SkillStatus::Running),
        }
        if rejects.is_finished() {
            break rejects.await.unwrap();
        }
    };
    ros.leave().unwrap();
    drop((server, goal, ros));
    let gone = failed("NavigateToPose: timed out: there is no server of /navigate_to_pose any more");
    assert_eq!(driven.run(&mut skill).await, gone);
}
