use super::*;
use crate::ids::{ItemId, RoleId, TaskId, TaskType};
use crate::mission::TaskSchema;
use crate::mission::limits::DEPTH_MAX;
use crate::mission::model::{Method, Role, RoleKind, TaskBody, TaskNode, TaskOrder};
use crate::mission::test_data::domain;

fn role(name: &str) -> RoleId {
    RoleId::new(name).unwrap()
}

fn elementary(id: &str, task_type: &str, roles: &[&str], parameters: &[(&str, &str)]) -> TaskNode {
    let spec = TaskSpec {
        parameters: parameters.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect(),
        ..TaskSpec::of(TaskType::new(task_type).unwrap(), roles.iter().map(|name| role(name)).collect())
    };
    TaskNode { id: TaskId::new(id).unwrap(), body: TaskBody::Elementary(spec) }
}

fn refined(id: &str, children: &[u32]) -> TaskNode {
    let method = Method::of(TaskOrder::Sequential, children.to_vec());
    TaskNode { id: TaskId::new(id).unwrap(), body: TaskBody::Abstract(method) }
}

fn mission(roles: &[(&str, RoleKind)], tasks: Vec<TaskNode>) -> Mission {
    Mission {
        name: TaskId::new("trial").unwrap(),
        roles: roles.iter().map(|(name, kind)| (role(name), Role::of(*kind))).collect(),
        ensembles: vec![],
        energy_max: None,
        tasks,
        results: Default::default(),
    }
}

const R1: &[(&str, RoleKind)] = &[("r1", RoleKind::Managed)];

fn diagnostics(mission: &Mission) -> Vec<String> {
    match mission.check(&domain()) {
        Ok(()) => vec![],
        Err(errors) => errors.diagnostics.iter().map(ToString::to_string).collect(),
    }
}

#[test]
fn a_valid_mission_passes() {
    let tasks = vec![refined("top", &[1]), elementary("go", "navigation", &["r1"], &[("to", "Laboratory")])];
    assert_eq!(diagnostics(&mission(R1, tasks)), Vec::<String>::new());
}

#[test]
fn robots_move_items_only_in_tasks_that_hand_over() {
    /// What the domain knows of `wait`. Nothing is known of the other types.
    fn with(hands_over: Option<bool>) -> Domain {
        let (domain, wait) = (domain(), TaskType::new("wait").unwrap());
        let schema = TaskSchema { hands_over, ..domain.get(&wait).unwrap().clone() };
        domain.with(wait, schema)
    }
    let wait = |id: &str, by: &str, releases: bool, acquires: bool| {
        let mut node = elementary(id, "wait", &[by], &[("seconds", "1")]);
        if let TaskBody::Elementary(spec) = &mut node.body {
            spec.releases.extend(releases.then(|| ItemId::new("parcel").unwrap()));
            spec.acquires.extend(acquires.then(|| (ItemId::new("parcel").unwrap(), role("r1"))));
        }
        node
    };
    let wrong = "root/stay: moves the item `parcel`, but no action of `wait` hands items over: it needs \
                 `hands_over: true`; allowed: approach, deposit, navigation, operate_box, pick_up";
    for (releases, acquires) in [(true, false), (false, true)] {
        let moving = mission(R1, vec![refined("top", &[1]), wait("stay", "r1", releases, acquires)]);
        let errors = moving.check(&with(Some(false))).unwrap_err();
        assert_eq!(errors.diagnostics.iter().map(ToString::to_string).collect::<Vec<_>>(), [wrong]);
        for known in [None, Some(true)] {
            assert_eq!(moving.check(&with(known)), Ok(()));
        }
    }
    let still = mission(R1, vec![refined("top", &[1]), wait("stay", "r1", false, false)]);
    assert_eq!(still.check(&with(Some(false))), Ok(()), "it moves nothing");
    let roles = &[("r1", RoleKind::Managed), ("clerk", RoleKind::Unmanaged)];
    let tasks = vec![refined("top", &[1, 2]), wait("come", "r1", false, false), wait("give", "clerk", false, true)];
    assert_eq!(mission(roles, tasks).check(&with(Some(false))), Ok(()), "a person may hand it over");
}

#[test]
fn every_problem_is_reported_with_its_path_and_allowed_names() {
    let tasks = vec![
        refined("top", &[1, 2, 3]),
        elementary("go", "navigatoin", &["r1"], &[]),
        elementary("fetch", "pick_up", &["r1", "r9", "r1"], &[("from_role", "cler"), ("colour", "red")]),
        refined("more", &[4]),
        elementary("shut", "operate_box", &["r1"], &[("action", "slam")]),
    ];
    let roles = &[("r1", RoleKind::Managed), ("clerk", RoleKind::Unmanaged)];
    assert_eq!(
        diagnostics(&mission(roles, tasks)),
        [
            "root/fetch: unknown role `r9`; allowed: clerk, r1; did you mean `r1`?",
            "root/fetch: names the role `r1` twice",
            "roles/clerk: has no task; add a task for it or remove it",
            "root/go: unknown task type `navigatoin`; allowed: approach, deposit, navigation, operate_box, pick_up, wait; did you mean `navigation`?",
            "root/fetch: `pick_up` has no parameter `colour`; allowed: from_role, item",
            "root/fetch: parameter `from_role` names the role `cler`, which is not declared in the mission; allowed: \
             clerk, r1; did you mean `clerk`?",
            "root/more/shut: parameter `action` is \"slam\"; it must be one of close, open",
        ]
    );
}

#[test]
fn a_missing_parameter_is_named() {
    let tasks = vec![elementary("go", "navigation", &["r1"], &[])];
    assert_eq!(diagnostics(&mission(R1, tasks)), ["root: `navigation` needs the parameter `to`: a place"]);
}

#[test]
fn a_malformed_tree_is_rejected() {
    let go = |id| elementary(id, "wait", &["r1"], &[("seconds", "1")]);
    let cases = [
        (vec![], vec!["root: the mission has no task; the first task is the root"]),
        (
            vec![refined("top", &[1, 7]), go("a")],
            vec!["root: is refined into task number 7, but the mission has 2 tasks, counted from 0"],
        ),
        (
            vec![refined("top", &[1, 2]), refined("loop", &[0]), go("a")],
            vec!["root/loop: is refined into `top`, which is not listed after it: a cycle, or tasks out of order"],
        ),
        (
            vec![refined("top", &[1, 2]), refined("x", &[2]), go("a")],
            vec!["root/x: is refined into `a`, which already belongs to root; a task has one parent"],
        ),
        (
            vec![refined("top", &[1]), go("a"), go("b")],
            vec!["tasks[2] (b): belongs to no task; only the first task, the root, has no parent"],
        ),
        (
            vec![refined("top", &[1, 2]), refined("x", &[]), go("a")],
            vec!["root/x: its method has no tasks; a method needs at least 1 task"],
        ),
        (
            vec![refined("top", &[1, 2]), go("a"), go("a")],
            vec!["root/a: has the same name as root/a; task names must be unique in a mission"],
        ),
        (
            vec![refined("top", &[1]), elementary("a", "wait", &[], &[("seconds", "1")])],
            vec![
                "root/a: has no role; name at least 1 role, allowed: r1",
                "roles/r1: has no task; add a task for it or remove it",
            ],
        ),
    ];
    for (tasks, expected) in cases {
        assert_eq!(diagnostics(&mission(R1, tasks)), expected);
    }
}

#[test]
fn a_mission_without_managed_roles_is_rejected() {
    let tasks = vec![elementary("a", "wait", &["clerk"], &[("seconds", "1")])];
    let roles = &[("clerk", RoleKind::Unmanaged)];
    assert_eq!(
        diagnostics(&mission(roles, tasks)),
        ["roles: no role is managed; a mission needs at least 1 role that a robot fills"]
    );
}

#[test]
fn sizes_have_limits() {
    let many: Vec<u32> = (1..=TASKS_MAX as u32).collect();
    let mut tasks = vec![refined("top", &many)];
    tasks.extend(many.iter().map(|n| elementary(&format!("t{n}"), "wait", &["r1"], &[("seconds", "1")])));
    assert_eq!(diagnostics(&mission(R1, tasks.clone())), ["root: 513 tasks; at most 512 are allowed"]);
    tasks.pop();
    tasks[0] = refined("top", &many[..TASKS_MAX - 1]);
    assert_eq!(diagnostics(&mission(R1, tasks)), Vec::<String>::new());

    let mut chain: Vec<TaskNode> = (0..DEPTH_MAX as u32).map(|n| refined(&format!("d{n}"), &[n + 1])).collect();
    chain.push(elementary("end", "wait", &["r1"], &[("seconds", "1")]));
    let found = diagnostics(&mission(R1, chain));
    assert_eq!(found.len(), 1);
    assert!(found[0].ends_with("is 33 levels deep; at most 32 are allowed"), "{found:?}");
}
