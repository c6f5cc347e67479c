//! A robot of the fleet under Nav2: a skill of this project drives an action server of hiroz.

use crate::support::{LIMIT, Router, bus, carrier, hospital, host_world, keys, until, within};
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::{Bus, Encoding, ZenohBus};
use consort_fleet::robot_driver::{DriverClientSettings, DriverCommand, DriverState, RobotDriver, StateStamp};
use consort_protocol::cause::CauseClass;
use consort_protocol::codec;
use consort_protocol::ids::{RobotId, TaskType};
use consort_protocol::keys::{DriverCall, Key};
use consort_protocol::mission::TaskSpec;
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, WorldTime};
use consort_ros2::drive::{DriveSettings, drive};
use consort_ros2::mapping::from_ros;
use consort_ros2::messages::{NavigateResult, NavigateToPose, Progress};
use consort_ros2::ros::Ros;
use consort_skills::actions::{Goal, GoalStatus, RobotActions, Telemetry, Undock};
use consort_skills::environment::{Environment, Routes};
use consort_skills::library::{ActiveSkill, SkillLibrary, SkillStatus};
use consort_skills::skill::SkillContext;
use hiroz::Builder;
use hiroz::action::messages::CancelGoalServiceResponse;
use hiroz::action::server::{ExecutingGoal, ZActionServer};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// Owner of the driver client.
struct ClientOwner;

#[ractor::async_trait]
impl Actor for ClientOwner {
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

/// A robot of the fleet at the dock, which drives through `/navigate_to_pose`.
struct Driven {
    router: Router,
    robot_driver: RobotDriver,
    bus: ZenohBus,
    _tasks: JoinSet<()>,
}

impl Driven {
    async fn new() -> Driven {
        let (router, bus_of_driver) = (Router::start().await, bus(None).await);
        let bus_of_robot = bus(Some(&bus_of_driver)).await;
        // The fleet also has a simulated robot. Its driver server receives the commands of all
        // robots and refuses those for ada.
        host_world(&bus_of_robot, vec![carrier("bob", "Crossing", 1.0)]).await;
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
        tasks.spawn(async move {
            panic!("the driver stopped: {}", drive(&ros, settings, std::future::pending()).await.unwrap_err())
        });
        let robot_driver = driver(&bus_of_robot).await;
        until("the state of the robot", async || robot_driver.is_idle()).await;
        Driven { router, robot_driver, bus: bus_of_robot, _tasks: tasks }
    }

    /// Starts a Nav2 with a session of its own, and waits until the driver has canceled the goals of
    /// previous runs.
    async fn nav2(&self) -> (Ros, ZActionServer<NavigateToPose>) {
        let ros = self.router.join("bt_navigator");
        let server = ros.node.create_action_server::<NavigateToPose>("/navigate_to_pose").build().unwrap();
        let (request, query) = within("a request to cancel all goals", server.recv_cancel()).await.unwrap();
        assert_eq!(request.goal_info.goal_id.as_bytes(), &[0; 16]);
        let response = CancelGoalServiceResponse { return_code: 0, goals_canceling: vec![] };
        server.send_cancel_response_low(&query, &response).unwrap();
        (ros, server)
    }

    async fn tick(&mut self, skill: &mut ActiveSkill) -> SkillStatus {
        self.robot_driver.refresh();
        let status = skill.tick(&mut self.robot_driver);
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

/// Connects a driver client to ada's driver server.
async fn driver(bus: &ZenohBus) -> RobotDriver {
    let (supervisor, _) = Actor::spawn(None, ClientOwner, ()).await.unwrap();
    let (bus, heartbeat_interval) = (Arc::new(bus.clone()), Duration::from_millis(300));
    let clock = Clock::real();
    let (keys, patience_s) = (keys(), None);
    let (robot, first_goal, cancel_times) = (ada(), 1, BTreeMap::new());
    let link =
        DriverClientSettings { robot, keys, bus, clock, first_goal, heartbeat_interval, patience_s, cancel_times };
    let driver = RobotDriver::connect(link, &supervisor.get_cell()).await.unwrap();
    driver.allow_until(Some(clock.now() + 10 * LIMIT));
    driver
}

/// Returns the navigation skill of this project.
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
            goal.succeed(NavigateResult::default()).unwrap();
        }
        // The server stays on the graph: requests after the end still get a reply.
        (server, poses)
    });
    assert!(matches!(driven.run(&mut navigation("Laboratory")).await, SkillStatus::Succeeded(_)));
    let (_server, poses) = nav2.await.unwrap();
    assert_eq!(poses, [(6.0, 7.0), (13.5, 7.0), (13.5, 11.0)]);
    driven.robot_driver.refresh();
    assert_eq!(driven.robot_driver.telemetry().unwrap().place.as_str(), "Laboratory");
    let again = driven.run(&mut navigation("Laboratory")).await;
    assert!(matches!(again, SkillStatus::Succeeded(_)), "it is already there");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_early_refusal_does_not_replace_the_reply_of_the_server() {
    let (bus_of_world, place) = (bus(None).await, Pose::default());
    let bus_of_robot = bus(Some(&bus_of_world)).await;
    host_world(&bus_of_world, vec![carrier("bob", "Crossing", 1.0)]).await;
    // Ada's driver server replies only after the world has refused the command.
    let command = keys().write(&Key::Driver(ada(), DriverCall::Command));
    let mut commands = bus_of_world.serve(&command).await.unwrap();
    let (second_bus, second_query) = (bus_of_robot.clone(), format!("{command}?second"));
    let server_task = tokio::spawn(async move {
        let mut sequence = 0;
        while let Some(query) = commands.recv().await {
            if query.parameters == "second" {
                continue;
            }
            // The world refuses in order, and over the same link: the refusal of a second query arrives
            // after the refusal of the command.
            let mut replies = second_bus.query(&second_query, query.payload.clone(), LIMIT).await.unwrap();
            while within("the refusal", replies.recv()).await.expect("a reply of the world").payload.is_ok() {}
            let DriverCommand { request, .. } = codec::decode(&query.payload).unwrap();
            let goals = request.iter().map(|request| (request.goal(), GoalStatus::succeeded())).collect();
            let telemetry = Telemetry {
                time: WorldTime::ZERO,
                pose: place,
                place: "Dock".parse().unwrap(),
                battery: BatteryShare::FULL,
                able: true,
                closed: vec![],
                readings: BTreeMap::new(),
            };
            sequence += 1;
            let state = DriverState {
                robot: ada(),
                stamp: StateStamp { boot: 1, sequence },
                telemetry,
                goals,
                completed: vec![],
            };
            let bytes = Bytes::from(codec::encode(&state).unwrap());
            query.replier.reply(&query.key, bytes, Encoding::Wire).await.unwrap();
        }
    });
    let mut robot_driver = driver(&bus_of_robot).await;
    let goal = robot_driver.send_goal(Goal::from(Undock {}));
    until("the end of the goal", async || robot_driver.status(goal) == Some(GoalStatus::succeeded())).await;
    server_task.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_world_replies_to_view_queries() {
    let driven = Driven::new().await;
    let mut answers = driven.bus.query(&keys().write(&Key::World), Bytes::new(), LIMIT).await.unwrap();
    let view = within("the world", answers.recv()).await.unwrap().payload.unwrap();
    assert!(view.starts_with(b"{"), "{view:?}");
    assert!(within("the end", answers.recv()).await.is_none(), "the driver server has replied, too");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_halted_skill_cancels_at_nav2_and_keeps_the_reported_pose() {
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
    until("the pose in the feedback", async || {
        goal.publish_feedback(halfway.clone()).unwrap();
        driven.robot_driver.refresh();
        driven.robot_driver.telemetry().is_some_and(|telemetry| (telemetry.pose.x, telemetry.pose.y) == (6.0, 5.0))
    })
    .await;
    skill.halt(&mut driven.robot_driver);
    let (request, query) = within("a cancel request", server.recv_cancel()).await.unwrap();
    assert_eq!(request.goal_info.goal_id, goal.info().goal_id);
    let response = CancelGoalServiceResponse { return_code: 0, goals_canceling: vec![request.goal_info] };
    server.send_cancel_response_low(&query, &response).unwrap();
    assert!(!skill.cancels_complete(&driven.robot_driver), "it has not stopped yet");
    goal.canceled(NavigateResult::default()).unwrap();
    until("rest", async || driven.robot_driver.is_idle()).await;
    assert!(skill.cancels_complete(&driven.robot_driver));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failure_of_nav2_fails_the_skill_with_its_message() {
    let mut driven = Driven::new().await;
    let failed = |cause: &str| SkillStatus::Failed { cause: cause.to_owned(), class: CauseClass::Robot };
    let no_server = failed("NavigateToPose: unknown: no server of Nav2 has replied");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, no_server, "before Nav2 has started");

    let (ros, server) = driven.nav2().await;
    let nav2_task = tokio::spawn(async move {
        within("a goal", server.recv_goal()).await.unwrap().reject().unwrap();
        next(&server).await.abort(NavigateResult { error_code: 208, error_msg: "no valid path".to_owned() }).unwrap();
        let goal = next(&server).await;
        (server, goal)
    });
    let rejected = failed("NavigateToPose: unknown: Nav2 has rejected the goal");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, rejected);
    let no_path = failed("NavigateToPose: no route: Nav2 error 208: no valid path");
    assert_eq!(driven.run(&mut navigation("Crossing")).await, no_path);

    // Nav2 stops during the third goal.
    let mut skill = navigation("Crossing");
    let (server, goal) = loop {
        tokio::select! {
            biased;
            status = driven.tick(&mut skill) => assert_eq!(status, SkillStatus::Running),
        }
        if nav2_task.is_finished() {
            break nav2_task.await.unwrap();
        }
    };
    ros.leave().unwrap();
    drop((server, goal, ros));
    let server_gone = failed("NavigateToPose: timed out: the server of /navigate_to_pose is gone");
    assert_eq!(driven.run(&mut skill).await, server_gone);
}
