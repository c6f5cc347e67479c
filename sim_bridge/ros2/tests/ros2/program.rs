//! Tests of the program as a process.

use crate::support::{LIMIT, Offered, carrier, keys, to_place, until, within};
use bytes::Bytes;
use consort_bus::Bus;
use consort_protocol::keys::{DriverCall, Key};
use consort_protocol::pose::Pose;
use consort_ros2::messages::{NavigateResult, NavigateToPose};
use consort_ros2::ros::Ros;
use consort_skills::actions::RobotBackend;
use hiroz::Builder;
use hiroz::action::client::{GoalHandle, ZActionClient};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

type Client = ZActionClient<NavigateToPose>;
type Handle = GoalHandle<NavigateToPose>;

/// A process that is killed when dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_consort-ros2"));
    command.args(arguments).env_remove("ROS_DOMAIN_ID").env_remove("RUST_LOG");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

#[tokio::test(flavor = "multi_thread")]
async fn it_serves_a_world_of_the_fleet_until_sigterm() {
    let offered = Offered::without_bridge(vec![carrier("ada", "Dock", 1.0)]).await;
    let world = offered.bus.listen_addresses().await.join(",");
    let ends = ["--connect", &world, "--router", &offered.router.address, "--map", "hospital"];
    let mut running = Running(program(&["serve"]).args(ends).spawn().unwrap());
    let ros = offered.router.join("rviz");
    let client = ros.node.create_action_client::<NavigateToPose>("/ada/navigate_to_pose").build().unwrap();
    assert!(client.wait_for_server(LIMIT).await, "an action server within {LIMIT:?}");
    let outcome = within("the result", async { client.send_goal(to_place("Crossing")).await.unwrap().result().await });
    assert_eq!(outcome.await.unwrap(), NavigateResult::default());
    assert_eq!(offered.world.telemetry(&"ada".parse().unwrap()).unwrap().place.as_str(), "Crossing");

    let signal_sent = Command::new("kill").args(["-TERM", &running.0.id().to_string()]).status().unwrap();
    assert!(signal_sent.success());
    until("the end of the process", async || running.0.try_wait().unwrap().is_some_and(|status| status.success()))
        .await;
    let gone = async || !ros.node.graph().has_action_server("/ada/navigate_to_pose");
    until("an empty graph", gone).await;
}

/// Starts the program for a world, and a goal that takes long. Returns the program, its arguments and
/// the goal, for which the robot drives.
async fn drive_far(offered: &Offered) -> (Running, Vec<String>, Ros, Client, Handle) {
    let world = offered.bus.listen_addresses().await.join(",");
    let ends = ["--connect", &world, "--router", &offered.router.address, "--map", "hospital"].map(str::to_owned);
    let running = Running(program(&["serve"]).args(&ends).spawn().unwrap());
    let ros = offered.router.join("rviz");
    let client = ros.node.create_action_client::<NavigateToPose>("/ada/navigate_to_pose").build().unwrap();
    assert!(client.wait_for_server(LIMIT).await, "an action server within {LIMIT:?}");
    let mut handle = within("acceptance", client.send_goal(to_place("PC Room 8"))).await.unwrap();
    let mut feedback = handle.feedback().unwrap();
    within("feedback", feedback.recv()).await.unwrap();
    (running, ends.to_vec(), ros, client, handle)
}

fn pose(offered: &Offered) -> Pose {
    offered.world.telemetry(&"ada".parse().unwrap()).unwrap().pose
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restarted_server_cancels_the_goal_of_its_previous_run() {
    let offered = Offered::without_bridge(vec![carrier("ada", "Dock", 1.0)]).await;
    let (running, ends, _ros, client, _handle) = drive_far(&offered).await;
    drop(running);
    let _restarted = Running(program(&["serve"]).args(&ends).spawn().unwrap());
    // Until the graph shows the end of the killed server, it may receive the goal.
    let mut outcome = None;
    until("a goal at the restarted server", async || {
        let sent = tokio::time::timeout(Duration::from_secs(5), client.send_goal(to_place("Crossing"))).await;
        if let Ok(Ok(handle)) = sent {
            outcome = tokio::time::timeout(LIMIT, handle.result()).await.ok();
        }
        outcome.is_some()
    })
    .await;
    assert_eq!(outcome.unwrap().unwrap(), NavigateResult::default());
    assert_eq!(offered.world.telemetry(&"ada".parse().unwrap()).unwrap().place.as_str(), "Crossing");
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_stops_the_robot_and_returns_a_result() {
    let offered = Offered::without_bridge(vec![carrier("ada", "Dock", 1.0)]).await;
    let (mut running, _, _ros, _client, handle) = drive_far(&offered).await;
    let result = tokio::spawn(handle.result());
    let signal_sent = Command::new("kill").args(["-TERM", &running.0.id().to_string()]).status().unwrap();
    assert!(signal_sent.success());
    let outcome = within("the result", result).await.unwrap().unwrap();
    let here = pose(&offered);
    assert_eq!((outcome.error_code, outcome.error_msg.as_str()), (9000, "the action server is stopping"));
    until("the end of the process", async || running.0.try_wait().unwrap().is_some_and(|status| status.success()))
        .await;
    let then = offered.world.now().as_secs() + 2.0;
    until("two seconds of the world", async || offered.world.now().as_secs() > then).await;
    assert_eq!(pose(&offered), here, "it has stopped");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_runs_the_driver_server_of_a_robot_under_nav2() {
    let offered = Offered::without_bridge(vec![]).await;
    let fleet = offered.bus.listen_addresses().await.join(",");
    let ends = ["--connect", &fleet, "--router", &offered.router.address, "--map", "hospital"];
    let robot = ["--robot", "bob", "--place", "IC Room 6"];
    let _running = Running(program(&["drive"]).args(ends).args(robot).spawn().unwrap());
    let command = keys().write(&Key::Driver("bob".parse().unwrap(), DriverCall::Command));
    let heartbeat = consort_fleet::robot_driver::DriverCommand { request: None, permit: Default::default() };
    let bytes = Bytes::from(consort_protocol::codec::encode(&heartbeat).unwrap());
    let mut state = None;
    until("the state of the robot", async || {
        let mut replies = offered.bus.query(&command, bytes.clone(), Duration::from_secs(1)).await.unwrap();
        while let Some(reply) = replies.recv().await {
            state = state.take().or(reply.payload.ok());
        }
        state.is_some()
    })
    .await;
    let state: consort_fleet::robot_driver::DriverState = consort_protocol::codec::decode(&state.unwrap()).unwrap();
    assert_eq!((state.robot.as_str(), state.telemetry.place.as_str()), ("bob", "IC Room 6"));
}

#[test]
fn invalid_arguments_are_rejected_with_the_reason() {
    let refused = |arguments: &[&str]| -> Output {
        program(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap()
    };
    let nowhere = refused(&["serve", "--connect", "tcp/127.0.0.1:9", "--map", "no-such-map.yaml"]);
    let message = String::from_utf8(nowhere.stderr).unwrap();
    assert_eq!(nowhere.status.code(), Some(1), "{message}");
    assert!(message.contains("no-such-map.yaml"), "{message}");
    let missing = refused(&["drive", "--robot", "ada"]);
    let message = String::from_utf8(missing.stderr).unwrap();
    assert_eq!(missing.status.code(), Some(2), "{message}");
    assert!(message.contains("--connect") && message.contains("--place"), "{message}");
}
