//! Scaffold of a domain: simulated actions for the actions of a flat iHTN.

use super::DomainFile;
use super::distribution::SimulatedDuration;
use super::form::{ActionForm, DomainForm, IhtnForm, ParameterForm, ParameterKind, SimulatedAction, TaskForm};
use consort_protocol::ids::{ActionName, DomainId, TaskType};
use consort_protocol::mission::{ActionUse, IhtnNames, ParameterSchema, ValueKind};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Duration of a scaffolded action in the simulator, in seconds.
const DURATION_S: [f64; 2] = [3.0, 6.0];

/// Returns a domain with an action and a task type for each of these actions, to be used with the
/// `known` domains. `declared` are the names that they declare.
///
/// A name that is taken by a node of behavior trees or by a task type gets the prefix `ihtn-`. A
/// name that is invalid for a task type is left out; the import of the mission reports it.
pub fn scaffold(
    domain: DomainId,
    mut ihtn: IhtnForm,
    actions: &BTreeMap<String, ActionUse>,
    declared: &IhtnNames,
    known: &[&DomainFile],
) -> DomainForm {
    let mut form = DomainForm {
        domain,
        description: "Actions of a mission in the flat iHTN form.".to_owned(),
        actions: BTreeMap::new(),
        readings: BTreeMap::new(),
        tasks: BTreeMap::new(),
        ihtn: IhtnForm::default(),
    };
    for (name, used) in actions {
        let candidates = [name.clone(), format!("ihtn-{name}")];
        let added = candidates.iter().find_map(|candidate| {
            let (action, task_type) = (ActionName::new(&**candidate).ok()?, TaskType::new(&**candidate).ok()?);
            let single = with_action(empty(&form), action, task_type.clone(), used);
            let is_free = DomainFile::check(single.clone(), &BTreeMap::new(), known).is_ok();
            is_free.then_some((single, task_type))
        });
        let Some((single, task_type)) = added else { continue };
        if task_type.as_str() != name || declared.actions.contains_key(name) {
            ihtn.actions.insert(name.clone(), task_type);
        }
        form.actions.extend(single.actions);
        form.tasks.extend(single.tasks);
    }
    DomainForm { ihtn, ..form }
}

fn empty(form: &DomainForm) -> DomainForm {
    DomainForm { actions: BTreeMap::new(), tasks: BTreeMap::new(), ..form.clone() }
}

fn with_action(mut form: DomainForm, action: ActionName, task_type: TaskType, used: &ActionUse) -> DomainForm {
    let parameters: BTreeMap<String, ParameterForm> =
        used.schema().parameters.iter().map(|(name, schema)| (name.clone(), parameter(schema))).collect();
    let simulate = SimulatedAction { duration_s: SimulatedDuration::Range(DURATION_S), ..SimulatedAction::default() };
    let own = ActionForm { parameters: parameters.clone(), simulate, ..ActionForm::default() };
    form.actions.insert(action.clone(), own);
    let task = TaskForm { parameters, action: Some(action), ..TaskForm::default() };
    form.tasks.insert(task_type, task);
    form
}

fn parameter(schema: &ParameterSchema) -> ParameterForm {
    let kind = if schema.kind == ValueKind::Place { ParameterKind::Place } else { ParameterKind::Text };
    ParameterForm {
        kind,
        unit: String::new(),
        description: String::new(),
        minimum: None,
        maximum: None,
        one_of: Default::default(),
        optional: !schema.required,
    }
}

/// Writes a scaffolded domain as YAML, after a comment.
pub fn scaffold_yaml(form: &DomainForm, comment: &[String]) -> String {
    let mut text = String::new();
    let mut line = |line: std::fmt::Arguments<'_>| writeln!(text, "{line}").expect("a text takes every line");
    comment.iter().for_each(|words| line(format_args!("# {words}")));
    line(format_args!("domain: {}", scalar(form.domain.as_str())));
    line(format_args!("description: {}", scalar(&form.description)));
    let IhtnForm { people, objects, places, actions, .. } = &form.ihtn;
    if form.ihtn != IhtnForm::default() {
        line(format_args!("ihtn:"));
    }
    let list = |names: Vec<&str>| names.into_iter().map(scalar).collect::<Vec<_>>().join(", ");
    if !people.is_empty() {
        line(format_args!("  people: [{}]", list(people.iter().map(|name| name.as_str()).collect())));
    }
    if !objects.is_empty() {
        line(format_args!("  objects: [{}]", list(objects.iter().map(String::as_str).collect())));
    }
    if !places.is_empty() {
        line(format_args!("  places:"));
        places.iter().for_each(|(name, place)| line(format_args!("    {}: {}", scalar(name), scalar(place.as_str()))));
    }
    if !actions.is_empty() {
        line(format_args!("  actions:"));
        actions.iter().for_each(|(name, own)| line(format_args!("    {}: {}", scalar(name), scalar(own.as_str()))));
    }
    if !form.actions.is_empty() {
        line(format_args!("actions:"));
    }
    for (name, action) in &form.actions {
        line(format_args!("  {}:", scalar(name.as_str())));
        if !action.parameters.is_empty() {
            line(format_args!("    parameters: {}", parameters(&action.parameters)));
        }
        let [least, greatest] = DURATION_S;
        line(format_args!("    simulate: {{ duration_s: [{least:?}, {greatest:?}] }}"));
    }
    if !form.tasks.is_empty() {
        line(format_args!("tasks:"));
    }
    for (name, task) in &form.tasks {
        line(format_args!("  {}:", scalar(name.as_str())));
        if !task.parameters.is_empty() {
            line(format_args!("    parameters: {}", parameters(&task.parameters)));
        }
        let action = task.action.iter().map(ActionName::as_str).collect::<String>();
        line(format_args!("    action: {}", scalar(&action)));
    }
    text
}

fn parameters(parameters: &BTreeMap<String, ParameterForm>) -> String {
    let each = parameters.iter().map(|(name, parameter)| {
        let kind = if parameter.kind == ParameterKind::Place { "place" } else { "text" };
        let optional = if parameter.optional { ", optional: true" } else { "" };
        format!("{name}: {{ type: {kind}{optional} }}")
    });
    format!("{{ {} }}", each.collect::<Vec<_>>().join(", "))
}

/// Writes a text as a scalar of YAML; in quotes, as in JSON, unless it is certainly a plain text.
fn scalar(text: &str) -> String {
    let is_plain = text.len() > 5
        && text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text.ends_with(|last: char| last.is_ascii_alphanumeric() || last == '.')
        && text.chars().all(|letter| letter.is_ascii_alphanumeric() || "_- .".contains(letter));
    // Words such as `no` and `null` have up to 5 letters.
    if is_plain { text.to_owned() } else { serde_json::Value::from(text).to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::{PlaceId, RoleId};
    use consort_protocol::yaml;

    fn used(locations: usize, objects: usize) -> ActionUse {
        ActionUse { locations: 0..=locations, objects: objects..=objects, roles: 1 }
    }

    #[test]
    fn a_scaffold_is_a_valid_domain_and_its_text_reads_back() {
        let actions: BTreeMap<String, ActionUse> = [
            ("wait-for-food", used(1, 0)),
            ("move-bed", used(2, 2)),
            ("no", used(0, 1)),
            // Taken: a task type, and a node of behavior trees.
            ("wait", used(0, 0)),
            ("Sequence", used(0, 0)),
            // Declared by another domain as another task type.
            ("navto", used(0, 0)),
            ("not a name", used(0, 0)),
        ]
        .map(|(name, used)| (name.to_owned(), used))
        .into();
        let ihtn = IhtnForm {
            reaching: [].into(),
            people: [RoleId::new("Patient1").unwrap()].into(),
            objects: ["tray: 7".to_owned()].into(),
            places: [("Room \"A\"".to_owned(), PlaceId::new("IC Room 1").unwrap())].into(),
            actions: BTreeMap::new(),
        };
        let declared = IhtnNames {
            actions: [("navto".to_owned(), TaskType::new("navigation").unwrap())].into(),
            ..IhtnNames::default()
        };
        let form = scaffold(DomainId::new("food").unwrap(), ihtn, &actions, &declared, &[]);
        let names: Vec<&str> = form.tasks.keys().map(TaskType::as_str).collect();
        assert_eq!(names, ["ihtn-Sequence", "ihtn-wait", "move-bed", "navto", "no", "wait-for-food"]);
        let renamed: Vec<(&str, &str)> =
            form.ihtn.actions.iter().map(|(name, own)| (name.as_str(), own.as_str())).collect();
        assert_eq!(renamed, [("Sequence", "ihtn-Sequence"), ("navto", "navto"), ("wait", "ihtn-wait")]);
        let text = scaffold_yaml(&form, &["A comment.".to_owned()]);
        assert_eq!(yaml::parse::<DomainForm>(&text), Ok(form.clone()), "{text}");
        assert!(DomainFile::check(form, &BTreeMap::new(), &[]).is_ok(), "{text}");
    }
}
