use super::*;
use consort_dashboard::fleet_model::FloorPlan;
use consort_protocol::api::ScheduleAction;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::keys::Key;
use consort_protocol::ledger::MissionState;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use serde_json::json;

const NOW_MS: u64 = 100_000;

/// A fleet of two robots and a mission, as published by a coordinator.
fn model() -> FleetModel {
    let mut model = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
    let worker = json!({ "skills": ["navigation"], "place": "Dock", "pose": { "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0 },
        "battery": 0.42, "discharge": 0.0001, "useful_charge": 0.1, "speed": 0.5, "availability": "free",
        "estimator": "standard" });
    let node = |name: &str, alive: bool| {
        json!({ "node": name, "seen_by": "desk", "alive": alive, "status": if alive { "alive" } else { "down" }, "age_ms": 100,
            "may_vote": true, "stationary": false, "mains_powered": false, "leaving": false, "robot": worker })
    };
    model.apply_view(&Key::ViewFleet, &json!({ "nodes": [node("ada", true), node("bea", false)] }), NOW_MS);
    let coordinator =
        json!({ "seen_by": "desk", "node": "ada", "term": 3, "since_ms": 1000, "voters": ["ada"], "learners": [] });
    model.apply_view(&Key::ViewCoordinator, &coordinator, NOW_MS);
    let mission = json!({ "mission": "lab-samples-1", "state": "running", "detail": "running", "done": 4, "steps": 16,
        "holders": { "r1": "ada" }, "parameters": {}, "priority": 0, "submitted_at_ms": 40_000 });
    model.apply_view(&Key::ViewMissions, &json!({ "missions": [mission] }), NOW_MS);
    model
}

fn drawn(screen: &mut Tui, model: &FleetModel, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| screen.draw(frame, model, NOW_MS)).unwrap();
    terminal.backend().to_string()
}

fn press(screen: &mut Tui, code: KeyCode) -> KeyOutcome {
    screen.handle_key(KeyEvent::new(code, KeyModifiers::NONE), &model())
}

#[test]
fn the_whole_fleet_fits_on_a_screen() {
    for (width, height) in [(140, 40), (80, 24)] {
        let text = drawn(&mut Tui::new(ColorMode::Plain), &model(), width, height);
        for part in ["coordinator ada, term 3", "lab-samples-1", "running", "4/16", "42 %", "bea", "down", "q quit"] {
            assert!(text.contains(part), "{part} is not on {width}x{height}:\n{text}");
        }
    }
}

#[test]
fn an_unreachable_fleet_is_marked_as_old() {
    let mut model = model();
    model.apply_links(0, NOW_MS + 10_000);
    let text = drawn(&mut Tui::new(ColorMode::Plain), &model, 140, 40);
    assert!(text.contains("the data is old"), "{text}");
}

#[test]
fn the_log_shows_the_newest_events_at_the_top() {
    let mut model = model();
    for (sequence, state) in [(1, MissionState::Running), (2, MissionState::Completed)] {
        let mission = "lab-samples-1".parse().unwrap();
        let kind = EventKind::Mission { mission, state, submitted_at_ms: 0 };
        let event = Event { node: "ada".parse().unwrap(), sequence, at_ms: NOW_MS, kind };
        model.apply_event(&event, NOW_MS);
    }
    let text = drawn(&mut Tui::new(ColorMode::Plain), &model, 140, 40);
    let log = &text[text.find(" Log ").expect("a log")..];
    let at = |word: &str| log.find(word).unwrap_or_else(|| panic!("{word} in\n{log}"));
    assert!(at("completed") < at("running"), "{text}");
}

#[test]
fn keys_move_between_panels_and_rows_and_end() {
    let mut screen = Tui::new(ColorMode::Plain);
    assert_eq!(press(&mut screen, KeyCode::Tab), KeyOutcome::Continue);
    assert_eq!(screen.focus, Panel::Auction);
    press(&mut screen, KeyCode::BackTab);
    press(&mut screen, KeyCode::BackTab);
    assert_eq!(screen.focus, Panel::Robots);
    press(&mut screen, KeyCode::PageDown);
    assert_eq!(screen.rows[0], 10);
    drawn(&mut screen, &model(), 140, 40);
    assert_eq!(screen.rows[0], 1, "there are two robots");
    press(&mut screen, KeyCode::Up);
    press(&mut screen, KeyCode::Up);
    assert_eq!(screen.rows[0], 0);
    assert_eq!(press(&mut screen, KeyCode::Char('q')), KeyOutcome::Quit);
    let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
    assert_eq!(screen.handle_key(control_c, &model()), KeyOutcome::Quit);
}

#[test]
fn an_order_is_confirmed_on_the_last_lines() {
    let mut screen = Tui::new(ColorMode::Plain);
    press(&mut screen, KeyCode::Char('x'));
    let text = drawn(&mut screen, &model(), 80, 24);
    assert!(text.contains("Cancel lab-samples-1? Its robots stop safely: ada."), "{text}");
    assert_eq!(press(&mut screen, KeyCode::Char('q')), KeyOutcome::Continue, "it leaves the dialog");
    assert!(drawn(&mut screen, &model(), 80, 24).contains("q quit"));
    press(&mut screen, KeyCode::Char('x'));
    let cancel = Order::Cancel("lab-samples-1".parse().unwrap());
    assert_eq!(press(&mut screen, KeyCode::Char('y')), KeyOutcome::Order(cancel));
    screen.show_note("cancel lab-samples-1: done".to_owned());
    assert!(drawn(&mut screen, &model(), 80, 24).contains("cancel lab-samples-1: done"));
    press(&mut screen, KeyCode::Char('x'));
    screen.show_note("it was rejected".to_owned());
    assert!(!drawn(&mut screen, &model(), 80, 24).contains("it was rejected"), "the dialog is there");
    press(&mut screen, KeyCode::Esc);
    assert!(drawn(&mut screen, &model(), 80, 24).contains("it was rejected"));
    press(&mut screen, KeyCode::Char('a'));
    assert!(drawn(&mut screen, &model(), 80, 24).contains("the fleet file declares no alarms"));
    press(&mut screen, KeyCode::Tab);
    assert!(drawn(&mut screen, &model(), 80, 24).contains("q quit"));
}

/// At every size the schedules are in place of the auction, while they have the focus.
#[test]
fn schedules_are_listed_and_paused() {
    let mut model = model();
    let schedule = |name: &str, member: &str, value: serde_json::Value| {
        json!({ "schedule": name, "mission": "lab-samples", "cron": "0 8 * * 1-5", "zone": "UTC",
            member: value })
    };
    let pause = json!({ "by": "Nia", "since_ms": 1_767_225_600_000_u64 });
    let schedules = [schedule("early", "next_ms", json!(1_767_254_400_000_u64)), schedule("late", "pause", pause)];
    model.apply_view(&Key::ViewSchedules, &json!({ "schedules": schedules }), NOW_MS);
    let mut screen = Tui::new(ColorMode::Plain);
    let mut press = |code| {
        let outcome = screen.handle_key(KeyEvent::new(code, KeyModifiers::NONE), &model);
        (outcome, [(140, 40), (80, 24)].map(|(width, height)| drawn(&mut screen, &model, width, height)))
    };
    let (_, auction) = press(KeyCode::Tab);
    let (_, schedules) = press(KeyCode::Tab);
    for text in auction {
        assert!(text.contains(" Auction ") && !text.contains(" Schedules "), "{text}");
    }
    for text in schedules {
        for part in ["early", "next 2026-01-01 08:00 UTC", "0 8 * *", "late", "paused by Nia", "p pause  r resume"] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains(" Auction "), "{text}");
    }
    press(KeyCode::Char('p'));
    let pause = Order::ChangeSchedule { schedule: "early".parse().unwrap(), action: ScheduleAction::Pause };
    assert_eq!(press(KeyCode::Char('y')).0, KeyOutcome::Order(pause));
    press(KeyCode::Down);
    let [text, _] = press(KeyCode::Char('p')).1;
    assert!(text.contains("the schedule late is paused already"), "{text}");
}

#[test]
fn orders_about_roles_are_beside_their_robots() {
    let mut model = model();
    let mission = json!({ "mission": "lab-samples-1", "detail": "running", "holders": { "r1": "ada" },
        "orders": { "r2": "pinned to bea" } });
    model.apply_view(&Key::ViewMissions, &json!({ "missions": [mission] }), NOW_MS);
    let text = drawn(&mut Tui::new(ColorMode::Plain), &model, 200, 40);
    assert!(text.contains("r1: ada, r2: pinned to bea"), "{text}");
}

#[test]
fn keys_of_orders_fit_on_a_terminal_of_80_columns() {
    let mut screen = Tui::new(ColorMode::Plain);
    for focus in Panel::ALL {
        screen.focus = focus;
        let keys = screen.key_bindings();
        assert_eq!(keys.lines().count(), usize::from(KEY_LINES), "{keys}");
        assert!(keys.lines().all(|line| line.chars().count() <= 80), "{keys}");
        let text = drawn(&mut screen, &model(), 80, 24);
        assert!(text.contains("q quit") && text.contains("A clear"), "{text}");
    }
}

#[test]
fn long_lists_are_shortened() {
    assert_eq!(listed(1..=3), "1, 2, 3");
    assert_eq!(listed(1..=8), "1, 2, 3, 4, 5, 6, 7, 8");
    assert_eq!(listed(1..=10), "1, 2, 3, 4, 5, 6, 7, 8 and 2 more");
}

#[test]
fn alarms_in_force_are_in_the_head() {
    let mut model = model();
    let order = json!({ "by": "Nia", "reason": "smoke", "since_ms": 1, "until_ms": null });
    let plan = json!({ "robots": "stop", "places": [], "closes": [] });
    let alarms = json!([{ "alarm": "fire", "plan": plan, "order": order }]);
    model.apply_view(&Key::ViewFleet, &json!({ "nodes": [], "alarms": alarms }), NOW_MS);
    let text = drawn(&mut Tui::new(ColorMode::Plain), &model, 80, 24);
    assert!(text.contains("under alarm fire by Nia: smoke; robots stand still"), "{text}");
}

#[test]
fn an_empty_model_and_a_tiny_terminal_are_drawn_too() {
    let nothing = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
    let text = drawn(&mut Tui::new(ColorMode::Color), &nothing, 120, 30);
    assert!(text.contains("no coordinator is known"), "{text}");
    drawn(&mut Tui::new(ColorMode::Color), &model(), 1, 1);
}
