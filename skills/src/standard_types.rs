//! The task types of the skills that are written in Rust, with their parameters.

use consort_protocol::ids::TaskType;
use consort_protocol::mission::{Domain, TaskSchema, ValueKind};

/// Returns the task types of the standard skills.
pub(crate) fn standard_types() -> Domain {
    use ValueKind::{OneOf, Place, Role, Seconds, Text};
    let position = OneOf(["open", "close"].map(str::to_owned).into());
    let task = TaskSchema::default;
    [
        ("navigation", task().required("to", Place)),
        ("approach_person", task().optional("person_role", Role).optional("timeout_s", Seconds)),
        ("authenticate_person", task().optional("person_role", Role).optional("timeout_s", Seconds)),
        ("approach_robot", task().required("robot_role", Role)),
        ("operate_drawer", task().required("action", position)),
        ("deposit", task().optional("into_role", Role).optional("item", Text).optional("timeout_s", Seconds)),
        ("pick_up", task().required("from_role", Role).optional("item", Text)),
        ("wait", task().required("seconds", Seconds)),
        ("follow_path", task().required("waypoints", Text)),
        ("grasp", task().required("object", Text)),
        ("dock", task().optional("charger", Place)),
        ("undock", task()),
    ]
    .into_iter()
    .fold(Domain::default(), |domain, (name, schema)| {
        domain.with(TaskType::new(name).expect("the domain's own names are slugs"), schema)
    })
}
