//! RIHS01 type hashes, computed from the published definitions by the published rule.
//!
//! The rule (REP-2016, `rosidl_generator_type_description`): SHA-256 of the description of the type
//! and of the types that it refers to, by name, as JSON with the separators `", "` and `": "`,
//! fields in the order of the definition, without default values. Services and actions are
//! descriptions of their parts. Two hashes printed in the design document of `rmw_zenoh` verify the
//! implementation of the rule.

use consort_ros2::messages::NavigateToPose;
use hiroz::action::ZAction;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};

type Definitions = BTreeMap<String, Vec<(String, String)>>;

/// Numbers of `type_description_interfaces/msg/FieldType`.
const PRIMITIVES: [(&str, u8); 11] = [
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("float32", 10),
    ("float64", 11),
    ("bool", 15),
    ("string", 17),
];

fn define(all: &mut Definitions, name: &str, fields: &str) {
    let field = |line: &str| {
        let (kind, name) = line.trim().split_once(' ').expect("a type and a name");
        (name.to_owned(), kind.to_owned())
    };
    all.insert(name.to_owned(), fields.split(';').map(field).collect());
}

fn define_service(all: &mut Definitions, name: &str, request: &str, response: &str) {
    define(all, &format!("{name}_Request"), request);
    define(all, &format!("{name}_Response"), response);
    let event =
        format!("service_msgs/msg/ServiceEventInfo info; {name}_Request[<=1] request; {name}_Response[<=1] response");
    define(all, &format!("{name}_Event"), &event);
    let whole = format!("{name}_Request request_message; {name}_Response response_message; {name}_Event event_message");
    define(all, name, &whole);
}

fn define_action(all: &mut Definitions, name: &str, [goal, result, feedback]: [&str; 3]) {
    let uuid = "unique_identifier_msgs/msg/UUID goal_id";
    define(all, &format!("{name}_Goal"), goal);
    define(all, &format!("{name}_Result"), result);
    define(all, &format!("{name}_Feedback"), feedback);
    let accepted = "bool accepted; builtin_interfaces/msg/Time stamp";
    define_service(all, &format!("{name}_SendGoal"), &format!("{uuid}; {name}_Goal goal"), accepted);
    define_service(all, &format!("{name}_GetResult"), uuid, &format!("int8 status; {name}_Result result"));
    define(all, &format!("{name}_FeedbackMessage"), &format!("{uuid}; {name}_Feedback feedback"));
}

/// The messages of ROS 2 Jazzy (the same in Kilted), from `rcl_interfaces`, `common_interfaces`,
/// `unique_identifier_msgs`, `example_interfaces` and `navigation2`.
fn definitions() -> Definitions {
    let mut all = Definitions::new();
    define(&mut all, "builtin_interfaces/msg/Time", "int32 sec; uint32 nanosec");
    define(&mut all, "builtin_interfaces/msg/Duration", "int32 sec; uint32 nanosec");
    define(&mut all, "std_msgs/msg/String", "string data");
    define(&mut all, "std_msgs/msg/Header", "builtin_interfaces/msg/Time stamp; string frame_id");
    define(&mut all, "geometry_msgs/msg/Point", "float64 x; float64 y; float64 z");
    define(&mut all, "geometry_msgs/msg/Quaternion", "float64 x; float64 y; float64 z; float64 w");
    let pose = "geometry_msgs/msg/Point position; geometry_msgs/msg/Quaternion orientation";
    define(&mut all, "geometry_msgs/msg/Pose", pose);
    define(&mut all, "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Header header; geometry_msgs/msg/Pose pose");
    define(&mut all, "unique_identifier_msgs/msg/UUID", "uint8[16] uuid");
    let info = "uint8 event_type; builtin_interfaces/msg/Time stamp; uint8[16] client_gid; int64 sequence_number";
    define(&mut all, "service_msgs/msg/ServiceEventInfo", info);
    let info = "unique_identifier_msgs/msg/UUID goal_id; builtin_interfaces/msg/Time stamp";
    define(&mut all, "action_msgs/msg/GoalInfo", info);
    define(&mut all, "action_msgs/msg/GoalStatus", "action_msgs/msg/GoalInfo goal_info; int8 status");
    define(&mut all, "action_msgs/msg/GoalStatusArray", "action_msgs/msg/GoalStatus[] status_list");
    let canceling = "int8 return_code; action_msgs/msg/GoalInfo[] goals_canceling";
    define_service(&mut all, "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalInfo goal_info", canceling);
    define_service(&mut all, "example_interfaces/srv/AddTwoInts", "int64 a; int64 b", "int64 sum");
    let navigate = [
        "geometry_msgs/msg/PoseStamped pose; string behavior_tree",
        "uint16 error_code; string error_msg",
        "geometry_msgs/msg/PoseStamped current_pose; builtin_interfaces/msg/Duration navigation_time; \
         builtin_interfaces/msg/Duration estimated_time_remaining; int16 number_of_recoveries; float32 distance_remaining",
    ];
    define_action(&mut all, "nav2_msgs/action/NavigateToPose", navigate);
    all
}

/// Returns the type of a field: number, capacity and, for a composite type, its name.
fn field_type(kind: &str) -> (u8, u64, &str) {
    let (base, offset, capacity) = match kind.strip_suffix(']').and_then(|kind| kind.split_once('[')) {
        None => (kind, 0, 0),
        Some((base, "")) => (base, 144, 0),
        Some((base, size)) => match size.strip_prefix("<=") {
            Some(most) => (base, 96, most.parse().unwrap()),
            None => (base, 48, size.parse().unwrap()),
        },
    };
    match PRIMITIVES.iter().find(|(name, _)| *name == base) {
        Some((_, number)) => (number + offset, capacity, ""),
        None => (1 + offset, capacity, base),
    }
}

fn description(all: &Definitions, name: &str) -> String {
    let fields = all[name].iter().map(|(field, kind)| {
        let (number, capacity, nested) = field_type(kind);
        format!(
            "{{\"name\": \"{field}\", \"type\": {{\"type_id\": {number}, \"capacity\": {capacity}, \
             \"string_capacity\": 0, \"nested_type_name\": \"{nested}\"}}}}"
        )
    });
    format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", fields.collect::<Vec<_>>().join(", "))
}

fn referred(all: &Definitions, name: &str, found: &mut BTreeSet<String>) {
    for (_, kind) in &all[name] {
        let (.., nested) = field_type(kind);
        if !nested.is_empty() && found.insert(nested.to_owned()) {
            referred(all, nested, found);
        }
    }
}

fn rihs01(name: &str) -> String {
    let all = definitions();
    let mut found = BTreeSet::new();
    referred(&all, name, &mut found);
    let referred: Vec<String> = found.iter().map(|name| description(&all, name)).collect();
    let json = format!(
        "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
        description(&all, name),
        referred.join(", ")
    );
    Sha256::digest(json).iter().fold("RIHS01_".to_owned(), |text, byte| format!("{text}{byte:02x}"))
}

/// The published hashes are from the design document of `rmw_zenoh`, "Topic and Service name
/// mapping to Zenoh key expressions".
#[test]
fn the_rule_gives_the_published_hashes() {
    let published = [
        ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (
            "example_interfaces/srv/AddTwoInts",
            "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
        ),
    ];
    for (name, hash) in published {
        assert_eq!(rihs01(name), hash, "{name}");
    }
}

#[test]
fn each_part_of_the_action_has_the_hash_of_its_definition() {
    let parts = [
        (NavigateToPose::send_goal_type_info(), "nav2_msgs/action/NavigateToPose_SendGoal"),
        (NavigateToPose::get_result_type_info(), "nav2_msgs/action/NavigateToPose_GetResult"),
        (NavigateToPose::feedback_type_info(), "nav2_msgs/action/NavigateToPose_FeedbackMessage"),
        (NavigateToPose::cancel_goal_type_info(), "action_msgs/srv/CancelGoal"),
        (NavigateToPose::status_type_info(), "action_msgs/msg/GoalStatusArray"),
    ];
    for (info, name) in parts {
        assert_eq!(info.hash.to_rihs_string(), rihs01(name), "{name}");
        // DDS type names: nav2_msgs/action/X is nav2_msgs::action::dds_::X_.
        let (package, rest) = name.split_once('/').unwrap();
        let (kind, name) = rest.split_once('/').unwrap();
        assert_eq!(info.name, format!("{package}::{kind}::dds_::{name}_"));
    }
}
