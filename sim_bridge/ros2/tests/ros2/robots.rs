//! Simulated robots from the view of a ROS 2 client; the client is that of hiroz.

use crate::support::{LIMIT, Offered, carrier, to_place, to_pose, until, within};
use consort_protocol::pose::Pose;
use consort_ros2::described::reports::TRANSFORMS;
use consort_ros2::mapping::FRAME;
use consort_ros2::messages::{NavigateResult, NavigateToPose, Progress};
use consort_ros2::ros::Ros;
use consort_skills::actions::RobotBackend;
use consort_world::space::Sensor;
use consort_world::world::RobotSetup;
use hiroz::Builder;
use hiroz::action::GoalStatus;
use hiroz::action::client::{GoalHandle, ZActionClient};
use serde_json::json;
use std::collections::BTreeSet;
use tokio::sync::mpsc::unbounded_channel;

type Client = ZActionClient<NavigateToPose>;
type Handle = GoalHandle<NavigateToPose>;

/// Returns a client of ada's action server, with a session of its own.
async fn client(offered: &Offered) -> (Ros, Client) {
    let ros = offered.router.join("rviz");
    let client = ros.node.create_action_client::<NavigateToPose>("/ada/navigate_to_pose").build().unwrap();
    assert!(client.wait_for_server(LIMIT).await, "an action server within {LIMIT:?}");
    (ros, client)
}

async fn send(client: &Client, goal: consort_ros2::messages::Goal) -> Handle {
    within("acceptance", client.send_goal(goal)).await.unwrap()
}

/// Returns the final status and the result of a goal.
async fn ended(mut handle: Handle) -> (GoalStatus, NavigateResult) {
    let mut status = handle.status_watch().unwrap();
    // Statuses travel on a topic of their own, and the client drops a goal with its result.
    let last = *within("a last status", status.wait_for(GoalStatus::is_terminal)).await.unwrap();
    (last, within("the result", handle.result()).await.unwrap())
}

fn place(offered: &Offered, robot: &str) -> (String, Pose) {
    let telemetry = offered.world.telemetry(&robot.parse().unwrap()).unwrap();
    (telemetry.place.to_string(), telemetry.pose)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_drives_to_its_goals_and_publishes_feedback() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let (_ros, client) = client(&offered).await;
    let mut handle = send(&client, to_place("Laboratory")).await;
    let mut feedback = handle.feedback().unwrap();
    let outcome = within("the result", handle.result()).await.unwrap();
    assert_eq!(outcome, NavigateResult::default());
    let (name, pose) = place(&offered, "ada");
    assert_eq!((name.as_str(), pose.x, pose.y), ("Laboratory", 13.5, 11.0));

    let feedback_messages: Vec<Progress> = std::iter::from_fn(|| feedback.try_recv().ok()).collect();
    let distances: Vec<f32> =
        feedback_messages.iter().map(|feedback_messages| feedback_messages.distance_remaining).collect();
    // From the dock by the crossing and the corridor: 4.5 m, 7.5 m and 4 m.
    assert!(
        distances.len() > 2 && distances.is_sorted_by(|a, b| a >= b) && distances[0] <= 16.0 && distances[0] > 10.0,
        "{distances:?}"
    );
    for feedback_messages in &feedback_messages {
        assert_eq!(feedback_messages.current_pose.header.frame_id, FRAME);
        // At half a metre per second.
        let remaining_s = f64::from(feedback_messages.estimated_time_remaining.sec)
            + f64::from(feedback_messages.estimated_time_remaining.nanosec) * 1e-9;
        assert!(
            (remaining_s - f64::from(feedback_messages.distance_remaining) / 0.5).abs() < 0.1,
            "{feedback_messages:?}"
        );
    }

    for name in ["Crossing", "Dock", "Crossing"] {
        let outcome = within(name, send(&client, to_place(name)).await.result()).await.unwrap();
        assert_eq!((outcome, place(&offered, "ada").0.as_str()), (NavigateResult::default(), name));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_canceled_goal_leaves_the_robot_between_two_places() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let (_ros, client) = client(&offered).await;
    let mut handle = send(&client, to_place("PC Room 8")).await;
    let mut feedback = handle.feedback().unwrap();
    within("feedback", feedback.recv()).await.unwrap();
    let canceled = within("a reply", handle.cancel()).await.unwrap();
    let named: Vec<_> = canceled.goals_canceling.iter().map(|info| info.goal_id).collect();
    assert_eq!((canceled.return_code, named), (0, vec![handle.id()]));
    assert_eq!(ended(handle).await, (GoalStatus::Canceled, NavigateResult::default()));
    let (_, here) = place(&offered, "ada");
    let then = offered.world.now().as_secs() + 2.0;
    until("two seconds of the world", async || offered.world.now().as_secs() > then).await;
    assert_eq!(place(&offered, "ada").1, here, "it has stopped");
    let room = crate::support::hospital().place(&"PC Room 8".parse().unwrap()).unwrap().pose;
    assert!(here.distance(room).get() > 5.0, "{here:?}");
    // The robot can be sent on from there.
    let outcome = within("the way back", send(&client, to_place("Dock")).await.result()).await.unwrap();
    assert_eq!((outcome, place(&offered, "ada").0.as_str()), (NavigateResult::default(), "Dock"));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unreachable_goal_is_aborted_with_the_code_of_nav2() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let (_ros, client) = client(&offered).await;
    let (status, outcome) = ended(send(&client, to_pose(Pose::new(100.0, 0.0, 0.0))).await).await;
    let error_msg = "no route: no route to (100.00, 0.00) on the map \"hospital\": it is outside the map".to_owned();
    assert_eq!((status, outcome), (GoalStatus::Aborted, NavigateResult { error_code: 208, error_msg }));
    let mut elsewhere = to_place("Crossing");
    elsewhere.pose.header.frame_id = "odom".to_owned();
    let (status, outcome) = ended(send(&client, elsewhere).await).await;
    assert_eq!((status, outcome.error_code), (GoalStatus::Aborted, 9002));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_goal_replaces_an_earlier_goal() {
    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let (_ros, client) = client(&offered).await;
    let first = send(&client, to_place("PC Room 8")).await;
    let second = send(&client, to_place("Crossing")).await;
    let (status, outcome) = ended(first).await;
    assert_eq!((status, outcome.error_msg.as_str()), (GoalStatus::Aborted, "another goal has replaced it"));
    assert_eq!(ended(second).await, (GoalStatus::Succeeded, NavigateResult::default()));
    assert_eq!(place(&offered, "ada").0, "Crossing");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_battery_or_a_lost_world_aborts_the_goal() {
    // 6 % is enough for about ten seconds.
    let offered = Offered::with(vec![carrier("ada", "Dock", 0.06)]).await;
    let (_ros, client) = client(&offered).await;
    let (status, outcome) = ended(send(&client, to_place("Laboratory")).await).await;
    assert_eq!((status, outcome.error_code), (GoalStatus::Aborted, 9000), "{}", outcome.error_msg);
    assert!(outcome.error_msg.starts_with("battery low: "), "{}", outcome.error_msg);

    let offered = Offered::with(vec![carrier("ada", "Dock", 1.0)]).await;
    let (_ros, client) = self::client(&offered).await;
    let mut handle = send(&client, to_place("PC Room 8")).await;
    let mut feedback = handle.feedback().unwrap();
    within("feedback", feedback.recv()).await.unwrap();
    offered.kill_world();
    let (status, outcome) = ended(handle).await;
    let error_msg = "timed out: ada: no state from its driver server for 3 s".to_owned();
    assert_eq!((status, outcome), (GoalStatus::Aborted, NavigateResult { error_code: 9003, error_msg }));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_publishes_its_state_and_the_scan_of_its_range_sensors() {
    let ray = |bearing_rad| Sensor::Range { bearing_rad, reach_m: 30.0 };
    let ada = RobotSetup { sensors: vec![ray(1.0), ray(-1.0), ray(0.0)], ..carrier("ada", "Dock", 1.0) };
    let offered = Offered::with_states(vec![ada, carrier("bob", "Laboratory", 1.0)]).await;
    let graph = offered.router.graph("rviz").await;
    let (sender, mut messages) = unbounded_channel();
    let topics =
        [("/ada/scan", "sensor_msgs/msg/LaserScan"), ("/bob/scan", "sensor_msgs/msg/LaserScan"), ("/tf", TRANSFORMS)];
    let mut subscriptions = vec![];
    for (number, (topic, type_name)) in topics.into_iter().enumerate() {
        subscriptions.push(graph.subscribe(topic, type_name, number, sender.clone()).await.unwrap());
    }
    let (mut scan, mut bodies) = (None, BTreeSet::new());
    while scan.is_none() || bodies.len() < 2 {
        let received = within("a scan and two transforms", messages.recv()).await.unwrap();
        let message = received.message.unwrap();
        match received.subscription {
            0 => scan = Some(message),
            1 => panic!("bob has no range sensor"),
            _ => drop(bodies.insert(message["transforms"][0]["child_frame_id"].to_string())),
        }
    }
    let scan = scan.unwrap();
    assert_eq!(
        (&scan["angle_min"], &scan["angle_increment"], &scan["range_max"]),
        (&json!(-1.0), &json!(1.0), &json!(30.0))
    );
    let expected = offered.world.with(|world| world.read_ranges(&"ada".parse().unwrap()));
    let read: Vec<Option<f64>> = serde_json::from_value(scan["ranges"].clone()).unwrap();
    assert_eq!(read.len(), 3);
    for (read, expected) in read.into_iter().zip(expected) {
        let difference = read.unwrap_or_default() - expected.distance_m.unwrap_or_default();
        assert!(difference.abs() < 1e-3, "{read:?} {expected:?}");
    }
    assert_eq!(bodies, ["\"ada/base_link\"", "\"bob/base_link\""].map(str::to_owned).into());
}

#[tokio::test(flavor = "multi_thread")]
async fn each_robot_has_a_server_with_a_valid_ros_name() {
    let robots =
        vec![carrier("ada", "Dock", 1.0), carrier("lab-arm.2", "Laboratory", 1.0), carrier("7of9", "Crossing", 1.0)];
    let offered = Offered::with(robots).await;
    let ros = offered.router.join("rviz");
    let expected = ["/ada/navigate_to_pose", "/lab_arm_2/navigate_to_pose", "/robot_7of9/navigate_to_pose"];
    until("three action servers", async || expected.iter().all(|name| ros.node.graph().has_action_server(name))).await;
    let mut seen: Vec<(String, String)> = ros.node.graph().get_action_names_and_types();
    seen.sort();
    // The type of the feedback topic, from which ROS 2 derives the type of the action.
    let kind = "nav2_msgs::action::dds_::NavigateToPose_FeedbackMessage_";
    assert_eq!(seen, expected.map(|name| (name.to_owned(), kind.to_owned())));
}
