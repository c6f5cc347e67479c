use super::*;
use consort_dashboard::fleet_model::FloorPlan;
use consort_protocol::keys::Key;
use serde_json::{Value, json};

const NOW_MS: u64 = 100_000;

/// Returns a fleet of a robot in room 5, with its role in a mission, a zone, and a declared alarm. `view` has further
/// members of the view of the fleet.
fn model(state: &str, view: Value) -> FleetModel {
    let mut model = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
    let robot = json!({ "skills": [], "place": "IC Room 5", "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 },
        "battery": 0.4, "discharge": 0.0001, "useful_charge": 0.1, "speed": 0.5, "estimator": "standard",
        "availability": { "holding": { "mission": "rounds-1", "role": "r1", "suspended": false } } });
    let plan = json!({ "robots": "stop", "places": [], "closes": [{ "place": "Lift A" }] });
    let mut fleet = json!({ "nodes": [{ "node": "ada", "seen_by": "desk", "alive": true, "robot": robot }],
        "declared": { "alarms": { "fire": plan }, "zones": { "icu": ["IC Room 5"] } } });
    fleet.as_object_mut().unwrap().extend(view.as_object().unwrap().clone());
    model.apply_view(&Key::ViewFleet, &fleet, NOW_MS);
    let missions = json!({ "missions": [{ "mission": "rounds-1", "detail": state, "holders": { "r1": "ada" } }] });
    model.apply_view(&Key::ViewMissions, &missions, NOW_MS);
    model
}

fn busy() -> FleetModel {
    model("running", json!({}))
}

fn key(code: KeyCode) -> KeyEvent {
    KeyEvent::new(code, KeyModifiers::NONE)
}

fn open(letter: char, focus: Panel, model: &FleetModel) -> Result<Dialog, Problem> {
    Dialog::of_key(key(KeyCode::Char(letter)), (focus, 0), model).expect("the key has a dialog")
}

/// Types a text; `\n` is Enter.
fn enter(dialog: &mut Dialog, text: &str, model: &FleetModel) {
    for letter in text.chars() {
        let code = if letter == '\n' { KeyCode::Enter } else { KeyCode::Char(letter) };
        assert_eq!(dialog.handle_key(key(code), model), Outcome::Open, "{text:?}");
    }
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

fn part(text: &str) -> NamedPart {
    NamedPart::parse(text).unwrap()
}

/// Checks the question of a dialog, and sends its order.
fn check_confirmed(mut dialog: Dialog, model: &FleetModel, question: &str, order: Order) {
    let text = dialog.text(model);
    assert_eq!(text, format!(" {question}  y sends it, any other key leaves"));
    assert_eq!(confirmed(&mut dialog, model), Outcome::Confirmed(order));
}

fn confirmed(dialog: &mut Dialog, model: &FleetModel) -> Outcome {
    dialog.handle_key(key(KeyCode::Char('y')), model)
}

#[test]
fn a_robot_is_held_after_a_reason_and_a_confirmation() {
    let model = busy();
    let mut dialog = open('h', Panel::Robots, &model).unwrap();
    enter(&mut dialog, "a spilk", &model);
    dialog.handle_key(key(KeyCode::Backspace), &model);
    enter(&mut dialog, "l\n\n", &model);
    let question = dialog.text(&model);
    assert!(
        question.starts_with(" Hold ada? It stands still at once for 10 min, and keeps r1 of rounds-1."),
        "{question}"
    );
    let hold = Order::Hold { robots: only(robot("ada")), for_s: None, reason: "a spill".to_owned() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(hold));
}

#[test]
fn a_robot_is_released_and_returned_to_service_without_a_reason() {
    let model = busy();
    for (letter, order) in [('r', Order::Release(only(robot("ada")))), ('e', Order::EndMaintenance(robot("ada")))] {
        let mut dialog = open(letter, Panel::Robots, &model).unwrap();
        assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(order));
    }
}

#[test]
fn maintenance_needs_a_reason() {
    let model = busy();
    let mut dialog = open('m', Panel::Robots, &model).unwrap();
    enter(&mut dialog, "\n", &model);
    assert!(dialog.text(&model).ends_with("\n maintenance needs a reason"), "{}", dialog.text(&model));
    enter(&mut dialog, "tyres\n2026-12-31T18:00:00Z\n", &model);
    let until = "2026-12-31T18:00:00Z".to_owned();
    let question = format!("Take ada out of service? It completes r1 of rounds-1, and gets no other until {until}.");
    let begin = Order::BeginMaintenance { robot: robot("ada"), until: Some(until), reason: "tyres".to_owned() };
    check_confirmed(dialog, &model, &question, begin);
}

#[test]
fn only_y_sends_an_order_and_escape_leaves_each_stage() {
    let model = busy();
    for code in [KeyCode::Enter, KeyCode::Esc, KeyCode::Char('n'), KeyCode::Char('q')] {
        let mut dialog = open('x', Panel::Missions, &model).unwrap();
        assert_eq!(dialog.handle_key(key(code), &model), Outcome::Left, "{code:?}");
    }
    for (letter, focus) in [('p', Panel::Missions), ('h', Panel::Robots)] {
        let mut dialog = open(letter, focus, &model).unwrap();
        enter(&mut dialog, "y", &model);
        assert_eq!(dialog.handle_key(key(KeyCode::Esc), &model), Outcome::Left, "{letter}");
    }
}

#[test]
fn a_priority_is_checked_before_it_is_confirmed() {
    let model = busy();
    let mut dialog = open('p', Panel::Missions, &model).unwrap();
    enter(&mut dialog, "101\n", &model);
    assert!(dialog.text(&model).ends_with("a priority is a whole number from -100 to 100"), "{}", dialog.text(&model));
    dialog.handle_key(key(KeyCode::Backspace), &model);
    enter(&mut dialog, "\n", &model);
    assert!(dialog.text(&model).starts_with(" Give rounds-1 the priority 10?"), "{}", dialog.text(&model));
    let order = Order::SetPriority { mission: "rounds-1".parse().unwrap(), priority: Priority::new(10).unwrap() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(order));
}

#[test]
fn an_order_needs_something_that_it_changes() {
    let ended = model("completed", json!({}));
    assert_eq!(open('x', Panel::Missions, &ended).unwrap_err(), Problem::Ended("rounds-1".to_owned()));
    let mut empty = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
    let problem = |letter, focus, model: &FleetModel| open(letter, focus, model).unwrap_err().to_string();
    assert_eq!(problem('o', Panel::Log, &empty), "the closures are unknown to this node");
    assert_eq!(problem('L', Panel::Log, &empty), "the speed limits are unknown to this node");
    assert_eq!(problem('A', Panel::Log, &empty), "the alarms are unknown to this node");
    let known = json!({ "nodes": [], "closures": [], "speed_limits": [], "alarms": [] });
    empty.apply_view(&Key::ViewFleet, &known, NOW_MS);
    for (letter, focus, text) in [
        ('h', Panel::Robots, "no robot is selected"),
        ('p', Panel::Missions, "no mission is selected"),
        ('p', Panel::Schedules, "no schedule is selected"),
        ('o', Panel::Log, "nothing is closed"),
        ('L', Panel::Log, "no speed is limited"),
        ('a', Panel::Log, "the fleet file declares no alarms"),
        ('A', Panel::Log, "no alarm is in force"),
    ] {
        assert_eq!(problem(letter, focus, &empty), text);
    }
}

#[test]
fn keys_of_orders_belong_to_their_panels() {
    let model = busy();
    let opens = |key: KeyEvent, focus| Dialog::of_key(key, (focus, 0), &model).is_some();
    assert!(!opens(key(KeyCode::Char('h')), Panel::Missions) && !opens(key(KeyCode::Char('x')), Panel::Robots));
    assert!(!opens(key(KeyCode::Char('n')), Panel::Robots) && !opens(key(KeyCode::Char('p')), Panel::Auction));
    for panel in Panel::ALL {
        assert!("HRcolLaA".chars().all(|letter| opens(key(KeyCode::Char(letter)), panel)), "{panel:?}");
    }
    assert!(!opens(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL), Panel::Log));
}

#[test]
fn a_closure_states_the_robots_that_it_affects() {
    let model = busy();
    for (name, robots) in [("icu", "ada"), ("IC Room 5", "ada"), ("Dock", "no robot")] {
        let mut dialog = open('c', Panel::Log, &model).unwrap();
        enter(&mut dialog, &format!("{name}\nwet\n\n"), &model);
        let question = format!(" Close {name}? No robot enters it; there or on the way: {robots}.");
        assert!(dialog.text(&model).starts_with(&question), "{}", dialog.text(&model));
        let close = Order::Close { part: part(name), for_s: None, reason: "wet".to_owned() };
        assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(close));
    }
    let mut dialog = open('c', Panel::Log, &model).unwrap();
    enter(&mut dialog, "\n", &model);
    assert!(dialog.text(&model).contains("it is empty"), "{}", dialog.text(&model));
}

#[test]
fn closed_places_lanes_and_zones_are_opened_by_their_names() {
    let order = json!({ "by": "Nia", "reason": "", "since_ms": 5, "until_ms": null });
    let zone = json!({ "zone": { "name": "icu", "places": ["IC Room 5"] } });
    let parts = [json!({ "place": "Dock" }), json!({ "lane": ["A", "B"] }), zone];
    let closures = parts.map(|part| json!({ "part": part, "order": order }));
    let model = model("running", json!({ "closures": closures }));
    for (name, opened) in [
        ("Dock", Order::Open(NamedPart::PlaceOrZone("Dock".parse().unwrap()))),
        ("zone icu", Order::Open(NamedPart::PlaceOrZone("icu".parse().unwrap()))),
        ("A – B", Order::Open(NamedPart::Lane("A".parse().unwrap(), "B".parse().unwrap()))),
    ] {
        let mut dialog = open('o', Panel::Log, &model).unwrap();
        assert!(dialog.text(&model).starts_with(" Place, zone or lane to open (A – B, Dock, zone icu): "));
        enter(&mut dialog, &format!("{name}\n"), &model);
        assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(opened));
    }
}

/// The only alarm is proposed.
#[test]
fn an_alarm_is_raised_with_its_effect_and_cleared() {
    let model = busy();
    let mut dialog = open('a', Panel::Log, &model).unwrap();
    enter(&mut dialog, "\nsmoke\n", &model);
    let question =
        " Raise the alarm fire? Robots stand still; closed: Lift A; 1 robot suspends its role, 1 mission waits.";
    assert!(dialog.text(&model).starts_with(question), "{}", dialog.text(&model));
    let raise = Order::RaiseAlarm { alarm: "fire".parse().unwrap(), reason: "smoke".to_owned() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(raise));

    let order = json!({ "by": "Nia", "reason": "smoke", "since_ms": 5, "until_ms": null });
    let plan = json!({ "robots": "stop", "places": [], "closes": [] });
    let alarmed = self::model("running", json!({ "alarms": [{ "alarm": "fire", "plan": plan, "order": order }] }));
    let mut dialog = open('A', Panel::Log, &alarmed).unwrap();
    enter(&mut dialog, "\n", &alarmed);
    assert!(dialog.text(&alarmed).starts_with(" Clear the alarm fire? Robots continue their roles."));
    assert_eq!(confirmed(&mut dialog, &alarmed), Outcome::Confirmed(Order::ClearAlarm("fire".parse().unwrap())));
}

#[test]
fn a_hold_of_several_robots_states_who_is_affected() {
    let model = busy();
    let all = RobotSelection::All(AllRobots::All);
    let icu = || RobotSelection::Zone(RobotZone { zone: "icu".parse().unwrap() });
    let condition = "robot.battery < 0.5";
    let met = RobotSelection::Where(SelectionCondition { condition: condition.to_owned() });
    for (text, name, affected, robots) in [
        ("all", "all robots", "ada, with 1 role", all),
        ("icu", "the robots in zone icu", "ada, with 1 role", icu()),
        ("zone icu", "the robots in zone icu", "ada, with 1 role", icu()),
        (condition, "the robots with `robot.battery < 0.5`", "ada, with 1 role", met),
    ] {
        let mut dialog = open('H', Panel::Log, &model).unwrap();
        assert!(dialog.text(&model).starts_with(" Robots to hold: all, a zone (icu), or a condition: "));
        enter(&mut dialog, &format!("{text}\nvisit\n30\n"), &model);
        let question = format!(
            "Hold {name}? They stand still at once for 30 min, and keep their roles: {affected}. This is not an emergency \
             stop."
        );
        let hold = Order::Hold { robots, for_s: Some(1800), reason: "visit".to_owned() };
        check_confirmed(dialog, &model, &question, hold);
    }
    let mut dialog = open('H', Panel::Log, &model).unwrap();
    enter(&mut dialog, "icuu\n", &model);
    assert!(dialog.text(&model).contains("\n \"icuu\" is no zone, and no condition: "), "{}", dialog.text(&model));
}

#[test]
fn a_release_of_several_robots_names_the_held_ones() {
    let mut model = busy();
    let release = |model: &FleetModel, held: &str| {
        let mut dialog = open('R', Panel::Missions, model).unwrap();
        enter(&mut dialog, "all\n", model);
        let question = format!("Release all robots? Held robots continue their roles: {held}.");
        check_confirmed(dialog, model, &question, Order::Release(RobotSelection::All(AllRobots::All)));
    };
    release(&model, "no robot now");
    let robot = json!({ "skills": [], "place": "Dock", "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 }, "battery": 0.4,
        "discharge": 0.0001, "useful_charge": 0.1, "speed": 0.5, "estimator": "standard", "availability": "free" });
    let node = |name: &str, orders: Value| {
        json!({ "node": name, "seen_by": "desk", "alive": true, "robot": robot,
            "orders": orders })
    };
    let hold = json!({ "hold": { "by": "Nia", "reason": "", "since_ms": 5, "until_ms": null } });
    let fleet = json!({ "nodes": [node("ada", json!({})), node("bea", hold)], "closures": [] });
    model.apply_view(&Key::ViewFleet, &fleet, NOW_MS);
    release(&model, "bea, with 0 roles");
}

#[test]
fn the_minutes_of_an_order_are_bounded() {
    let model = busy();
    for (letter, before, max) in [('h', "\n", 1440), ('c', "Dock\n\n", 527_040)] {
        for minutes in ["0", "1.5", "-3", "soon", &(max + 1).to_string()] {
            let mut dialog = open(letter, Panel::Robots, &model).unwrap();
            enter(&mut dialog, &format!("{before}{minutes}\n"), &model);
            let problem = format!("\n the minutes are a whole number from 1 to {max}");
            assert!(dialog.text(&model).ends_with(&problem), "{}", dialog.text(&model));
        }
        let mut dialog = open(letter, Panel::Robots, &model).unwrap();
        enter(&mut dialog, &format!("{before}{max}\n"), &model);
        assert!(dialog.text(&model).contains(&format!("for {max} min")), "{}", dialog.text(&model));
    }
}

#[test]
fn a_speed_is_limited_and_the_limit_is_cleared() {
    let model = busy();
    let speed = |speed| MetresPerSecond::new(speed).unwrap();
    let mut dialog = open('l', Panel::Auction, &model).unwrap();
    enter(&mut dialog, "icu\n", &model);
    assert!(dialog.text(&model).starts_with(" Highest speed in metres per second: 0.3▏"), "{}", dialog.text(&model));
    enter(&mut dialog, "\nwet\n120\n", &model);
    let question = "Limit icu to 0.3 m/s? Robots drive no faster there for 120 min; there or on the way: ada. Of several \
                    limits the lowest holds. This is not a safety function.";
    let limit = Order::Limit { part: part("icu"), speed: speed(0.3), for_s: Some(7200), reason: "wet".to_owned() };
    check_confirmed(dialog, &model, question, limit);

    let mut dialog = open('l', Panel::Auction, &model).unwrap();
    enter(&mut dialog, "B -- A\n", &model);
    for wrong in ["", "0.04", "fast", "-1"] {
        (0..8).for_each(|_| drop(dialog.handle_key(key(KeyCode::Backspace), &model)));
        enter(&mut dialog, &format!("{wrong}\n"), &model);
        assert!(
            dialog.text(&model).contains("\n a speed limit is a number of 0.05 or more"),
            "{}",
            dialog.text(&model)
        );
    }
    (0..8).for_each(|_| drop(dialog.handle_key(key(KeyCode::Backspace), &model)));
    enter(&mut dialog, "0.05\n\n\n", &model);
    let lane = NamedPart::Lane("B".parse().unwrap(), "A".parse().unwrap());
    let limit = Order::Limit { part: lane, speed: speed(0.05), for_s: None, reason: String::new() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(limit));

    let order = json!({ "by": "Nia", "reason": "", "since_ms": 5, "until_ms": null });
    let zone = json!({ "zone": { "name": "icu", "places": ["IC Room 5"] } });
    let model = self::model("running", json!({ "speed_limits": [{ "part": zone, "speed_mps": 0.3, "order": order }] }));
    let mut dialog = open('L', Panel::Auction, &model).unwrap();
    let asked = " Place, zone or lane with the limit to clear (zone icu): zone icu▏";
    assert!(dialog.text(&model).starts_with(asked), "the only limit is proposed: {}", dialog.text(&model));
    enter(&mut dialog, "\n", &model);
    let question = "Clear the speed limit of icu? Robots drive at their own speed there, or at that of other limits.";
    check_confirmed(dialog, &model, question, Order::ClearLimit(part("icu")));
}

/// Adds the view of the mission with its roles to a fleet.
fn with_roles(mut model: FleetModel) -> FleetModel {
    let role = |role: &str, kind: &str, phase: &str, holder: Option<&str>| {
        json!({ "role": role, "kind": kind,
            "phase": phase, "holder": holder })
    };
    let roles = [
        role("nurse", "unmanaged", "active", None),
        role("r0", "managed", "ended", Some("ada")),
        role("r1", "managed", "active", Some("ada")),
        role("r2", "managed", "promised", Some("bea")),
        role("r3", "managed", "open", None),
    ];
    let view =
        json!({ "mission": "rounds-1", "detail": "running", "roles": roles, "orders": { "r3": "pinned to bea" } });
    model.apply_view(&Key::ViewMission("rounds-1".parse().unwrap()), &view, NOW_MS);
    model
}

#[test]
fn a_role_is_reassigned_with_its_effect() {
    let model = busy();
    let text = open('r', Panel::Missions, &model).unwrap().text(&model);
    assert!(text.starts_with(" Role to reassign: ▏"), "the roles are not known yet: {text}");
    let model = with_roles(model);
    for (entered, to, repeat, question) in [
        (
            "r1\n\n\n",
            None,
            false,
            "Give r1 of rounds-1 to another robot? ada returns it at rest, and another robot starts it from its beginning. \
             It stays with ada if that has an item in it, or if other roles have acted on its work.",
        ),
        (
            "r1\nbea\nyes\n",
            Some(robot("bea")),
            true,
            "Give r1 of rounds-1 to bea? ada returns it at rest, and bea starts it from its beginning. It stays with ada if \
             that has an item in it, or if other roles have acted on its work. Tasks of it that have ended are repeated.",
        ),
        (
            "r2\nada\nno\n",
            Some(robot("ada")),
            false,
            "Give r2 of rounds-1 to ada? bea does not get it, and ada starts it from its beginning.",
        ),
        ("r3\nada\n\n", Some(robot("ada")), false, "Give r3 of rounds-1 to ada? No robot has it yet; ada gets it."),
    ] {
        let mut dialog = open('r', Panel::Missions, &model).unwrap();
        assert!(dialog.text(&model).starts_with(" Role to reassign (r1, r2, r3): ▏"), "{}", dialog.text(&model));
        enter(&mut dialog, entered, &model);
        let (mission, role) = ("rounds-1".parse().unwrap(), entered[..2].parse().unwrap());
        check_confirmed(dialog, &model, question, Order::Reassign { mission, role, to, repeat });
    }
    let mut dialog = open('r', Panel::Missions, &model).unwrap();
    enter(&mut dialog, "\n", &model);
    assert!(dialog.text(&model).contains("it is empty"), "{}", dialog.text(&model));
    enter(&mut dialog, "r1\n\nperhaps\n", &model);
    assert!(dialog.text(&model).ends_with("\n enter yes or no"), "{}", dialog.text(&model));
}

#[test]
fn a_role_is_pinned_and_unpinned() {
    let model = with_roles(busy());
    for (entered, pinned, question) in [
        (
            "r2\nada\n",
            Some(robot("ada")),
            "Pin r2 of rounds-1 to ada? No other robot gets it from now on, also after a loss of ada.",
        ),
        ("r3\n\n", None, "End the order about r3 of rounds-1? It is pinned to bea. Any robot may get it."),
    ] {
        let mut dialog = open('n', Panel::Missions, &model).unwrap();
        enter(&mut dialog, entered, &model);
        let (mission, role) = ("rounds-1".parse().unwrap(), entered[..2].parse().unwrap());
        check_confirmed(dialog, &model, question, Order::Pin { mission, role, robot: pinned });
    }
}

#[test]
fn missions_with_a_text_are_canceled_as_shown() {
    let mut model = busy();
    let mission = |id: &str, state: &str, room: &str| {
        json!({ "mission": id, "detail": state, "holders": {},
            "parameters": { "room": room } })
    };
    let missions = [
        mission("samples-1", "pending", "IC Room 6"),
        mission("samples-2", "running", "PC Room 1"),
        mission("samples-3", "completed", "IC Room 6"),
    ];
    model.apply_view(&Key::ViewMissions, &json!({ "missions": missions }), NOW_MS);
    let ids = |ids: &[&str]| Order::CancelAll(ids.iter().map(|id| id.parse().unwrap()).collect());
    for (text, question, order) in [
        ("SAMPLES", "Cancel samples-1, samples-2? 2 missions, without a robot.", ids(&["samples-1", "samples-2"])),
        ("room 6", "Cancel samples-1? 1 mission, without a robot.", ids(&["samples-1"])),
        ("ada", "Cancel rounds-1? 1 mission; robots stop safely: ada.", ids(&["rounds-1"])),
        (
            "all",
            "Cancel rounds-1, samples-1, samples-2? 3 missions; robots stop safely: ada.",
            ids(&["rounds-1", "samples-1", "samples-2"]),
        ),
    ] {
        let mut dialog = open('X', Panel::Missions, &model).unwrap();
        enter(&mut dialog, &format!("{text}\n"), &model);
        check_confirmed(dialog, &model, question, order);
    }
    for text in ["", "vital"] {
        let mut dialog = open('X', Panel::Missions, &model).unwrap();
        enter(&mut dialog, &format!("{text}\n"), &model);
        assert!(dialog.text(&model).ends_with("\n no active mission has this text"), "{}", dialog.text(&model));
    }
    let mut dialog = open('X', Panel::Missions, &model).unwrap();
    enter(&mut dialog, "samples\n", &model);
    let later = json!({ "missions": [mission("samples-4", "pending", "IC Room 6")] });
    model.apply_view(&Key::ViewMissions, &later, NOW_MS);
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(ids(&["samples-1", "samples-2"])));
}

#[test]
fn a_schedule_is_paused_resumed_and_removed() {
    let with_pause = |pause: Value| {
        let mut model = busy();
        let rounds =
            json!({ "schedule": "rounds", "mission": "rounds", "cron": "0 8 * * *", "zone": "UTC", "pause": pause });
        model.apply_view(&Key::ViewSchedules, &json!({ "schedules": [rounds] }), NOW_MS);
        model
    };
    let (active, paused) = (with_pause(Value::Null), with_pause(json!({ "by": "Nia", "since_ms": 5 })));
    for (letter, model, question, action) in [
        (
            'p',
            &active,
            "Pause the schedule rounds? Its occurrences are left out until it is resumed.",
            ScheduleAction::Pause,
        ),
        (
            'r',
            &paused,
            "Resume the schedule rounds? Its next occurrences are submitted; what it missed in the pause is left out.",
            ScheduleAction::Resume,
        ),
        ('x', &paused, "Remove the schedule rounds? Its missions go on.", ScheduleAction::Remove),
    ] {
        let dialog = open(letter, Panel::Schedules, model).unwrap();
        let order = Order::ChangeSchedule { schedule: "rounds".parse().unwrap(), action };
        check_confirmed(dialog, model, question, order);
    }
    let problem = |letter, model| open(letter, Panel::Schedules, model).unwrap_err().to_string();
    assert_eq!(problem('p', &paused), "the schedule rounds is paused already");
    assert_eq!(problem('r', &active), "the schedule rounds is not paused");
}
