use super::*;
use crate::cause::CauseTable;
use crate::incoming::{ActionReport, ActionStatus, ConnectionState, Position, RemainingNode};
use crate::layout::{Layout, LayoutNode};
use crate::order_id::fingerprint;
use crate::outgoing::{Order, OrderNode};

/// A vehicle that executes orders as the standard prescribes.
#[derive(Debug, Default)]
struct FakeVehicle {
    header_id: u64,
    seconds: u64,
    order: String,
    update: u64,
    at: Option<(String, u64)>,
    ahead: Vec<OrderNode>,
    actions: Vec<ActionReport>,
    errors: Vec<VehicleError>,
    /// Number of instant actions that a vehicle of version 3.0 remembers.
    instants: usize,
    /// Ids of actions in the order of their executions.
    executed: Vec<String>,
}

impl FakeVehicle {
    fn at(node: &str) -> FakeVehicle {
        FakeVehicle { at: Some((node.to_owned(), 0)), ..FakeVehicle::default() }
    }

    fn receive(&mut self, command: &Command) {
        match command {
            Command::SendOrder(order) if order.id == self.order && order.update <= self.update => {}
            Command::SendOrder(order) => {
                if order.id != self.order {
                    (self.ahead, self.actions) = (vec![], vec![]);
                }
                (self.order, self.update) = (order.id.clone(), order.update);
                let done = if order.update == 0 { None } else { self.at.as_ref().map(|(_, sequence)| *sequence) };
                self.ahead.retain(|node| node.released);
                for node in &order.nodes {
                    let is_known = self.ahead.iter().any(|known| known.sequence == node.sequence);
                    if !is_known && done.is_none_or(|done| node.sequence > done) {
                        self.ahead.push(node.clone());
                    }
                }
                for action in order.nodes.iter().flat_map(|node| &node.actions) {
                    self.report(&action.id, ActionStatus::Waiting);
                }
                if order.update == 0 {
                    self.step();
                }
            }
            Command::SendInstant(action) => {
                if action.kind == "cancelOrder" {
                    self.ahead.clear();
                    self.actions
                        .iter_mut()
                        .filter(|own| !own.status.is_final())
                        .for_each(|own| own.status = ActionStatus::Failed);
                }
                self.executed.push(action.kind.clone());
                let goes_on = action.kind == "pick";
                self.report(&action.id, if goes_on { ActionStatus::Running } else { ActionStatus::Finished });
            }
            Command::Result { .. } | Command::Feedback { .. } => {}
        }
    }

    fn report(&mut self, id: &str, status: ActionStatus) {
        self.actions.retain(|action| action.id != id);
        self.actions.push(ActionReport { id: id.to_owned(), status, result: String::new() });
    }

    /// Drives to the next node of the base, and starts its actions.
    fn step(&mut self) {
        if self.ahead.first().is_some_and(|node| node.released) {
            let node = self.ahead.remove(0);
            self.at = Some((node.id, node.sequence));
            for action in node.actions {
                self.executed.push(action.id.clone());
                self.report(&action.id, ActionStatus::Running);
            }
        }
    }

    fn finish_actions(&mut self) {
        self.actions.iter_mut().for_each(|action| action.status = ActionStatus::Finished);
    }

    fn restart(&mut self) {
        let at = self.at.take().map(|(node, _)| (node, 0));
        *self = FakeVehicle { at, seconds: self.seconds, executed: self.executed.clone(), ..FakeVehicle::default() };
    }

    fn state(&mut self) -> VehicleState {
        self.header_id += 1;
        self.seconds += 1;
        let (last_node, last_sequence) = self.at.clone().unwrap_or_default();
        let layout = layout();
        let position = layout.node(&last_node).map(|node| Position {
            x_m: node.x_m,
            y_m: node.y_m,
            yaw_rad: 0.0,
            map: "m".to_owned(),
        });
        VehicleState {
            header_id: self.header_id,
            timestamp: format!("2026-01-01T00:00:{:02}.000Z", self.seconds),
            order: self.order.clone(),
            update: self.update,
            last_node,
            last_sequence,
            nodes: self
                .ahead
                .iter()
                .map(|node| RemainingNode { id: node.id.clone(), sequence: node.sequence, released: node.released })
                .collect(),
            edges_left: self.ahead.len(),
            is_driving: !self.ahead.is_empty(),
            position,
            charge: 0.5,
            actions: self.actions.clone(),
            instant_actions: vec![ended_action(); self.instants],
            errors: self.errors.clone(),
            mode: "AUTOMATIC".to_owned(),
            is_stopped: false,
        }
    }
}

fn ended_action() -> ActionReport {
    ActionReport { id: "ended".to_owned(), status: ActionStatus::Finished, result: String::new() }
}

fn layout() -> Layout {
    let nodes = ["a", "b", "c", "d"].into_iter().enumerate();
    let nodes =
        nodes.map(|(index, id)| (id.to_owned(), LayoutNode { x_m: index as f64 * 5.0, y_m: 0.0, yaw_rad: None }));
    let edges = [["a", "b"], ["b", "c"], ["c", "d"]].map(|edge| edge.map(str::to_owned));
    Layout::new(nodes.collect(), &edges).unwrap()
}

fn machine(release_ahead: usize) -> OrderMachine {
    let mut machine = OrderMachine::new(MachineSettings {
        layout: layout(),
        map: "m".to_owned(),
        release_ahead,
        causes: CauseTable::default(),
        retry_after: Duration::from_secs(2),
        ready_within: Duration::from_secs(10),
        silence_max: Duration::from_secs(30),
        adopt_within: Duration::from_secs(3),
        session: 1,
    });
    machine.step(Event::Broker { is_up: true }, Duration::ZERO);
    machine
}

fn seconds(time: u64) -> Duration {
    Duration::from_secs(time)
}

fn drive(to: &str) -> Work {
    Work::Drive { to: to.to_owned(), speed_max_mps: None }
}

fn act(kind: &str, is_instant: bool) -> Work {
    Work::Act { kind: kind.to_owned(), blocking: BlockingType::Hard, parameters: BTreeMap::new(), is_instant }
}

fn pick(is_instant: bool) -> Work {
    act("pick", is_instant)
}

fn goal(id: u64, work: Work) -> Event {
    let fingerprint = fingerprint(&format!("{work:?}"));
    Event::Goal { id, fingerprint, work, keep_for: seconds(1_000), since: None }
}

/// Returns a goal that an earlier process has not ended.
fn resumed(id: u64, work: Work) -> Event {
    begun_since(id, id, work)
}

/// Returns a goal that an earlier process may have begun since a goal.
fn begun_since(first: u64, id: u64, work: Work) -> Event {
    match goal(id, work) {
        Event::Goal { id, fingerprint, work, keep_for, .. } => {
            Event::Goal { id, fingerprint, work, keep_for, since: Some(first) }
        }
        other => other,
    }
}

/// Returns the vehicle after goals of an earlier process, which have ended.
fn after_goals(goals: &[(u64, Work)]) -> FakeVehicle {
    let (mut killed, mut vehicle) = (machine(3), FakeVehicle::at("a"));
    exchange(&mut killed, &mut vehicle, 1);
    for (time, (id, work)) in (2..).step_by(4).zip(goals) {
        let sent = killed.step(goal(*id, work.clone()), seconds(time));
        sent.iter().for_each(|command| vehicle.receive(command));
        (0..3).for_each(|_| vehicle.step());
        vehicle.finish_actions();
        let ended = [1, 2].map(|later| exchange(&mut killed, &mut vehicle, time + later)).concat();
        assert!(matches!(result(&ended), Some(GoalStatus::Succeeded(_))), "goal {id}: {ended:?}");
    }
    vehicle
}

/// Number of actions that the vehicle has begun for goals.
fn acted(vehicle: &FakeVehicle) -> usize {
    vehicle.executed.iter().filter(|action| action.starts_with("consort-") || *action == "pick").count()
}

/// Steps a machine with an event, and passes its commands to the vehicle.
fn send(machine: &mut OrderMachine, vehicle: &mut FakeVehicle, event: Event, time: u64) -> Vec<Command> {
    let commands = machine.step(event, seconds(time));
    commands.iter().for_each(|command| vehicle.receive(command));
    commands
}

/// Id of the first goal of the node's next process.
const NEXT: u64 = 1 << 20;

fn orders(commands: &[Command]) -> Vec<Order> {
    let order = |command: &Command| match command {
        Command::SendOrder(order) => Some(order.clone()),
        _ => None,
    };
    commands.iter().filter_map(order).collect()
}

fn cancels(commands: &[Command]) -> usize {
    commands
        .iter()
        .filter(|command| matches!(command, Command::SendInstant(action) if action.kind == "cancelOrder"))
        .count()
}

fn result(commands: &[Command]) -> Option<GoalStatus> {
    commands.iter().find_map(|command| match command {
        Command::Result { status, .. } => Some(status.clone()),
        _ => None,
    })
}

/// Passes a state to the machine, and its commands to the vehicle.
fn exchange(machine: &mut OrderMachine, vehicle: &mut FakeVehicle, time: u64) -> Vec<Command> {
    let commands = machine.step(Event::State(Box::new(vehicle.state())), seconds(time));
    commands.iter().for_each(|command| vehicle.receive(command));
    commands
}

#[test]
fn a_drive_is_released_node_by_node_and_stitched() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    let first = orders(&sent).remove(0);
    let nodes =
        |order: &Order| Vec::from_iter(order.nodes.iter().map(|node| (node.id.clone(), node.sequence, node.released)));
    let node = |id: &str, sequence, released| (id.to_owned(), sequence, released);
    assert_eq!(nodes(&first), [node("a", 0, true), node("b", 2, true), node("c", 4, false), node("d", 6, false)]);
    assert_eq!(
        Vec::from_iter(first.edges.iter().map(|edge| (edge.sequence, edge.released))),
        [(1, true), (3, false), (5, false)]
    );
    vehicle.receive(&sent[0]);
    vehicle.step();
    let update = orders(&exchange(&mut machine, &mut vehicle, 3)).remove(0);
    assert_eq!((update.id.as_str(), update.update), (first.id.as_str(), 1));
    assert_eq!(nodes(&update), [node("b", 2, true), node("c", 4, true), node("d", 6, false)]);
    vehicle.step();
    assert_eq!(orders(&exchange(&mut machine, &mut vehicle, 4))[0].update, 2);
    vehicle.step();
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Succeeded(String::new())));
    // A repeated goal repeats the result and starts nothing.
    let repeated = machine.step(goal(7, drive("d")), seconds(6));
    assert_eq!((repeated.len(), result(&repeated)), (1, Some(GoalStatus::Succeeded(String::new()))));
}

#[test]
fn a_lost_order_is_sent_again_and_executed_once() {
    for is_instant in [false, true] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let lost = machine.step(goal(7, pick(is_instant)), seconds(2));
        let again = exchange(&mut machine, &mut vehicle, 5);
        assert_eq!(lost[0], again[0], "the same ids");
        // The first message arrives late.
        if !is_instant {
            vehicle.receive(&lost[0]);
        }
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 6)), Some(GoalStatus::Succeeded(_))));
        assert_eq!(vehicle.executed.len(), 1, "{:?}", vehicle.executed);
    }
}

#[test]
fn an_unanswered_order_is_not_repeated_before_a_younger_state() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(goal(7, pick(true)), seconds(2));
    let commands = machine.step(Event::Tick, seconds(20));
    let kinds = commands.iter().filter_map(|command| match command {
        Command::SendInstant(action) => Some(action.kind.as_str()),
        _ => None,
    });
    assert_eq!(Vec::from_iter(kinds), ["stateRequest"], "the action may be under way");
}

#[test]
fn late_and_repeated_states_change_nothing() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    let late = vehicle.state();
    let sent = {
        exchange(&mut machine, &mut vehicle, 1);
        machine.step(goal(7, drive("b")), seconds(2))
    };
    vehicle.receive(&sent[0]);
    let state = vehicle.state();
    machine.step(Event::State(Box::new(state.clone())), seconds(3));
    for stale in [late, state] {
        let commands = machine.step(Event::State(Box::new(stale)), seconds(9));
        assert_eq!((orders(&commands), cancels(&commands)), (vec![], 0), "the order goes on");
    }
    vehicle.step();
    assert!(result(&exchange(&mut machine, &mut vehicle, 10)).is_some());
}

#[test]
fn a_new_process_continues_an_action_without_repeating_it() {
    for is_instant in [false, true] {
        let mut vehicle = FakeVehicle::at("a");
        let mut killed = machine(1);
        exchange(&mut killed, &mut vehicle, 1);
        let sent = killed.step(goal(7, pick(is_instant)), seconds(2));
        vehicle.receive(&sent[0]);
        drop(killed);

        let mut next = machine(1);
        let commands = next.step(resumed(7, pick(is_instant)), seconds(1));
        assert_eq!(orders(&commands), []);
        exchange(&mut next, &mut vehicle, 2);
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut next, &mut vehicle, 3)), Some(GoalStatus::Succeeded(_))));
        assert_eq!(vehicle.executed.iter().filter(|executed| *executed != "stateRequest").count(), 1, "{vehicle:?}");
    }
}

#[test]
fn a_resumed_action_that_the_vehicle_has_lost_is_not_repeated() {
    for is_instant in [false, true] {
        // The vehicle and the driver have restarted during the action.
        let (mut next, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        next.step(resumed(7, pick(is_instant)), seconds(1));
        let early = exchange(&mut next, &mut vehicle, 2);
        assert_eq!(result(&early), None, "the state may be older than the action");
        let Some(GoalStatus::Aborted(cause)) = result(&exchange(&mut next, &mut vehicle, 4)) else {
            panic!("{vehicle:?}");
        };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
        assert!(vehicle.order.is_empty() && !vehicle.executed.contains(&"pick".to_owned()), "{vehicle:?}");
    }
    // A drive starts again.
    let (mut next, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    next.step(resumed(7, drive("b")), seconds(1));
    assert_eq!(orders(&exchange(&mut next, &mut vehicle, 2)).len(), 1);
}

#[test]
fn an_action_that_ended_while_no_node_ran_is_not_repeated() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(is_instant))]));
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        assert!(matches!(result(&commands), Some(GoalStatus::Succeeded(_))), "{commands:?}");
        assert_eq!(acted(&vehicle), 1, "{vehicle:?}");
    }
}

#[test]
fn the_failure_of_an_action_that_ended_while_no_node_ran_is_reported_once() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(is_instant))]));
        vehicle.actions.iter_mut().for_each(|action| action.status = ActionStatus::Failed);
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
        assert!(matches!(result(&commands), Some(GoalStatus::Aborted(_))), "{commands:?}");
        assert_eq!(acted(&vehicle), 1, "{vehicle:?}");
        // The node has the result, and decides to try again.
        send(&mut next, &mut vehicle, begun_since(7, NEXT + 1, pick(is_instant)), 4);
        assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
    }
}

#[test]
fn the_same_action_of_the_next_task_is_executed() {
    for is_instant in [false, true] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(6, drive("b")), (7, pick(is_instant))]));
        // The node has recorded the end of the task.
        send(&mut next, &mut vehicle, goal(NEXT, pick(is_instant)), 1);
        exchange(&mut next, &mut vehicle, 2);
        assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
    }
    // The task had not begun when the node ended: the latest order is older, or is the drive before the action.
    for first in [8, 9] {
        let earlier = [(6, drive("b")), (7, pick(false)), (8, drive("c"))];
        for is_instant in [false, true] {
            let (mut next, mut vehicle) = (machine(1), after_goals(&earlier));
            send(&mut next, &mut vehicle, begun_since(first, NEXT, pick(is_instant)), 1);
            let early = exchange(&mut next, &mut vehicle, 2);
            assert_eq!((result(&early), acted(&vehicle)), (None, 1), "the state may be older than the action");
            exchange(&mut next, &mut vehicle, 3);
            assert_eq!(acted(&vehicle), 2, "{vehicle:?}");
        }
    }
}

#[test]
fn an_action_after_the_drives_and_actions_of_its_task_is_executed() {
    let executed = |vehicle: &mut FakeVehicle, first: u64, id: u64, is_instant: bool| {
        let (mut next, before) = (machine(1), acted(vehicle));
        send(&mut next, vehicle, begun_since(first, id, pick(is_instant)), 1);
        let commands = [2, 3].map(|time| exchange(&mut next, vehicle, time)).concat();
        assert_eq!((result(&commands), acted(vehicle)), (None, before + 1), "{vehicle:?}");
    };
    for is_instant in [false, true] {
        // A drive is a goal for each leg. An earlier task may have had the same action.
        let legs = [(7, drive("b")), (8, drive("c"))];
        executed(&mut after_goals(&legs), 7, NEXT, is_instant);
        let earlier = [[(6, pick(is_instant))].as_slice(), &legs].concat();
        executed(&mut after_goals(&earlier), 7, NEXT, is_instant);
        // The task begins with another action.
        for undock in [act("undock", false), act("undock", true)] {
            executed(&mut after_goals(&[(7, undock), (8, drive("b"))]), 7, NEXT, is_instant);
        }
        // The node, or the driver, has restarted twice during the task.
        let mut vehicle = after_goals(&legs);
        let mut second = machine(3);
        exchange(&mut second, &mut vehicle, 1);
        send(&mut second, &mut vehicle, goal(NEXT, drive("d")), 2);
        vehicle.step();
        assert!(result(&exchange(&mut second, &mut vehicle, 3)).is_some());
        executed(&mut vehicle, 7, NEXT + 1, is_instant);
    }
}

#[test]
fn an_action_that_may_have_happened_is_not_repeated() {
    let refused = |next: &mut OrderMachine, vehicle: &mut FakeVehicle, id: u64, is_instant: bool, time: u64| {
        let before = acted(vehicle);
        let first = send(next, vehicle, begun_since(7, id, pick(is_instant)), time);
        let commands = [first, exchange(next, vehicle, time + 1), exchange(next, vehicle, time + 2)].concat();
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
        assert_eq!(acted(vehicle), before, "{vehicle:?}");
    };
    for is_instant in [false, true] {
        // The next order has displaced the report of the action.
        let goals = [(6, drive("b")), (7, pick(is_instant)), (8, drive("c"))];
        let (mut next, mut vehicle) = (machine(1), after_goals(&goals));
        refused(&mut next, &mut vehicle, NEXT, is_instant, 1);
        refused(&mut next, &mut vehicle, NEXT + 1, is_instant, 5);
        // Two processes have driven since.
        let mut second = machine(3);
        exchange(&mut second, &mut vehicle, 1);
        send(&mut second, &mut vehicle, goal(NEXT + 2, drive("d")), 2);
        vehicle.step();
        assert!(result(&exchange(&mut second, &mut vehicle, 3)).is_some());
        refused(&mut machine(1), &mut vehicle, NEXT + 3, is_instant, 1);
        // The vehicle has restarted.
        refused(&mut machine(1), &mut FakeVehicle::at("a"), NEXT, is_instant, 1);
    }
    // The vehicle has its latest order, but does not report the action.
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(false))]));
    vehicle.actions.clear();
    refused(&mut next, &mut vehicle, NEXT, false, 1);
}

#[test]
fn an_end_that_this_process_has_displaced_is_the_result_once() {
    let reported = |next: &mut OrderMachine, vehicle: &mut FakeVehicle, is_instant: bool, is_failed: bool| {
        let before = acted(vehicle);
        send(next, vehicle, begun_since(7, NEXT + 1, pick(is_instant)), 4);
        let status = result(&[5, 6].map(|time| exchange(next, vehicle, time)).concat());
        let is_end = |status: &GoalStatus| match status {
            GoalStatus::Aborted(cause) => is_failed && cause.message.contains("the action failed"),
            other => !is_failed && matches!(other, GoalStatus::Succeeded(_)),
        };
        assert!(status.as_ref().is_some_and(is_end), "{status:?}");
        assert_eq!(acted(vehicle), before, "{vehicle:?}");
        // The node has the result. A further goal is a new request.
        send(next, vehicle, begun_since(7, NEXT + 2, pick(is_instant)), 7);
        assert_eq!(acted(vehicle), before + 1, "{vehicle:?}");
    };
    for (is_instant, is_failed) in [(false, false), (false, true), (true, false), (true, true)] {
        let (mut next, mut vehicle) = (machine(3), after_goals(&[(6, drive("b")), (7, pick(is_instant))]));
        if is_failed {
            vehicle.actions.iter_mut().for_each(|action| action.status = ActionStatus::Failed);
        }
        exchange(&mut next, &mut vehicle, 1);
        send(&mut next, &mut vehicle, goal(NEXT, drive("c")), 2);
        (0..3).for_each(|_| vehicle.step());
        assert!(result(&exchange(&mut next, &mut vehicle, 3)).is_some());
        reported(&mut next, &mut vehicle, is_instant, is_failed);
    }
    // This process has let the vehicle forget ended instant actions.
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, drive("b")), (8, pick(true))]));
    vehicle.instants = INSTANTS_MAX;
    send(&mut next, &mut vehicle, goal(NEXT, drive("b")), 1);
    assert!(result(&exchange(&mut next, &mut vehicle, 2)).is_some());
    assert!(vehicle.executed.contains(&"clearInstantActions".to_owned()), "{vehicle:?}");
    (vehicle.instants, vehicle.actions) = (0, vec![]);
    exchange(&mut next, &mut vehicle, 3);
    reported(&mut next, &mut vehicle, true, false);
}

#[test]
fn an_old_state_does_not_show_that_an_action_was_not_begun() {
    for answers in [true, false] {
        let (mut next, mut vehicle) = (machine(1), after_goals(&[(6, drive("b"))]));
        exchange(&mut next, &mut vehicle, 1);
        send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(false)), 2);
        let waiting = send(&mut next, &mut vehicle, Event::Tick, 8);
        assert_eq!((orders(&waiting), result(&waiting)), (vec![], None), "it may be under way");
        if answers {
            assert_eq!(orders(&exchange(&mut next, &mut vehicle, 9)).len(), 1);
        } else {
            let late = send(&mut next, &mut vehicle, Event::Tick, 12);
            assert!(matches!(result(&late), Some(GoalStatus::Aborted(cause)) if cause.code == "timed_out"), "{late:?}");
        }
        assert_eq!(acted(&vehicle), usize::from(answers), "{vehicle:?}");
    }
}

#[test]
fn the_latest_of_several_earlier_attempts_at_an_action_counts() {
    let (mut next, mut vehicle) = (machine(1), after_goals(&[(7, pick(true)), (8, pick(true))]));
    let first = vehicle.actions.iter_mut().find(|action| action.id.starts_with("consort-7-"));
    first.unwrap().status = ActionStatus::Failed;
    send(&mut next, &mut vehicle, begun_since(7, NEXT, pick(true)), 1);
    let commands = [2, 3].map(|time| exchange(&mut next, &mut vehicle, time)).concat();
    assert!(matches!(result(&commands), Some(GoalStatus::Succeeded(_))), "{commands:?}");
    assert_eq!(acted(&vehicle), 2, "the second attempt had succeeded");
}

#[test]
fn a_goal_after_the_shutdown_is_not_begun() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(Event::Shutdown, seconds(2));
    let commands = machine.step(goal(7, drive("d")), seconds(3));
    assert_eq!((orders(&commands), result(&commands)), (vec![], Some(GoalStatus::Canceled)));
}

#[test]
fn an_order_of_an_earlier_life_is_continued_for_the_same_work_only() {
    let under_way = || {
        let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, drive("d")), seconds(2));
        vehicle.receive(&sent[0]);
        vehicle.step();
        vehicle
    };
    // The node restarted: its goals have larger ids.
    let (mut next, mut vehicle) = (machine(3), under_way());
    next.step(goal(1 << 20, drive("d")), seconds(1));
    assert_eq!(orders(&exchange(&mut next, &mut vehicle, 2)), []);
    (0..3).for_each(|_| vehicle.step());
    assert!(matches!(result(&exchange(&mut next, &mut vehicle, 3)), Some(GoalStatus::Succeeded(_))));

    // Other work: the old order is cancelled first.
    let (mut next, mut vehicle) = (machine(3), under_way());
    next.step(goal(1 << 20, drive("a")), seconds(1));
    assert_eq!(cancels(&exchange(&mut next, &mut vehicle, 2)), 1);
    let order = orders(&exchange(&mut next, &mut vehicle, 3)).remove(0);
    assert_eq!((order.nodes[0].id.as_str(), order.nodes[1].id.as_str()), ("b", "a"));

    // A goal of an adapter that has been replaced does not touch the order of the later one.
    let (mut stale, mut vehicle) = (machine(3), under_way());
    stale.step(goal(6, drive("a")), seconds(1));
    let commands = exchange(&mut stale, &mut vehicle, 2);
    assert!(matches!(result(&commands), Some(GoalStatus::Aborted(cause)) if cause.code == "busy"));

    // Without a goal the order ends with the longest permission.
    let (mut idle, mut vehicle) = (machine(3), under_way());
    assert_eq!(cancels(&exchange(&mut idle, &mut vehicle, 1)), 0);
    assert_eq!(cancels(&idle.step(Event::Tick, seconds(5))), 1);
}

#[test]
fn a_restarted_vehicle_drives_again_but_does_not_repeat_an_action() {
    let restarted = |work: Work| {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, work), seconds(2));
        vehicle.receive(&sent[0]);
        exchange(&mut machine, &mut vehicle, 3);
        machine.step(Event::Connection(ConnectionState::Broken), seconds(4));
        vehicle.restart();
        machine.step(Event::Connection(ConnectionState::Online), seconds(6));
        let lost = exchange(&mut machine, &mut vehicle, 7);
        let next = exchange(&mut machine, &mut vehicle, 8);
        ([lost, next].concat(), sent)
    };
    let (commands, sent) = restarted(drive("d"));
    let again = orders(&commands).remove(0);
    let id = |order: &Order| order.id.parse::<OrderId>().unwrap();
    assert_eq!(id(&again), OrderId { attempt: 1, ..id(&orders(&sent)[0]) });
    for is_instant in [false, true] {
        let (commands, _) = restarted(pick(is_instant));
        assert_eq!(orders(&commands), []);
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert!(cause.message.contains("not repeated"), "{cause:?}");
    }
}

#[test]
fn a_vehicle_that_restarts_before_an_update_drives_again() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    vehicle.step();
    let update = orders(&machine.step(Event::State(Box::new(vehicle.state())), seconds(3)));
    assert_eq!(update[0].update, 1, "the vehicle does not receive it");
    vehicle.restart();
    machine.step(Event::Connection(ConnectionState::Online), seconds(4));
    let commands = [exchange(&mut machine, &mut vehicle, 5), exchange(&mut machine, &mut vehicle, 6)].concat();
    let again = orders(&commands).remove(0);
    assert_eq!((again.id.parse::<OrderId>().unwrap().attempt, again.update), (1, 0));
}

#[test]
fn a_goal_is_canceled_when_the_vehicle_has_stopped() {
    let under_way = |keep_for: Duration| {
        let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let event = Event::Goal { id: 7, fingerprint: 1, work: drive("d"), keep_for, since: None };
        let sent = machine.step(event, seconds(2));
        vehicle.receive(&sent[0]);
        exchange(&mut machine, &mut vehicle, 3);
        (machine, vehicle)
    };
    let (mut machine, mut vehicle) = under_way(seconds(100));
    let commands = machine.step(Event::Cancel { id: 7 }, seconds(4));
    assert_eq!((cancels(&commands), result(&commands)), (1, None), "the vehicle has not confirmed");
    // The cancel is lost, and sent again.
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 5)), 0);
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 6)), 1);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 7)), Some(GoalStatus::Canceled));
    assert!(machine.is_at_rest());
    // The end of the permission does the same.
    let (mut machine, mut vehicle) = under_way(seconds(2));
    assert_eq!(cancels(&exchange(&mut machine, &mut vehicle, 4)), 1);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Canceled));
    // A goal without permission is not sent.
    let (mut machine, mut vehicle) = (self::machine(3), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let event = Event::Goal { id: 7, fingerprint: 1, work: drive("d"), keep_for: Duration::ZERO, since: None };
    let commands = machine.step(event, seconds(2));
    assert_eq!((orders(&commands), result(&commands)), (vec![], Some(GoalStatus::Canceled)));
}

#[test]
fn errors_of_the_vehicle_end_a_goal_with_their_cause() {
    let with_error = |kind: &str, level: ErrorLevel, is_accepted: bool| {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, drive("d")), seconds(2));
        let order = orders(&sent).remove(0);
        if is_accepted {
            vehicle.receive(&sent[0]);
        }
        let references = vec![("orderId".to_owned(), order.id)];
        vehicle.errors = vec![VehicleError { kind: kind.to_owned(), level, description: String::new(), references }];
        let first = exchange(&mut machine, &mut vehicle, 3);
        let second = exchange(&mut machine, &mut vehicle, 4);
        ([&first, &second].iter().find_map(|commands| result(commands)), cancels(&first))
    };
    let code = |status: Option<GoalStatus>| match status {
        Some(GoalStatus::Aborted(cause)) => cause.code,
        other => panic!("{other:?}"),
    };
    // The vehicle rejects the order.
    let (status, _) = with_error("noRouteError", ErrorLevel::Warning, false);
    assert_eq!(code(status), "no_route");
    // The vehicle fails in the order; the goal ends when it has stopped.
    let (status, _) = with_error("obstacle", ErrorLevel::Fatal, true);
    assert_eq!(code(status), "blocked");
    // A warning of an accepted order changes nothing.
    assert_eq!(with_error("dust", ErrorLevel::Warning, true), (None, 0));
}

#[test]
fn an_order_of_another_master_is_not_touched() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    let node =
        OrderNode { id: "b".to_owned(), sequence: 2, released: true, at_m: None, yaw_rad: None, actions: vec![] };
    (vehicle.order, vehicle.ahead) = ("of-another".to_owned(), vec![node]);
    machine.step(goal(7, drive("d")), seconds(1));
    let commands = [exchange(&mut machine, &mut vehicle, 2), exchange(&mut machine, &mut vehicle, 12)].concat();
    let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
    assert_eq!((cause.code.as_str(), cancels(&commands), orders(&commands).len()), ("busy", 0, 0));
    assert!(cause.message.contains("of-another"), "{cause:?}");
}

#[test]
fn a_cancel_waits_for_a_state_that_is_younger_than_the_action() {
    for is_lost in [false, true] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, pick(true)), seconds(2));
        machine.step(Event::Cancel { id: 7 }, seconds(2));
        // The vehicle has written this state before it received the action.
        let commands = machine.step(Event::State(Box::new(vehicle.state())), Duration::from_millis(2_100));
        assert_eq!(result(&commands), None);
        if is_lost {
            assert_eq!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Canceled));
            continue;
        }
        vehicle.receive(&sent[0]);
        assert_eq!(result(&exchange(&mut machine, &mut vehicle, 4)), None);
        vehicle.finish_actions();
        assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 5)), Some(GoalStatus::Succeeded(_))));
    }
}

#[test]
fn a_continued_drive_keeps_the_limit_of_its_speed() {
    let limited = || Work::Drive { to: "d".to_owned(), speed_max_mps: Some(0.5) };
    let under_way = || {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        let sent = machine.step(goal(7, limited()), seconds(2));
        vehicle.receive(&sent[0]);
        vehicle.step();
        vehicle
    };
    let (mut next, mut vehicle) = (machine(1), under_way());
    next.step(resumed(7, limited()), seconds(1));
    exchange(&mut next, &mut vehicle, 2);
    let update = orders(&exchange(&mut next, &mut vehicle, 3)).remove(0);
    assert_eq!(Vec::from_iter(update.edges.iter().map(|edge| edge.speed_max_mps)), [Some(0.5), Some(0.5)]);
    // The limit of an earlier goal may have been higher.
    let (mut next, mut vehicle) = (machine(1), under_way());
    next.step(goal(1 << 20, limited()), seconds(1));
    assert_eq!(cancels(&exchange(&mut next, &mut vehicle, 2)), 1);
}

#[test]
fn an_order_or_action_that_the_vehicle_ignores_fails_the_goal() {
    for work in [drive("d"), pick(false), pick(true)] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        exchange(&mut machine, &mut vehicle, 1);
        machine.step(goal(7, work), seconds(2));
        let steps = (3..40).map(|time| machine.step(Event::State(Box::new(vehicle.state())), seconds(time)));
        let commands: Vec<Command> = steps.flatten().collect();
        let Some(GoalStatus::Aborted(cause)) = result(&commands) else { panic!("{commands:?}") };
        assert_eq!(cause.code, "timed_out");
        assert!(cause.message.contains("not accepted"), "{cause:?}");
    }
}

#[test]
fn ended_instant_actions_are_removed_between_goals() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    vehicle.instants = INSTANTS_MAX;
    let clears = |commands: &[Command]| {
        let is_clear = |command: &&Command| matches!(command, Command::SendInstant(action) if action.kind == "clearInstantActions");
        commands.iter().filter(is_clear).count()
    };
    assert_eq!(clears(&exchange(&mut machine, &mut vehicle, 1)), 0, "a goal of an earlier process may need them");
    let ended = machine.step(goal(7, drive("a")), seconds(2));
    assert_eq!((result(&ended), clears(&ended)), (Some(GoalStatus::Succeeded(String::new())), 1));
    assert_eq!(clears(&exchange(&mut machine, &mut vehicle, 3)), 0, "the vehicle has time to do it");
}

#[test]
fn a_drive_ends_when_the_vehicle_stands_still() {
    let (mut machine, mut vehicle) = (machine(usize::MAX), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("b")), seconds(2));
    assert!(orders(&sent)[0].nodes.iter().all(|node| node.released), "any number may be released");
    vehicle.receive(&sent[0]);
    vehicle.step();
    let rolling = VehicleState { is_driving: true, ..vehicle.state() };
    assert_eq!(result(&machine.step(Event::State(Box::new(rolling)), seconds(3))), None);
    assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Succeeded(_))));
}

#[test]
fn an_action_that_could_be_retried_fails_the_goal() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, pick(false)), seconds(2));
    vehicle.receive(&sent[0]);
    vehicle.actions[0].status = ActionStatus::Retriable;
    let commands = exchange(&mut machine, &mut vehicle, 3);
    assert_eq!((cancels(&commands), result(&commands)), (1, None));
    assert!(matches!(result(&exchange(&mut machine, &mut vehicle, 4)), Some(GoalStatus::Aborted(_))));
}

#[test]
fn errors_count_for_the_order_that_they_concern() {
    let error = |kind: &str, level: ErrorLevel, references: Vec<(String, String)>| {
        vec![VehicleError { kind: kind.to_owned(), level, description: String::new(), references }]
    };
    // A critical error allows another order, a fatal one does not.
    for (level, count) in [(ErrorLevel::Critical, 1), (ErrorLevel::Fatal, 0)] {
        let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
        vehicle.errors = error("jam", level, vec![]);
        exchange(&mut machine, &mut vehicle, 1);
        assert_eq!(orders(&machine.step(goal(7, drive("d")), seconds(2))).len(), count, "{level:?}");
    }
    // The refusal of a late cancel is no rejection of the next order.
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.errors = error("NO_ORDER_TO_CANCEL", ErrorLevel::Warning, vec![]);
    assert_eq!(result(&exchange(&mut machine, &mut vehicle, 3)), None);
    // A new process finds the order, and the error that the order has caused.
    vehicle.receive(&sent[0]);
    vehicle.errors = error("obstacle", ErrorLevel::Fatal, vec![("orderId".to_owned(), vehicle.order.clone())]);
    let mut next = self::machine(1);
    next.step(resumed(7, drive("d")), seconds(1));
    let commands = [exchange(&mut next, &mut vehicle, 2), exchange(&mut next, &mut vehicle, 3)].concat();
    assert_eq!(cancels(&commands), 1);
    let status = result(&exchange(&mut next, &mut vehicle, 4));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.code == "blocked"));
}

#[test]
fn a_rejection_of_3_0_without_references_ends_the_goal() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    machine.step(goal(7, drive("d")), seconds(2));
    let references = vec![("parameter".to_owned(), "order.nodes.nodePosition.theta".to_owned())];
    let (kind, level) = ("UNSUPPORTED_PARAMETER".to_owned(), ErrorLevel::Critical);
    vehicle.errors = vec![VehicleError { kind, level, description: String::new(), references }];
    let status = result(&exchange(&mut machine, &mut vehicle, 3));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.message.contains("UNSUPPORTED_PARAMETER")));
}

#[test]
fn the_last_node_of_the_order_before_releases_nothing() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    // The vehicle has accepted the order, and has not passed its first node.
    let first = RemainingNode { id: "a".to_owned(), sequence: 0, released: true };
    let accepted = vehicle.state();
    let nodes = Vec::from_iter([first].into_iter().chain(accepted.nodes.clone()));
    let stale = VehicleState { nodes, last_node: "z".to_owned(), last_sequence: 6, ..accepted };
    assert_eq!(stale.reached(), None);
    assert_eq!(orders(&machine.step(Event::State(Box::new(stale)), seconds(3))), []);
    vehicle.step();
    assert_eq!(orders(&exchange(&mut machine, &mut vehicle, 4))[0].update, 1);
    // A vehicle on a node may keep it among the nodes to drive to.
    let here = RemainingNode { id: "b".to_owned(), sequence: 2, released: true };
    let state = vehicle.state();
    let nodes = Vec::from_iter([here].into_iter().chain(state.nodes.clone()));
    assert_eq!(VehicleState { nodes, ..state }.reached(), Some(2));
}

#[test]
fn a_vehicle_that_is_offline_silent_or_in_manual_mode_is_unavailable() {
    let (mut machine, mut vehicle) = (machine(1), FakeVehicle::at("a"));
    assert_eq!(machine.unavailable(seconds(1)).as_deref(), Some("it has not reported its state"));
    exchange(&mut machine, &mut vehicle, 1);
    assert_eq!(machine.unavailable(seconds(2)), None);
    for connection in [ConnectionState::Offline, ConnectionState::Broken, ConnectionState::Hibernating] {
        machine.step(Event::Connection(connection), seconds(2));
        assert!(machine.unavailable(seconds(2)).is_some(), "{connection:?}");
        machine.step(Event::Connection(ConnectionState::Online), seconds(2));
        assert_eq!(machine.unavailable(seconds(2)), None, "{connection:?}");
    }
    let manual = VehicleState { mode: "MANUAL".to_owned(), ..vehicle.state() };
    machine.step(Event::State(Box::new(manual)), seconds(3));
    assert!(machine.unavailable(seconds(3)).is_some_and(|problem| problem.contains("MANUAL")));
    exchange(&mut machine, &mut vehicle, 4);
    assert_eq!((machine.unavailable(seconds(4)), machine.unavailable(seconds(33))), (None, None));
    assert!(machine.unavailable(seconds(34)).is_some(), "a vehicle reports its state every 30 s");
    machine.step(Event::Broker { is_up: false }, seconds(5));
    assert_eq!(machine.unavailable(seconds(5)).as_deref(), Some("no connection to the broker"));
}

#[test]
fn a_silent_vehicle_fails_the_goal_and_is_stopped_when_it_returns() {
    let (mut machine, mut vehicle) = (machine(3), FakeVehicle::at("a"));
    exchange(&mut machine, &mut vehicle, 1);
    let sent = machine.step(goal(7, drive("d")), seconds(2));
    vehicle.receive(&sent[0]);
    exchange(&mut machine, &mut vehicle, 3);
    let status = result(&machine.step(Event::Tick, seconds(40)));
    assert!(matches!(status, Some(GoalStatus::Aborted(cause)) if cause.code == "timed_out"));
    let later = [exchange(&mut machine, &mut vehicle, 50), exchange(&mut machine, &mut vehicle, 54)].concat();
    assert_eq!(cancels(&later), 1);
}
