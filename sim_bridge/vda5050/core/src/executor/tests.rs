use super::*;
use crate::cause::CauseTable;
use crate::identity::{Topic, Vehicle};
use crate::incoming::read_state;
use crate::layout::{Layout, LayoutNode};
use crate::machine::{Command, Event, GoalStatus, MachineSettings, OrderMachine, Work};
use crate::outgoing::{BlockingType, instant_actions};
use crate::received::{read_instant_actions, read_order};
use crate::schema::{check, schema};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

fn condition(x_m: f64) -> RobotCondition {
    let position = Position { x_m, y_m: 0.0, yaw_rad: 0.0, map: "m".to_owned() };
    RobotCondition { position, charge: 0.5, is_charging: false }
}

fn executor(version: Version) -> OrderExecutor {
    let settings = ExecutorSettings {
        version,
        map: "m".to_owned(),
        series: "simulated".to_owned(),
        actions: BTreeSet::from(["pick".to_owned(), "startCharging".to_owned()]),
        speed_max_mps: 1.0,
        radius_m: 0.25,
    };
    OrderExecutor::new(settings, condition(0.0), Some("a".to_owned()))
}

/// Returns an order over nodes, each 5 m after the one before; the numbers begin with that of the first.
fn order(id: &str, update: u64, first: u64, nodes: &[(&str, bool)]) -> ExecutorEvent {
    let numbered = || nodes.iter().zip((first..).step_by(2));
    let node = |((id, released), sequence): (&(&str, bool), u64)| ReceivedNode {
        id: (*id).to_owned(),
        sequence,
        released: *released,
        at_m: Some((sequence as f64 * 2.5, 0.0)),
        map: Some("m".to_owned()),
        yaw_rad: None,
        deviation_m: 0.0,
        actions: vec![],
    };
    let edge = |((id, released), sequence): (&(&str, bool), u64)| ReceivedEdge {
        id: format!("to_{id}"),
        sequence: sequence - 1,
        released: *released,
        speed_max_mps: None,
        has_actions: false,
    };
    let (nodes, edges) = (numbered().map(node).collect(), numbered().skip(1).map(edge).collect());
    ExecutorEvent::Order(ReceivedOrder { id: id.to_owned(), update, nodes, edges })
}

/// Changes an order before it is sent.
fn changed(event: ExecutorEvent, change: impl FnOnce(&mut ReceivedOrder)) -> ExecutorEvent {
    match event {
        ExecutorEvent::Order(mut order) => {
            change(&mut order);
            ExecutorEvent::Order(order)
        }
        other => other,
    }
}

fn action(id: &str, kind: &str) -> VehicleAction {
    let (id, kind) = (id.to_owned(), kind.to_owned());
    VehicleAction { id, kind, blocking: BlockingType::Hard, parameters: BTreeMap::new() }
}

fn instant(id: &str, kind: &str) -> ExecutorEvent {
    ExecutorEvent::InstantActions(vec![action(id, kind)])
}

fn done() -> ExecutorEvent {
    ExecutorEvent::Ended(ActivityEnd::Done(String::new()))
}

fn target(commands: &[ExecutorCommand]) -> Option<&str> {
    commands.iter().find_map(|command| match command {
        ExecutorCommand::Drive(node, _) => Some(node.id.as_str()),
        _ => None,
    })
}

fn status(executor: &OrderExecutor, id: &str) -> Option<ActionStatus> {
    let mut known = executor.instants.iter().chain(&executor.progress.actions);
    known.find(|action| action.id == id).map(|action| action.status)
}

fn kinds(executor: &OrderExecutor) -> Vec<&str> {
    executor.errors.iter().map(|error| error.kind.as_str()).collect()
}

#[test]
fn a_base_is_driven_and_an_update_continues_it() {
    let mut executor = executor(Version::V2_1);
    let began = executor.step(order("o", 0, 0, &[("a", true), ("b", true), ("c", false)]));
    assert_eq!((target(&began), began.last()), (Some("b"), Some(&ExecutorCommand::PublishState)));
    let reached = executor.step(done());
    assert_eq!(target(&reached), None, "the horizon is not driven");
    let state = executor.state();
    assert_eq!((&state["lastNodeId"], &state["lastNodeSequenceId"]), (&json!("b"), &json!(2)));
    assert_eq!(state["nodeStates"], json!([{ "nodeId": "c", "sequenceId": 4, "released": false }]));
    // The update replaces the horizon.
    let update = order("o", 1, 2, &[("b", true), ("d", true)]);
    assert_eq!(target(&executor.step(update.clone())), Some("d"));
    assert_eq!(executor.step(update), [], "a repeated update changes nothing");
    executor.step(done());
    assert!(executor.progress.is_idle());
    assert_eq!(executor.state()["orderUpdateId"], json!(1));
}

#[test]
fn orders_that_do_not_fit_are_rejected_by_the_names_of_the_version() {
    let under_way = || order("o", 1, 0, &[("a", true), ("b", true)]);
    let next = || order("p", 0, 0, &[("a", true), ("b", true)]);
    let cases = [
        (order("o", 0, 0, &[("a", true), ("b", true)]), "orderUpdateError", "OUTDATED_ORDER_UPDATE"),
        (order("o", 2, 0, &[("a", true), ("b", true)]), "orderUpdateError", "VALIDATION_FAILURE"),
        (next(), "orderError", "OTHER_ORDER_ACTIVE"),
        (changed(next(), |order| order.nodes.clear()), "validationError", "VALIDATION_FAILURE"),
    ];
    for (event, old, new) in cases {
        for (version, kind) in [(Version::V2_0, old), (Version::V3_0, new)] {
            let mut executor = executor(version);
            let began = changed(under_way(), |order| order.update = 0);
            executor.step(began);
            executor.progress.update = 1;
            let commands = executor.step(event.clone());
            assert_eq!((target(&commands), kinds(&executor)), (None, vec![kind]), "{version} {event:?}");
            assert_eq!((executor.progress.id.as_str(), executor.progress.update), ("o", 1));
        }
    }
    let cases = [
        (changed(next(), |order| order.nodes[0].at_m = Some((9.0, 0.0))), "START_NODE_OUT_OF_RANGE"),
        (changed(next(), |order| order.nodes[1].map = Some("n".to_owned())), "UNKNOWN_MAP_ID"),
        (changed(next(), |order| order.nodes[1].actions.push(action("x", "sing"))), "INVALID_ORDER_ACTION"),
        (changed(next(), |order| order.edges[0].has_actions = true), "INVALID_ORDER_ACTION"),
        (order("p", 3, 0, &[("a", true)]), "VALIDATION_FAILURE"),
        (ExecutorEvent::Refused("no JSON".to_owned()), "VALIDATION_FAILURE"),
    ];
    for (event, kind) in cases {
        let mut executor = executor(Version::V3_0);
        assert_eq!(target(&executor.step(event)), None);
        assert_eq!((kinds(&executor), executor.progress.id.as_str()), (vec![kind], ""));
        // The warning ends with the next order.
        executor.step(next());
        assert_eq!(kinds(&executor), Vec::<&str>::new());
    }
    // A first node with a wide allowed deviation is reached from afar.
    let wide = changed(next(), |order| (order.nodes[0].at_m, order.nodes[0].deviation_m) = (Some((9.0, 0.0)), 10.0));
    assert_eq!(target(&executor(Version::V3_0).step(wide)), Some("b"));
}

#[test]
fn another_order_with_the_same_update_is_ignored_with_a_warning_in_3_0() {
    for (version, kind) in [(Version::V2_1, None), (Version::V3_0, Some("SAME_ORDER_UPDATE_ID"))] {
        let mut executor = executor(version);
        executor.step(order("o", 0, 0, &[("a", true), ("b", true)]));
        assert_eq!(executor.step(order("o", 0, 0, &[("a", true), ("b", true)])), [], "the same order");
        let commands = executor.step(order("o", 0, 0, &[("a", true), ("c", true)]));
        assert_eq!((target(&commands), kinds(&executor)), (None, Vec::from_iter(kind)), "{version}");
        assert_eq!(executor.state()["nodeStates"][0]["nodeId"], json!("b"));
    }
}

#[test]
fn a_heading_is_reported_within_half_a_turn() {
    let mut executor = executor(Version::V3_0);
    let position = Position { yaw_rad: 4.0, ..condition(0.0).position };
    executor.step(ExecutorEvent::Condition(RobotCondition { position, ..condition(0.0) }));
    let theta = executor.state()["mobileRobotPosition"]["theta"].as_f64().unwrap();
    assert!((theta - (4.0 - std::f64::consts::TAU)).abs() < 1e-9, "{theta}");
}

#[test]
fn a_cancel_stops_the_robot_and_ends_the_order() {
    let mut executor = executor(Version::V3_0);
    assert_eq!(executor.step(instant("early", "cancelOrder")), [ExecutorCommand::PublishState]);
    assert_eq!(
        (status(&executor, "early"), kinds(&executor)),
        (Some(ActionStatus::Failed), vec!["NO_ORDER_TO_CANCEL"])
    );
    let with_action = |order: &mut ReceivedOrder| order.nodes[1].actions.push(action("x", "pick"));
    executor.step(changed(order("o", 0, 0, &[("a", true), ("b", true)]), with_action));
    let stop = executor.step(instant("now", "cancelOrder"));
    assert_eq!(stop, [ExecutorCommand::Stop, ExecutorCommand::PublishState]);
    assert_eq!(status(&executor, "now"), Some(ActionStatus::Running));
    executor.step(ExecutorEvent::Ended(ActivityEnd::Stopped));
    let statuses = (status(&executor, "now"), status(&executor, "x"));
    assert_eq!(statuses, (Some(ActionStatus::Finished), Some(ActionStatus::Failed)));
    let state = executor.state();
    assert_eq!((&state["orderId"], &state["nodeStates"], &state["driving"]), (&json!("o"), &json!([]), &json!(false)));
    // A cancelled order has no updates.
    executor.step(order("o", 1, 2, &[("b", true), ("c", true)]));
    assert_eq!(kinds(&executor), ["ORDER_UPDATE_FOLLOWING_CANCEL"]);
}

#[test]
fn a_repeated_cancel_ends_with_the_first() {
    let mut executor = executor(Version::V2_0);
    executor.step(order("o", 0, 0, &[("a", true), ("b", true)]));
    executor.step(instant("first", "cancelOrder"));
    let again = executor.step(instant("again", "cancelOrder"));
    assert_eq!(again, [ExecutorCommand::PublishState], "the robot is stopping");
    let both = |executor: &OrderExecutor| ["first", "again"].map(|id| status(executor, id));
    assert_eq!(both(&executor), [Some(ActionStatus::Running); 2]);
    executor.step(ExecutorEvent::Ended(ActivityEnd::Stopped));
    assert_eq!((both(&executor), kinds(&executor)), ([Some(ActionStatus::Finished); 2], vec![]));
}

#[test]
fn actions_of_a_node_are_executed_one_by_one_and_a_failure_stops_the_order() {
    let mut executor = executor(Version::V2_0);
    let with_actions =
        |order: &mut ReceivedOrder| order.nodes[0].actions = vec![action("x", "pick"), action("y", "pick")];
    let began = executor.step(changed(order("o", 0, 0, &[("a", true), ("b", true)]), with_actions));
    assert_eq!(began[0], ExecutorCommand::Act(action("x", "pick")));
    let next = executor.step(ExecutorEvent::Ended(ActivityEnd::Done("L-7".to_owned())));
    assert_eq!(next[0], ExecutorCommand::Act(action("y", "pick")));
    assert_eq!(executor.state()["actionStates"][0]["resultDescription"], json!("L-7"));
    let failed = executor.step(ExecutorEvent::Ended(ActivityEnd::Failed("empty".to_owned())));
    assert_eq!(failed, [ExecutorCommand::PublishState], "the robot does not drive on");
    assert_eq!(executor.state()["errors"][0]["errorLevel"], json!("FATAL"));
    executor.step(instant("i", "cancelOrder"));
    assert_eq!((status(&executor, "i"), kinds(&executor)), (Some(ActionStatus::Finished), vec![]));
    assert_eq!(target(&executor.step(order("p", 0, 0, &[("a", true), ("b", true)]))), Some("b"));
}

#[test]
fn a_pause_stops_the_drive_and_its_end_continues_it() {
    let mut executor = executor(Version::V2_1);
    executor.step(order("o", 0, 0, &[("a", true), ("b", true)]));
    assert_eq!(executor.step(instant("p", "startPause"))[0], ExecutorCommand::Stop);
    executor.step(ExecutorEvent::Ended(ActivityEnd::Stopped));
    assert_eq!((status(&executor, "p"), executor.state()["paused"] == true), (Some(ActionStatus::Finished), true));
    assert_eq!(target(&executor.step(instant("q", "stopPause"))), Some("b"));
    // An instant action of the robot waits for nothing: it fails while the robot drives.
    executor.step(instant("c", "startCharging"));
    assert_eq!((status(&executor, "c"), kinds(&executor)), (Some(ActionStatus::Failed), vec!["instantActionError"]));
    executor.step(done());
    assert_eq!(executor.step(instant("d", "startCharging"))[0], ExecutorCommand::Act(action("d", "startCharging")));
    assert_eq!(executor.step(instant("d", "startCharging")), [], "a repeated action changes nothing");
    assert_eq!(executor.step(instant("f", "factsheetRequest"))[0], ExecutorCommand::PublishFactsheet);
}

#[test]
fn both_sides_understand_each_other_in_every_version() {
    let nodes = [("a", 0.0), ("b", 5.0), ("c", 10.0)];
    let node = |(id, x_m): (&str, f64)| (id.to_owned(), LayoutNode { x_m, y_m: 0.0, yaw_rad: None });
    let edges = [["a", "b"], ["b", "c"]].map(|edge| edge.map(str::to_owned));
    let layout = Layout::new(nodes.map(node).into_iter().collect(), &edges).unwrap();
    let drive = |to: &str| Work::Drive { to: to.to_owned(), speed_max_mps: Some(0.5) };
    let act = |kind: &str, is_instant| Work::Act {
        kind: kind.to_owned(),
        blocking: BlockingType::Hard,
        parameters: BTreeMap::from([("loadId".to_owned(), json!("L-7"))]),
        is_instant,
    };
    for version in Version::ALL {
        let vehicle = Vehicle::new("uagv", version, "ACME", "7").unwrap();
        let message = |number: u32, body| vehicle.message(number, &format!("2026-01-01T00:00:{number:02}.000Z"), body);
        let mut control = OrderMachine::new(MachineSettings {
            layout: layout.clone(),
            map: "m".to_owned(),
            release_ahead: 1,
            causes: CauseTable::default(),
            retry_after: Duration::from_secs(2),
            ready_within: Duration::from_secs(10),
            silence_max: Duration::from_secs(30),
            adopt_within: Duration::from_secs(3),
            session: 1,
        });
        let mut executor = executor(version);
        let mut works = VecDeque::from([drive("c"), act("pick", false), act("startCharging", true), drive("a")]);
        let mut inbox = control.step(Event::Broker { is_up: true }, Duration::ZERO);
        let (mut results, mut goal): (Vec<GoalStatus>, Option<u64>) = (vec![], None);
        for time in 1..60_u32 {
            let now = Duration::from_secs(u64::from(time));
            if goal.is_none()
                && let Some(work) = works.pop_front()
            {
                let id = u64::from(time);
                goal = Some(id);
                let keep_for = Duration::from_secs(100);
                let event = Event::Goal { id, fingerprint: 1, work, keep_for, since: None };
                inbox.extend(control.step(event, now));
            }
            let mut commands = vec![];
            for command in mem::take(&mut inbox) {
                match command {
                    Command::SendOrder(order) => {
                        let order = message(time, order.to_json(version)).to_string();
                        let order = read_order(&vehicle, order.as_bytes()).unwrap();
                        commands.extend(executor.step(ExecutorEvent::Order(order)));
                    }
                    Command::SendInstant(action) => {
                        let actions = message(time, instant_actions(&[action], version)).to_string();
                        let actions = read_instant_actions(&vehicle, actions.as_bytes()).unwrap();
                        commands.extend(executor.step(ExecutorEvent::InstantActions(actions)));
                    }
                    Command::Result { status, .. } => {
                        results.push(status);
                        goal = None;
                    }
                    Command::Feedback { .. } => {}
                }
            }
            for command in commands {
                match command {
                    ExecutorCommand::Drive(node, speed_max_mps) => {
                        assert_eq!(speed_max_mps, Some(0.5));
                        executor.step(ExecutorEvent::Condition(condition(node.at_m.unwrap().0)));
                        executor.step(done());
                    }
                    ExecutorCommand::Act(action) => {
                        assert_eq!(action.parameters["loadId"], json!("L-7"));
                        executor.step(ExecutorEvent::Ended(ActivityEnd::Done("L-7".to_owned())));
                    }
                    ExecutorCommand::Stop | ExecutorCommand::PublishState => {}
                    ExecutorCommand::PublishFactsheet => {
                        let sheet = message(time, executor.factsheet());
                        assert_eq!(check(&schema(Topic::Factsheet, version), &sheet), Ok(()));
                    }
                }
            }
            let state = read_state(&vehicle, message(time, executor.state()).to_string().as_bytes()).unwrap();
            inbox.extend(control.step(Event::State(Box::new(state)), now));
        }
        let done = |result: &str| GoalStatus::Succeeded(result.to_owned());
        assert_eq!(results, [done(""), done("L-7"), done("L-7"), done("")], "{version}");
    }
}
