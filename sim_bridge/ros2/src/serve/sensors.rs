//! What a simulated robot tells ROS 2 about itself: `/NAME/odom`, `/NAME/battery_state` and its
//! transform on `/tf`.

use crate::dynamic::graph::Graph;
use crate::mapping;
use consort_skills::actions::Telemetry;
use serde_json::{Value, json};
use std::sync::Arc;
use tracing::warn;

/// Messages of a robot: topic, type, message.
pub type SensorMessages = [(String, &'static str, Value); 3];

/// Status of a battery that is used, in `sensor_msgs/msg/BatteryState`.
const DISCHARGING: u8 = 2;

/// Returns the messages for a robot with a name in ROS 2.
pub fn messages(name: &str, telemetry: &Telemetry, stamp: crate::messages::Time) -> SensorMessages {
    let stamped = mapping::to_ros(telemetry.pose, stamp);
    let stamp = json!({"sec": stamp.sec, "nanosec": stamp.nanosec});
    let header = |frame: &str| json!({"frame_id": frame, "stamp": stamp});
    let body = format!("{name}/base_link");
    let position = json!({"x": stamped.pose.position.x, "y": stamped.pose.position.y, "z": 0.0});
    let orientation = json!({"z": stamped.pose.orientation.z, "w": stamped.pose.orientation.w});
    let pose = json!({"position": position, "orientation": orientation});
    let transform = json!({"translation": position, "rotation": orientation});
    [
        (
            format!("/{name}/odom"),
            "nav_msgs/msg/Odometry",
            json!({"header": header(mapping::FRAME), "child_frame_id": body, "pose": {"pose": pose}}),
        ),
        (
            "/tf".to_owned(),
            "tf2_msgs/msg/TFMessage",
            json!({"transforms": [{"header": header(mapping::FRAME), "child_frame_id": body, "transform": transform}]}),
        ),
        (
            format!("/{name}/battery_state"),
            "sensor_msgs/msg/BatteryState",
            json!({"header": header(&body), "percentage": telemetry.battery.get(), "present": true,
                "power_supply_status": DISCHARGING}),
        ),
    ]
}

/// Publishes the state of a robot.
pub(super) async fn publish(graph: &Arc<Graph>, name: &str, telemetry: &Telemetry) {
    for (topic, type_name, message) in messages(name, telemetry, mapping::now()) {
        if let Err(problem) = graph.publish(&topic, type_name, &message).await {
            warn!(topic, %problem, "a state was not published");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamic::cdr;
    use crate::dynamic::types::TypeRegistry;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::{BatteryShare, WorldTime};

    #[test]
    fn the_state_of_a_robot_becomes_odometry_transform_and_battery() {
        let telemetry = Telemetry {
            time: WorldTime::from_secs(1.0),
            pose: Pose::new(1.0, 2.0, 0.0),
            place: "Dock".parse().unwrap(),
            battery: BatteryShare::new(0.5).unwrap(),
            able: true,
            closed: vec![],
            readings: [].into(),
        };
        let types = TypeRegistry::shipped();
        let read =
            messages("ada", &telemetry, crate::messages::Time { sec: 1, nanosec: 2 }).map(|(topic, kind, value)| {
                let bytes = cdr::encode(&types, kind, &value).unwrap();
                (topic, cdr::decode(&types, kind, &bytes).unwrap())
            });
        let topics = read.iter().map(|(topic, _)| topic.as_str()).collect::<Vec<_>>();
        assert_eq!(topics, ["/ada/odom", "/tf", "/ada/battery_state"]);
        assert_eq!(read[0].1["pose"]["pose"]["position"], json!({"x": 1.0, "y": 2.0, "z": 0.0}));
        assert_eq!(read[1].1["transforms"][0]["child_frame_id"], "ada/base_link");
        assert_eq!(read[2].1["percentage"], 0.5);
    }
}
