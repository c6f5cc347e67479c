use super::*;
use crate::ids::{PlaceId, TaskType};
use crate::mission::test_data::domain;
use crate::mission::{Format, IhtnFields, IhtnNames, MissionDocument, RoleKind, TaskSchema, ValueKind};

fn options() -> IhtnOptions {
    IhtnOptions { name: TaskId::new("trial").unwrap(), people: [RoleId::new("ann").unwrap()].into() }
}

fn with_names(domain: Domain) -> Domain {
    domain.with_ihtn_names(IhtnNames {
        actions: [("navto".to_owned(), TaskType::new("navigation").unwrap())].into(),
        reaching: [TaskType::new("navigation").unwrap()].into(),
        ..IhtnNames::default()
    })
}

/// A fetch by r1, to which Ann adds an item.
fn nodes() -> Value {
    serde_json::json!({
        "0": { "name": "Fetch", "type": "task", "parent": "-1", "agents": ["r1", "ann", "idler"], "children": ["1"] },
        "1": { "name": "m", "type": "method", "parent": "0", "agents": ["r1", "ann"], "children": ["2", "3", "4", "5"] },
        "2": { "name": "navto", "type": "action", "parent": "1", "locations": ["Ward"], "agents": ["r1"], "children": "" },
        "3": { "name": "operate_box-open", "type": "action", "parent": "1", "locations": "", "agents": ["r1"], "children": "" },
        "4": { "name": "deposit", "type": "action", "parent": "1", "locations": "", "agents": ["ann"], "children": "" },
        "5": { "name": "navto", "type": "action", "parent": "1", "locations": ["Laboratory"], "agents": ["r1"], "children": "" },
    })
}

fn import(nodes: &Value) -> Result<Mission, Vec<String>> {
    import_in(nodes, &with_names(domain()))
}

fn import_in(nodes: &Value, domain: &Domain) -> Result<Mission, Vec<String>> {
    import_ihtn(&nodes.to_string(), &options(), domain)
        .map_err(|errors| errors.diagnostics.iter().map(ToString::to_string).collect())
}

#[test]
fn gaps_of_the_form_are_filled_by_rules() {
    let mission = import(&nodes()).unwrap();
    let tasks: Vec<String> = mission
        .elementary()
        .iter()
        .map(|(id, spec)| format!("{id} {} {:?} {:?}", spec.task_type, spec.parameters, spec.reaches))
        .collect();
    assert_eq!(
        tasks,
        [
            r#"navto navigation {"to": "Ward"} {"location": "Ward"}"#,
            r#"operate_box-open operate_box {"action": "open"} {}"#,
            r#"deposit deposit {"into_role": "r1"} {}"#,
            r#"navto-2 navigation {"to": "Laboratory"} {"location": "Laboratory"}"#,
        ]
    );
    let roles: Vec<(&str, RoleKind)> = mission.roles.iter().map(|(id, role)| (id.as_str(), role.kind)).collect();
    assert_eq!(roles, [("ann", RoleKind::Unmanaged), ("r1", RoleKind::Managed)]);
    assert_eq!(mission.tasks[0].id.as_str(), "Fetch");
}

#[test]
fn a_malformed_tree_is_reported_precisely() {
    type Change<'c> = &'c dyn Fn(&mut Value);
    let cases: [(Change<'_>, &[&str]); 9] = [
        (&|n| n["1"]["children"] = ["2", "3", "4", "5", "9"].into(), &["node 1 (m): its child \"9\" does not exist"]),
        (
            &|n| n["1"]["children"] = ["2", "3", "4"].into(),
            &["node 5 (navto): its parent \"1\" does not have it among its children"],
        ),
        (
            &|n| n["5"]["parent"] = "0".into(),
            &[
                "node 1 (m): its child \"5\" names the parent \"0\"",
                "node 5 (navto): its parent \"0\" does not have it among its children",
            ],
        ),
        (
            &|n| n["5"]["parent"] = "-1".into(),
            &[
                "file: several nodes have the parent \"-1\": 0, 5; exactly 1 node must be the root",
                "node 1 (m): its child \"5\" names the parent \"-1\"",
            ],
        ),
        (
            &|n| {
                n["0"]["parent"] = "1".into();
                n["0"]["agents"] = ["r1", "ann"].into();
                n["1"]["children"] = ["0", "2", "3", "4", "5"].into();
            },
            &[
                "file: there is no root; the root has the parent \"-1\"",
                "node 0 (Fetch): is its own ancestor: 0 > 1 > 0",
            ],
        ),
        (
            &|n| n["0"]["children"] = "".into(),
            &[
                "node 0 (Fetch): has 0 methods; in an instantiated network a task has exactly 1",
                "node 1 (m): its parent \"0\" does not have it among its children",
            ],
        ),
        (
            &|n| n["3"]["name"] = "operate_box-slam".into(),
            &[
                "node 3 (operate_box-slam): unknown task type `operate_box-slam`; allowed: approach, deposit, navigation, operate_box, pick_up, wait; did you mean `operate_box`?",
            ],
        ),
        (
            &|n| n["3"]["locations"] = "Ward".into(),
            &["node 3 (operate_box-open): has the location \"Ward\", but `operate_box` has no parameter for \
               a place"],
        ),
        (
            &|n| n["4"]["agents"] = ["bob"].into(),
            &["node 4 (deposit): its agent `bob` is not among the agents of its parent"],
        ),
    ];
    for (change, expected) in cases {
        let mut nodes = nodes();
        change(&mut nodes);
        assert_eq!(import(&nodes).unwrap_err(), expected);
    }
}

#[test]
fn a_repeated_node_is_rejected() {
    let text = nodes().to_string().replacen("\"1\":", "\"0\":", 1);
    let error = import_ihtn(&text, &options(), &with_names(domain())).unwrap_err().to_string();
    assert!(error.contains("the key `0` occurs twice"), "{error}");
    let text = nodes().to_string().replacen("\"name\":", "\"name\":\"other\",\"name\":", 1);
    let error = import_ihtn(&text, &options(), &with_names(domain())).unwrap_err().to_string();
    assert!(error.contains("duplicate field `name`"), "{error}");
}

#[test]
fn only_agents_with_actions_may_be_people() {
    let mut options = options();
    options.people = [RoleId::new("an").unwrap()].into();
    let error = import_ihtn(&nodes().to_string(), &options, &with_names(domain())).unwrap_err().to_string();
    assert!(error.contains("people/an: is named as a person") && error.contains("did you mean `ann`?"), "{error}");
}

/// A bed is moved by two robots with a trolley.
fn transport() -> Value {
    serde_json::json!({
        "0": { "name": "Transport", "type": "task", "parent": "-1", "agents": ["r1", "r2", "ann", "trolley"], "children": ["1"] },
        "1": { "name": "m", "type": "method", "parent": "0", "agents": ["r1", "r2", "ann", "trolley"], "children": ["2", "3"] },
        "2": { "name": "move-bed", "type": "action", "parent": "1", "locations": ["Ward", "Bay 4"], "agents": ["r1", "r2", "trolley"] },
        "3": { "name": "sign-off", "type": "action", "parent": "1", "locations": [], "agents": ["ann"] },
    })
}

fn transport_domain() -> Domain {
    let task_type = |name: &str| TaskType::new(name).unwrap();
    let moves = TaskSchema::default()
        .required("location_1", ValueKind::Place)
        .required("location_2", ValueKind::Place)
        .required("object", ValueKind::Text);
    domain().with(task_type("move-bed"), moves).with(task_type("sign-off"), TaskSchema::default()).with_ihtn_names(
        IhtnNames {
            people: [RoleId::new("ann").unwrap(), RoleId::new("bob").unwrap()].into(),
            objects: ["trolley".to_owned()].into(),
            places: [("Bay 4".to_owned(), PlaceId::new("Laboratory").unwrap())].into(),
            ..IhtnNames::default()
        },
    )
}

#[test]
fn several_locations_and_objects_become_numbered_parameters() {
    let options = IhtnOptions { people: BTreeSet::new(), ..options() };
    let mission = import_ihtn(&transport().to_string(), &options, &transport_domain()).unwrap();
    let (id, spec) = mission.elementary()[0];
    assert_eq!(
        format!(
            "{id} {} {:?} {:?}",
            spec.task_type,
            spec.roles.iter().map(RoleId::as_str).collect::<Vec<_>>(),
            spec.parameters
        ),
        r#"move-bed move-bed ["r1", "r2"] {"location_1": "Ward", "location_2": "Laboratory", "object": "trolley"}"#
    );
    let kinds: Vec<_> = mission.roles.iter().map(|(id, role)| (id.as_str(), role.kind)).collect();
    assert_eq!(kinds, [("ann", RoleKind::Unmanaged), ("r1", RoleKind::Managed), ("r2", RoleKind::Managed)]);
}

#[test]
fn locations_and_objects_that_do_not_fit_are_reported() {
    let domain = transport_domain();
    let mut nodes = transport();
    nodes["2"]["locations"] = ["Ward", "Bay 4", "Laboratory"].into();
    nodes["3"]["agents"] = ["trolley"].into();
    assert_eq!(
        import_in(&nodes, &domain).unwrap_err(),
        [
            "node 2 (move-bed): has \"Laboratory\", which becomes the parameter `location_3`, but its task \
             type has no such place; allowed: location_1, location_2; did you mean `location_1`?",
            "node 3 (sign-off): has no agent that is a robot or a person; an action needs at least 1",
            "node 3 (sign-off): has \"trolley\", which becomes the parameter `object`, but its task type has \
             no such text; no names are available",
            "people/ann: is named as a person, but is no agent of an action; allowed: r1, r2",
        ]
    );
    let mut nodes = transport();
    nodes["2"]["locations"] = "Ward".into();
    assert_eq!(
        import_in(&nodes, &domain).unwrap_err(),
        ["node 2 (move-bed): `move-bed` needs the parameter `location_2`: a place"]
    );
}

#[test]
fn a_location_that_the_map_lacks_is_reported_at_its_node() {
    let domain = transport_domain().with_places([PlaceId::new("Laboratory").unwrap(), PlaceId::new("Dock").unwrap()]);
    assert_eq!(
        import_in(&transport(), &domain).unwrap_err(),
        ["node 2 (move-bed): `location_1` is the place \"Ward\", which is not on the fleet's map; allowed: Dock, \
             Laboratory"]
    );
}

#[test]
fn a_node_with_wrong_fields_is_named() {
    let mut nodes = nodes();
    nodes["2"]["agents"] = serde_json::json!([{ "name": "r1" }]);
    nodes["3"]["colour"] = "red".into();
    nodes["4"].as_object_mut().unwrap().remove("type");
    let errors = import(&nodes).unwrap_err();
    assert_eq!(errors.len(), 3, "{errors:?}");
    assert_eq!(errors[0], "node 2 (navto): a list of texts, or a text");
    assert!(errors[1].starts_with("node 3 (operate_box-open): unknown field `colour`"), "{}", errors[1]);
    assert_eq!(errors[2], "node 4 (deposit): missing field `type`");
}

#[test]
fn a_name_with_a_hyphen_is_split_only_if_the_domain_lacks_it() {
    let own = with_names(domain()).with(TaskType::new("operate_box-open").unwrap(), TaskSchema::default());
    let mission = import_in(&nodes(), &own).unwrap();
    let (_, spec) = mission.elementary()[1];
    assert_eq!((spec.task_type.as_str(), spec.parameters.len()), ("operate_box-open", 0));
}

#[test]
fn a_document_is_recognised_as_a_flat_ihtn() {
    let parse = |text: &str, fields: &IhtnFields| MissionDocument::parse(text, Format::Json, fields.clone());
    let text = nodes().to_string();
    let people = IhtnFields { name: None, people: options().people };
    let document = parse(&text, &people).unwrap();
    assert_eq!(document.name().as_str(), "Fetch");
    let domain = with_names(domain());
    assert_eq!(document.instantiate(&BTreeMap::new(), &domain).unwrap().roles.len(), 2);
    let named = IhtnFields { name: Some(TaskId::new("fetch-7").unwrap()), ..people.clone() };
    assert_eq!(parse(&text, &named).unwrap().name().as_str(), "fetch-7");
    let room = BTreeMap::from([("room".to_owned(), "Ward".to_owned())]);
    let error = document.instantiate(&room, &domain).unwrap_err().to_string();
    assert!(error.contains("parameters/room: is given, but a mission in the flat iHTN form has no"), "{error}");
    let request = MissionDocument::request(&text, Format::Json, people.clone()).unwrap();
    assert_eq!(request, nodes());
    // A mission file has its own name and people.
    let file = crate::mission::test_data::FETCH_PARCEL;
    let error = MissionDocument::parse(file, Format::Yaml, people).unwrap_err().to_string();
    assert!(error.starts_with("`people` belongs to a mission in the flat iHTN form"), "{error}");
    let error = parse("{}", &IhtnFields::default()).unwrap_err().to_string();
    assert!(error.contains("missing field `mission`"), "{error}");
}

#[test]
fn an_ihtn_that_is_too_large_is_rejected() {
    let many: serde_json::Map<String, Value> = (0..=2 * TASKS_MAX)
        .map(|id| (id.to_string(), serde_json::json!({ "name": "n", "type": "task", "parent": "-1" })))
        .collect();
    let error = import(&Value::Object(many)).unwrap_err();
    assert_eq!(error, ["file: 1025 tasks; at most 1024 are allowed"]);
    let mut long = nodes();
    long["2"]["name"] = "n".repeat(FILE_BYTES_MAX).into();
    let error = import(&long).unwrap_err();
    assert!(error[0].contains(&format!("at most {FILE_BYTES_MAX} are allowed")), "{error:?}");
}

#[test]
fn undeclared_actions_are_found_with_their_use() {
    let mut nodes = transport();
    nodes["1"]["children"] = ["2", "3", "4", "5"].into();
    nodes["4"] = serde_json::json!({ "name": "sign-off", "type": "action", "parent": "1", "locations": "Ward", "agents": ["ann"] });
    // `navto` does not fit the navigation: it has no location.
    nodes["5"] = serde_json::json!({ "name": "navto", "type": "action", "parent": "1", "agents": ["r1"] });
    let names = IhtnNames { objects: ["trolley".to_owned()].into(), ..IhtnNames::default() };
    let domain = with_names(domain()).with_ihtn_names(names);
    let found = undeclared_actions(&nodes.to_string(), &options(), &domain).unwrap();
    let found_use = |locations, objects, roles| ActionUse { locations, objects, roles };
    assert_eq!(
        found.actions,
        BTreeMap::from([
            ("move-bed".to_owned(), found_use(2..=2, 1..=1, 2)),
            ("navto".to_owned(), found_use(0..=0, 0..=0, 1)),
            ("sign-off".to_owned(), found_use(0..=1, 0..=0, 1)),
        ])
    );
    assert_eq!(found.locations, ["Ward", "Bay 4"]);
    // With a task type of this schema, each use of a name is valid.
    let navto =
        IhtnNames { actions: [("navto".to_owned(), TaskType::new("navto").unwrap())].into(), ..IhtnNames::default() };
    let scaffolded = found.actions.iter().fold(domain.with_ihtn_names(navto), |domain, (name, used)| {
        domain.with(TaskType::new(&**name).unwrap(), used.schema())
    });
    assert!(undeclared_actions(&nodes.to_string(), &options(), &scaffolded).unwrap().actions.is_empty());
    let declared = undeclared_actions(&transport().to_string(), &options(), &transport_domain()).unwrap();
    assert_eq!(declared.actions, BTreeMap::new());
}
