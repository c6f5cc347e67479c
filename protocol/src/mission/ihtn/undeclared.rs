//! Actions of a flat iHTN for which a domain has no task type.

use super::build::{Builder, LOCATION, OBJECT};
use super::form::NodeType;
use super::tree::find_root;
use super::{IhtnOptions, parse_nodes};
use crate::mission::diagnostic::MissionErrors;
use crate::mission::domain::{Domain, ParameterSchema, TaskSchema, ValueKind};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

/// Result of [`undeclared_actions`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UndeclaredActions {
    /// Use of each undeclared name.
    pub actions: BTreeMap<String, ActionUse>,
    /// Locations of all actions, in the order of the mission.
    pub locations: Vec<String>,
    /// Agents of all actions.
    pub agents: BTreeSet<String>,
}

/// Use of an action's name by the nodes of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActionUse {
    /// Least and greatest number of locations.
    pub locations: RangeInclusive<usize>,
    /// Least and greatest number of agents that are objects.
    pub objects: RangeInclusive<usize>,
    /// Greatest number of agents that are robots or people.
    pub roles: usize,
}

impl ActionUse {
    /// Returns the parameters of a task type that fits every use.
    pub fn schema(&self) -> TaskSchema {
        let (places, objects) = (*self.locations.end(), *self.objects.end());
        let is_required = |range: &RangeInclusive<usize>, number: usize| number <= *range.start();
        let mut schema = TaskSchema::default();
        let mut add = |name: String, kind: ValueKind, required: bool| {
            schema.parameters.insert(name, ParameterSchema { kind, required });
        };
        match places {
            1 => add("at".to_owned(), ValueKind::Place, is_required(&self.locations, 1)),
            _ => (1..=places).for_each(|number| {
                add(format!("{LOCATION}_{number}"), ValueKind::Place, is_required(&self.locations, number));
            }),
        }
        if objects > 0 && *self.objects.start() < 2 {
            add(OBJECT.to_owned(), ValueKind::Text, self.objects == (1..=1));
        }
        if objects > 1 {
            let always = *self.objects.start() > 1;
            (1..=objects).for_each(|number| {
                add(format!("{OBJECT}_{number}"), ValueKind::Text, always && is_required(&self.objects, number));
            });
        }
        schema
    }
}

/// Finds the actions whose names have no task type in the domain, or a task type that does not fit
/// their locations and objects.
///
/// # Errors
/// [`MissionErrors`] of the form and of the tree.
pub fn undeclared_actions(
    text: &str,
    options: &IhtnOptions,
    domain: &Domain,
) -> Result<UndeclaredActions, MissionErrors> {
    let all = |diagnostics| MissionErrors { mission: options.name.to_string(), diagnostics };
    let nodes = parse_nodes(text, &options.name)?;
    let root = find_root(&nodes).map_err(all)?;
    let mut builder = Builder::new(&nodes, options, domain);
    builder.build(root);
    let mut found = UndeclaredActions { actions: BTreeMap::new(), locations: vec![], agents: BTreeSet::new() };
    for id in &builder.order {
        let node = &nodes[*id];
        if node.node_type != NodeType::Action {
            continue;
        }
        for location in &node.locations.0 {
            if !found.locations.contains(location) {
                found.locations.push(location.clone());
            }
        }
        found.agents.extend(node.agents.0.iter().cloned());
        if !builder.unfit.contains(node.name.as_str()) {
            continue;
        }
        let objects = node.agents.0.iter().filter(|agent| domain.ihtn_names().objects.contains(*agent)).count();
        let (locations, roles) = (node.locations.0.len(), node.agents.0.len() - objects);
        found
            .actions
            .entry(node.name.clone())
            .and_modify(|used| {
                used.locations = widen(&used.locations, locations);
                used.objects = widen(&used.objects, objects);
                used.roles = used.roles.max(roles);
            })
            .or_insert(ActionUse { locations: locations..=locations, objects: objects..=objects, roles });
    }
    Ok(found)
}

fn widen(range: &RangeInclusive<usize>, number: usize) -> RangeInclusive<usize> {
    *range.start().min(&number)..=*range.end().max(&number)
}
