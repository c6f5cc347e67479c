//! Domain of the shipped skills: the task types of service robots in a hospital, with their
//! parameters. The skills in [`library`](crate::library) execute these tasks, and the missions in
//! [`missions`](crate::missions) use them.

use consort_protocol::ids::TaskType;
use consort_protocol::mission::{Domain, TaskSchema, ValueKind};

/// Returns the task types of service robots in a hospital, which the shipped missions use.
pub fn hospital() -> Domain {
    use ValueKind::{OneOf, Place, Role, Seconds, Text};
    let position = || OneOf(["open", "close"].map(str::to_owned).into());
    let task = TaskSchema::default;
    [
        ("navigation", task().required("to", Place)),
        ("approach_person", task().optional("person_role", Role).optional("timeout_s", Seconds)),
        ("authenticate_person", task().optional("person_role", Role).optional("timeout_s", Seconds)),
        ("approach_robot", task().required("robot_role", Role)),
        ("operate_drawer", task().required("action", position())),
        ("operate_door", task().required("action", position()).optional("at", Place)),
        ("deposit", task().optional("into_role", Role).optional("item", Text).optional("timeout_s", Seconds)),
        ("pick_up", task().required("from_role", Role).optional("item", Text)),
        ("carry", task().required("to", Place).optional("item", Text)),
        ("disinfect", task().optional("at", Place)),
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
