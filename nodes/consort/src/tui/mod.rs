//! The fleet on a terminal: a [`FleetModel`] drawn as text, and key bindings.
//!
//! It draws cells from values, and makes orders of keys; `consort watch` reads the keys, writes to the terminal, and
//! sends the orders.

mod dialog;
mod order;
mod panels;

pub(crate) use order::Order;

use consort_dashboard::fleet_model::{FleetModel, ReachabilityState};
use consort_protocol::ledger::Alarm;
use consort_text::count;
use dialog::{Dialog, Outcome};
use ratatui::Frame;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Wrap};

/// Minimum width for two columns.
const WIDE: u16 = 110;

/// Lines for the key bindings.
const KEY_LINES: u16 = 2;

/// Lines for a dialog or a note.
const DIALOG_LINES: u16 = 4;

/// Maximum number of names in a list.
const LISTED_MAX: usize = 8;

/// A part of the screen with a selection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Panel {
    /// The robots.
    Robots,
    /// The missions.
    Missions,
    /// The bids of the latest auction of the selected mission.
    Auction,
    /// The schedules of missions. They are drawn in place of the auction while they have the focus.
    Schedules,
    /// The events.
    Log,
}

impl Panel {
    const ALL: [Panel; 5] = [Panel::Robots, Panel::Missions, Panel::Auction, Panel::Schedules, Panel::Log];
}

/// Result of a key press.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum KeyOutcome {
    /// Continue.
    Continue,
    /// Quit.
    Quit,
    /// Send an order, which the user has confirmed.
    Order(Order),
}

/// Use of colours; without them bold and reverse have the same meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColorMode {
    /// The terminal's colours.
    Color,
    /// No colours.
    Plain,
}

impl ColorMode {
    fn of(self, colour: Color) -> Style {
        match self {
            ColorMode::Color => Style::new().fg(colour),
            ColorMode::Plain => Style::new(),
        }
    }

    fn good(self) -> Style {
        self.of(Color::Green)
    }

    fn bad(self) -> Style {
        self.of(Color::Red).add_modifier(Modifier::BOLD)
    }

    fn work(self) -> Style {
        self.of(Color::Cyan)
    }

    fn faint(self) -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }
}

/// Focus and selection of the terminal interface.
#[derive(Debug)]
pub(crate) struct Tui {
    paint: ColorMode,
    focus: Panel,
    /// The selected row of each panel, in the order of [`Panel::ALL`]; the log counts from the
    /// newest.
    rows: [usize; Panel::ALL.len()],
    /// The open dialog, which takes all keys.
    dialog: Option<Dialog>,
    /// Result of the last order, until the next key outside of a dialog.
    note: Option<String>,
}

impl Tui {
    /// Creates the interface with the focus on the missions, the newest first.
    pub(crate) fn new(paint: ColorMode) -> Tui {
        Tui { paint, focus: Panel::Missions, rows: [0; Panel::ALL.len()], dialog: None, note: None }
    }

    /// Shows the result of an order until the next key outside of a dialog.
    pub(crate) fn show_note(&mut self, note: String) {
        self.note = Some(note);
    }

    /// Handles a key press.
    pub(crate) fn handle_key(&mut self, key: KeyEvent, model: &FleetModel) -> KeyOutcome {
        if key.kind == KeyEventKind::Release {
            return KeyOutcome::Continue;
        }
        if key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL) {
            return KeyOutcome::Quit;
        }
        if let Some(dialog) = &mut self.dialog {
            let outcome = dialog.handle_key(key, model);
            if outcome != Outcome::Open {
                self.dialog = None;
            }
            return match outcome {
                Outcome::Confirmed(order) => KeyOutcome::Order(order),
                Outcome::Open | Outcome::Left => KeyOutcome::Continue,
            };
        }
        self.note = None;
        let row = &mut self.rows[self.focus as usize];
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return KeyOutcome::Quit,
            KeyCode::Tab => self.focus = self.beside(1),
            KeyCode::BackTab => self.focus = self.beside(Panel::ALL.len() - 1),
            KeyCode::Down | KeyCode::Char('j') => *row = row.saturating_add(1),
            KeyCode::Up | KeyCode::Char('k') => *row = row.saturating_sub(1),
            KeyCode::PageDown => *row = row.saturating_add(10),
            KeyCode::PageUp => *row = row.saturating_sub(10),
            KeyCode::Home => *row = 0,
            _ => match Dialog::of_key(key, (self.focus, *row), model) {
                Some(Ok(dialog)) => self.dialog = Some(dialog),
                Some(Err(problem)) => self.note = Some(problem.to_string()),
                None => {}
            },
        }
        KeyOutcome::Continue
    }

    fn beside(&self, steps: usize) -> Panel {
        Panel::ALL[(self.focus as usize + steps) % Panel::ALL.len()]
    }

    /// Draws the model at `now_ms`.
    pub(crate) fn draw(&mut self, frame: &mut Frame<'_>, model: &FleetModel, now_ms: u64) {
        let foot_lines = if self.dialog.is_some() || self.note.is_some() { DIALOG_LINES } else { KEY_LINES };
        let lines = [Constraint::Length(2), Constraint::Min(0), Constraint::Length(foot_lines)];
        let [head, body, foot] = Layout::vertical(lines).areas(frame.area());
        let halves = [Constraint::Percentage(50), Constraint::Percentage(50)];
        let third = if self.focus == Panel::Schedules { Panel::Schedules } else { Panel::Auction };
        let [robots, missions, third_area, log] = if body.width >= WIDE {
            let [left, right] = Layout::horizontal(halves).areas::<2>(body);
            let [robots, log] = Layout::vertical(halves).areas(left);
            let [missions, third_area] = Layout::vertical(halves).areas(right);
            [robots, missions, third_area, log]
        } else {
            // The focused panel gets the remaining space.
            let part = |panel| if panel == self.focus { Constraint::Min(5) } else { Constraint::Length(5) };
            Layout::vertical([Panel::Robots, Panel::Missions, third, Panel::Log].map(part)).areas(body)
        };
        self.head(frame, head, model, now_ms);
        self.robots(frame, robots, model, now_ms);
        let chosen = self.missions(frame, missions, model, now_ms);
        if third == Panel::Schedules {
            self.schedules(frame, third_area, model);
        } else {
            self.auction(frame, third_area, model, chosen.as_deref());
        }
        self.log(frame, log, model, now_ms);
        let (text, style) = match (&self.dialog, &self.note) {
            (Some(dialog), _) => (dialog.text(model), Style::new().add_modifier(Modifier::BOLD)),
            (None, Some(note)) => (format!(" {note}"), Style::new().add_modifier(Modifier::BOLD)),
            (None, None) => (self.key_bindings(), self.paint.faint()),
        };
        frame.render_widget(Paragraph::new(text).style(style).wrap(Wrap { trim: false }), foot);
    }

    /// Lists the key bindings; on the second line those of orders that every panel has.
    fn key_bindings(&self) -> String {
        let of_panel = match self.focus {
            Panel::Robots => "h hold  r release  m maintenance  e end it",
            Panel::Missions => "x cancel  X cancel several  p priority  r reassign  n pin",
            Panel::Schedules => "p pause  r resume  x remove",
            Panel::Auction | Panel::Log => "",
        };
        let of_all = "H hold all  R release all  c close  o open  l limit  L clear  a alarm  A clear";
        format!(" q quit  Tab panel  {of_panel}\n {of_all}")
    }

    /// Draws the coordinator and the state of the connection; below, key figures.
    fn head(&self, frame: &mut Frame<'_>, area: Rect, model: &FleetModel, now_ms: u64) {
        let reachability = model.reachability();
        let contact = match reachability.last_contact_ms {
            Some(at) => format!("last contact with a coordinator {} ago", format_span(now_ms.saturating_sub(at))),
            None => "no contact with a coordinator yet".to_owned(),
        };
        let coordinator = match model.coordinator() {
            Some(shown) => format!("coordinator {}, term {}", shown.node, shown.term),
            None => "no coordinator is known".to_owned(),
        };
        let state = match reachability.state {
            ReachabilityState::Connected => Span::styled("live", self.paint.good()),
            ReachabilityState::NoCoordinator => {
                Span::styled(format!("NO COORDINATOR: {contact}; the data is old"), self.paint.bad())
            }
            ReachabilityState::Isolated => {
                Span::styled(format!("CUT OFF: {contact}; the data is old"), self.paint.bad())
            }
        };
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let first = Line::from_iter([Span::styled(" Consort ", bold), Span::raw(coordinator), Span::raw("   "), state]);
        let kpis = model.kpis();
        let success = kpis.success.map_or("-".to_owned(), |share| format!("{:.0} %", share * 100.0));
        let completion = kpis.completion_ms.map_or("-".to_owned(), format_span);
        let second = format!(
            " {}, {} under way, success {success}, median {completion}   {} of {} at work   {}",
            count(kpis.missions, "mission", "missions"),
            kpis.under_way,
            kpis.busy,
            count(kpis.in_service, "robot", "robots"),
            count(kpis.takeovers, "takeover", "takeovers")
        );
        let second = match alarms_text(model) {
            Some(alarms) => Line::styled(alarms, self.paint.bad()),
            None => Line::raw(second),
        };
        frame.render_widget(Paragraph::new(vec![first, second]), area);
    }
}

/// Describes the alarms in force, if there are any.
fn alarms_text(model: &FleetModel) -> Option<String> {
    let text = |alarm: &Alarm| format!(" {}; {}", alarm.text(), alarm.plan.text());
    let alarms: Vec<String> = model.alarms().values().map(text).collect();
    (!alarms.is_empty()).then(|| alarms.join(" "))
}

/// Lists names, at most [`LISTED_MAX`], as `ada, bea and 3 more`.
fn listed<T: ToString>(names: impl IntoIterator<Item = T>) -> String {
    let names: Vec<String> = names.into_iter().map(|name| name.to_string()).collect();
    match names.len().saturating_sub(LISTED_MAX) {
        0 => names.join(", "),
        more => format!("{} and {more} more", names[..LISTED_MAX].join(", ")),
    }
}

/// Formats a duration in a few characters.
fn format_span(ms: u64) -> String {
    match ms / 1000 {
        0 => format!("{ms} ms"),
        seconds @ 1..=119 => format!("{seconds} s"),
        seconds @ 120..=7199 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

#[cfg(test)]
mod tests {
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
            for part in ["coordinator ada, term 3", "lab-samples-1", "running", "4/16", "42 %", "bea", "down", "q quit"]
            {
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
            for part in ["early", "next 2026-01-01 08:00 UTC", "0 8 * *", "late", "paused by Nia", "p pause  r resume"]
            {
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
}
