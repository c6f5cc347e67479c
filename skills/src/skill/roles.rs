//! Resolution of the roles in a task to robots and people.

use super::context::TaskContext;
use crate::bt::{Cause, LeafContext, NodeKind, NodeManifest, PortSpec, PortType, Registry, RegistryError, SyncLeaf};
use crate::names::join_names;
use consort_protocol::ids::{RobotId, RoleId};

pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let role = PortSpec::input("role", PortType::Role);
    register_role_holder(registry, "FindRoleHolder", role.clone())?;
    // Without a role the port `robot` stays empty.
    register_role_holder(registry, "FindRoleHolderIfAny", role.optional())?;
    let ports = [PortSpec::input("person_role", PortType::Role).optional(), PortSpec::output("role", PortType::Role)];
    registry.register(NodeManifest::new("FindPerson", NodeKind::Action, ports), |context: &TaskContext| {
        let context = context.clone();
        Box::new(SyncLeaf(move |leaf: &mut LeafContext<'_, '_>| {
            let role = match leaf.read_optional("person_role")? {
                Some(role) => role,
                None => person(&context)?,
            };
            leaf.write("role", role)?;
            Ok(true)
        }))
    })
}

/// Registers a leaf that writes the robot that holds a role.
fn register_role_holder(registry: &mut Registry<TaskContext>, id: &str, role: PortSpec) -> Result<(), RegistryError> {
    let ports = [role, PortSpec::output("robot", PortType::Robot)];
    registry.register(NodeManifest::new(id, NodeKind::Action, ports), |context: &TaskContext| {
        let context = context.clone();
        Box::new(SyncLeaf(move |leaf: &mut LeafContext<'_, '_>| {
            if let Some(role) = leaf.read_optional("role")? {
                leaf.write("robot", role_holder(&context, &role)?)?;
            }
            Ok(true)
        }))
    })
}

/// Returns the robot that holds a role.
fn role_holder(context: &TaskContext, role: &RoleId) -> Result<RobotId, Cause> {
    let holders = &context.skill.holders;
    holders.get(role).cloned().ok_or_else(|| {
        let held: Vec<String> = holders.iter().map(|(role, robot)| format!("{role} by {robot}")).collect();
        Cause::new(format!("no robot holds role {role}; held are {}", join_names(held.iter().map(String::as_str))))
    })
}

/// Returns the person doing the task jointly with the robot, if the task names no person.
fn person(context: &TaskContext) -> Result<RoleId, Cause> {
    let people = context.task.roles.iter().filter(|role| !context.skill.holders.contains_key(*role));
    match people.collect::<Vec<_>>()[..] {
        [role] => Ok(role.clone()),
        _ => {
            Err(Cause::new("the task names no person: set `person_role`, or do the task jointly with a single person"))
        }
    }
}
