use super::*;
use crate::mission::RoleKind;
use crate::mission::test_data::domain;

fn options() -> IhtnOptions {
    IhtnOptions {
        name: TaskId::new("trial").unwrap(),
        unmanaged: [RoleId::new("ann").unwrap()].into(),
        aliases: [("navto".to_owned(), TaskType::new("navigation").unwrap())].into(),
        reaching: [TaskType::new("navigation").unwrap()].into(),
    }
}

/// A fetch by r1, to which Ann adds an item.
fn nodes() -> serde_json::Value {
    serde_json::json!({
        "0": { "name": "Fetch", "type": "task", "parent": "-1", "agents": ["r1", "ann", "idler"], "children": ["1"] },
        "1": { "name": "m", "type": "method", "parent": "0", "agents": ["r1", "ann"], "children": ["2", "3", "4", "5"] },
        "2": { "name": "navto", "type": "action", "parent": "1", "locations": ["Ward"], "agents": ["r1"], "children": "" },
        "3": { "name": "operate_drawer-open", "type": "action", "parent": "1", "locations": "", "agents": ["r1"], "children": "" },
        "4": { "name": "deposit", "type": "action", "parent": "1", "locations": "", "agents": ["ann"], "children": "" },
        "5": { "name": "navto", "type": "action", "parent": "1", "locations": ["Laboratory"], "agents": ["r1"], "children": "" },
    })
}

fn import(nodes: &serde_json::Value) -> Result<Mission, Vec<String>> {
    import_ihtn(&nodes.to_string(), &options(), &domain())
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
            r#"operate_drawer-open operate_drawer {"action": "open"} {}"#,
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
    type Change<'c> = &'c dyn Fn(&mut serde_json::Value);
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
            &|n| n["3"]["name"] = "operate_drawer-slam".into(),
            &[
                "node 3 (operate_drawer-slam): unknown task type `operate_drawer-slam`; allowed: approach, deposit, navigation, operate_drawer, pick_up, wait; did you mean `operate_drawer`?",
            ],
        ),
        (
            &|n| n["3"]["locations"] = "Ward".into(),
            &["node 3 (operate_drawer-open): has the location \"Ward\", but `operate_drawer` has no parameter for \
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
    let error = import_ihtn(&text, &options(), &domain()).unwrap_err().to_string();
    assert!(error.contains("the key `0` occurs twice"), "{error}");
}

#[test]
fn only_agents_with_actions_may_be_unmanaged() {
    let mut options = options();
    options.unmanaged = [RoleId::new("an").unwrap()].into();
    let error = import_ihtn(&nodes().to_string(), &options, &domain()).unwrap_err().to_string();
    assert!(error.contains("roles/an: is listed as unmanaged") && error.contains("did you mean `ann`?"), "{error}");
}
