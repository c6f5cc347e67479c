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

fn confirmed(dialog: &mut Dialog, model: &FleetModel) -> Outcome {
    dialog.handle_key(key(KeyCode::Char('y')), model)
}

#[test]
fn a_robot_is_held_after_a_reason_and_a_confirmation() {
    let model = busy();
    let mut dialog = open('h', Panel::Robots, &model).unwrap();
    enter(&mut dialog, "a spilk", &model);
    dialog.handle_key(key(KeyCode::Backspace), &model);
    enter(&mut dialog, "l\n", &model);
    let question = dialog.text(&model);
    assert!(
        question.starts_with(" Hold ada? It stands still at once for 10 min, and keeps r1 of rounds-1."),
        "{question}"
    );
    let hold = Order::Hold { robot: "ada".parse().unwrap(), reason: "a spill".to_owned() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(hold));
}

#[test]
fn a_robot_is_released_and_returned_to_service_without_a_reason() {
    let (model, ada) = (busy(), "ada".parse::<RobotId>().unwrap());
    for (letter, order) in [('r', Order::Release(ada.clone())), ('e', Order::EndMaintenance(ada))] {
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
    enter(&mut dialog, "tyres\n", &model);
    let begin = Order::BeginMaintenance { robot: "ada".parse().unwrap(), reason: "tyres".to_owned() };
    assert_eq!(confirmed(&mut dialog, &model), Outcome::Confirmed(begin));
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
    assert_eq!(problem('A', Panel::Log, &empty), "the alarms are unknown to this node");
    let known = json!({ "nodes": [], "closures": [], "speed_limits": [], "alarms": [] });
    empty.apply_view(&Key::ViewFleet, &known, NOW_MS);
    for (letter, focus, text) in [
        ('h', Panel::Robots, "no robot is selected"),
        ('p', Panel::Missions, "no mission is selected"),
        ('o', Panel::Log, "nothing is closed"),
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
    assert!(opens(key(KeyCode::Char('c')), Panel::Log));
    assert!(!opens(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL), Panel::Log));
}

#[test]
fn a_closure_states_the_robots_that_it_affects() {
    let model = busy();
    for (name, robots) in [("icu", "ada"), ("IC Room 5", "ada"), ("Dock", "no robot")] {
        let mut dialog = open('c', Panel::Log, &model).unwrap();
        enter(&mut dialog, &format!("{name}\nwet\n"), &model);
        let question = format!(" Close {name}? No robot enters it; there or on the way: {robots}.");
        assert!(dialog.text(&model).starts_with(&question), "{}", dialog.text(&model));
        let close = Order::Close { place: name.parse().unwrap(), reason: "wet".to_owned() };
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
        ("Dock", Order::OpenPlace("Dock".parse().unwrap())),
        ("zone icu", Order::OpenPlace("icu".parse().unwrap())),
        ("A – B", Order::OpenLane("A".parse().unwrap(), "B".parse().unwrap())),
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
