//! What a simulated robot tells ROS 2 about itself: `/NAME/odom`, `/NAME/battery_state`, its transform
//! on `/tf`, and `/NAME/scan` from its range sensors.

use crate::dynamic::graph::Graph;
use crate::mapping;
use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::ids::RobotId;
use consort_skills::actions::Telemetry;
use consort_world::world::RangeReading;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::MissedTickBehavior;
use tracing::warn;

/// Messages of a robot: topic, type, message.
pub type SensorMessages = [(String, &'static str, Value); 3];

/// Status of a battery that is used, in `sensor_msgs/msg/BatteryState`.
const DISCHARGING: u8 = 2;

/// Interval of scans.
const SCAN_INTERVAL: Duration = Duration::from_millis(500);

/// Time limit of a world to reply with the readings of sensors.
const SCAN_TIMEOUT: Duration = Duration::from_secs(1);

/// Smallest angle between two rays of a scan.
const STEP_MIN_RAD: f64 = 1e-3;

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

/// Returns the scan of range sensors, in the order of their directions; `None` without a sensor.
///
/// A scan has rays at equal angles: here the smallest angle between two sensors. A ray without a sensor
/// is not a number, and a free ray is infinite (REP-117).
pub fn scan(name: &str, ranges: &[RangeReading], stamp: crate::messages::Time) -> Option<Value> {
    let (first, last) = (ranges.first()?.bearing_rad, ranges.last()?.bearing_rad);
    let gaps = ranges.windows(2).map(|pair| pair[1].bearing_rad - pair[0].bearing_rad);
    let step = gaps.filter(|gap| *gap >= STEP_MIN_RAD).fold(f64::INFINITY, f64::min);
    let step = if step.is_finite() { step } else { 0.0 };
    let ray = |bearing_rad: f64| if step > 0.0 { ((bearing_rad - first) / step).round() as usize } else { 0 };
    let mut rays = vec![json!("nan"); ray(last) + 1];
    for range in ranges {
        rays[ray(range.bearing_rad)] = range.distance_m.map_or_else(|| json!("inf"), Value::from);
    }
    let range_max = ranges.iter().map(|range| range.reach_m).fold(0.0, f64::max);
    Some(json!({
        "header": {"frame_id": format!("{name}/base_link"), "stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}},
        "angle_min": first, "angle_max": last, "angle_increment": step, "scan_time": SCAN_INTERVAL.as_secs_f64(),
        "range_min": 0.0, "range_max": range_max, "ranges": rays,
    }))
}

/// Publishes the scan of a robot until it turns out to have no range sensor.
pub(super) async fn publish_scans(graph: Arc<Graph>, bus: SharedBus, world: String, robot: RobotId) {
    let name = mapping::ros_name(&robot);
    let topic = format!("/{name}/scan");
    let mut due = tokio::time::interval(SCAN_INTERVAL);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        due.tick().await;
        let Some(ranges) = read_ranges(&bus, &world, &robot).await else { continue };
        let Some(message) = scan(&name, &ranges, mapping::now()) else { return };
        if let Err(problem) = graph.publish(&topic, "sensor_msgs/msg/LaserScan", &message).await {
            warn!(topic, %problem, "a scan was not published");
        }
    }
}

/// Returns the readings of a robot's range sensors; empty if the worlds reply that it has none, and
/// `None` without a reply.
async fn read_ranges(bus: &SharedBus, world: &str, robot: &RobotId) -> Option<Vec<RangeReading>> {
    let mut replies = bus.query(world, Bytes::from(robot.to_string()), SCAN_TIMEOUT).await.ok()?;
    let mut found: Option<Vec<RangeReading>> = None;
    while let Some(reply) = replies.recv().await {
        let Ok(payload) = reply.payload else { continue };
        // A world of an earlier version replies with its report, which is no list.
        let ranges: Vec<RangeReading> = serde_json::from_slice(&payload).unwrap_or_default();
        found.get_or_insert_default().extend(ranges);
    }
    found
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

    #[test]
    fn range_sensors_become_a_scan_with_equal_angles() {
        let range = |bearing_rad, distance_m| RangeReading { bearing_rad, reach_m: 8.0, distance_m };
        let stamp = crate::messages::Time { sec: 1, nanosec: 2 };
        let ranges = [range(-1.0, Some(2.0)), range(-0.5, None), range(0.5, Some(4.0))];
        let message = scan("ada", &ranges, stamp).unwrap();
        assert_eq!(message["ranges"], json!([2.0, "inf", "nan", 4.0]));
        assert_eq!(message["header"]["frame_id"], "ada/base_link");
        let types = TypeRegistry::shipped();
        let bytes = cdr::encode(&types, "sensor_msgs/msg/LaserScan", &message).unwrap();
        let read = cdr::decode(&types, "sensor_msgs/msg/LaserScan", &bytes).unwrap();
        let angles = ["angle_min", "angle_increment", "angle_max", "range_max"].map(|name| read[name].clone());
        assert_eq!(angles, [-1.0, 0.5, 0.5, 8.0].map(Value::from));
        assert_eq!(scan("ada", &ranges[..1], stamp).unwrap()["ranges"], json!([2.0]));
        assert_eq!(scan("ada", &[], stamp), None);
    }
}
