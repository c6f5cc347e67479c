//! The fleet on a terminal: a [`Picture`] drawn as text, and what keys do.
//!
//! Values in, cells out: who reads keys and writes to the terminal is `consort watch`.

mod panels;

use crate::fleet_model::{FleetModel, ReachabilityState};
use consort_protocol::count::count;
use ratatui::Frame;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};

/// From this width on there is room for two columns.
const WIDE: u16 = 110;

/// What the keys do, for the last line.
const KEYS: &str = " q quit   Tab next panel   ↑ ↓ PgUp PgDn move   the auction is that of the mission chosen";

/// A part of the screen that can be moved in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Panel {
    /// The robots.
    Robots,
    /// The missions.
    Missions,
    /// The answers of the latest auction of the chosen mission.
    Auction,
    /// What happened.
    Log,
}

impl Panel {
    const ALL: [Panel; 4] = [Panel::Robots, Panel::Missions, Panel::Auction, Panel::Log];
}

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyOutcome {
    /// To go on.
    Continue,
    /// To end.
    Quit,
}

/// Whether colours may be used; without them bold and reverse say the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColorMode {
    /// The terminal's colours.
    Color,
    /// None.
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

/// Where somebody who looks is.
#[derive(Debug)]
pub struct Tui {
    paint: ColorMode,
    focus: Panel,
    /// The row chosen in each panel, in the order of [`Panel::ALL`]; in the log it counts from the newest.
    rows: [usize; 4],
}

impl Tui {
    /// At the missions, the newest first.
    pub fn new(paint: ColorMode) -> Tui {
        Tui { paint, focus: Panel::Missions, rows: [0; 4] }
    }

    /// Does what a key asks for.
    pub fn handle_key(&mut self, key: KeyEvent) -> KeyOutcome {
        if key.kind == KeyEventKind::Release {
            return KeyOutcome::Continue;
        }
        let row = &mut self.rows[self.focus as usize];
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return KeyOutcome::Quit,
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return KeyOutcome::Quit,
            KeyCode::Tab => self.focus = self.beside(1),
            KeyCode::BackTab => self.focus = self.beside(Panel::ALL.len() - 1),
            KeyCode::Down | KeyCode::Char('j') => *row = row.saturating_add(1),
            KeyCode::Up | KeyCode::Char('k') => *row = row.saturating_sub(1),
            KeyCode::PageDown => *row = row.saturating_add(10),
            KeyCode::PageUp => *row = row.saturating_sub(10),
            KeyCode::Home => *row = 0,
            _ => {}
        }
        KeyOutcome::Continue
    }

    fn beside(&self, steps: usize) -> Panel {
        Panel::ALL[(self.focus as usize + steps) % Panel::ALL.len()]
    }

    /// Draws the picture as it is at `now_ms`.
    pub fn draw(&mut self, frame: &mut Frame<'_>, picture: &FleetModel, now_ms: u64) {
        let lines = [Constraint::Length(2), Constraint::Min(0), Constraint::Length(1)];
        let [head, body, foot] = Layout::vertical(lines).areas(frame.area());
        let halves = [Constraint::Percentage(50), Constraint::Percentage(50)];
        let [robots, missions, auction, log] = if body.width >= WIDE {
            let [left, right] = Layout::horizontal(halves).areas::<2>(body);
            let [robots, log] = Layout::vertical(halves).areas(left);
            let [missions, auction] = Layout::vertical(halves).areas(right);
            [robots, missions, auction, log]
        } else {
            // The one that is looked at gets what the others leave.
            let part = |panel| if panel == self.focus { Constraint::Min(5) } else { Constraint::Length(5) };
            Layout::vertical(Panel::ALL.map(part)).areas(body)
        };
        self.head(frame, head, picture, now_ms);
        self.robots(frame, robots, picture, now_ms);
        let chosen = self.missions(frame, missions, picture, now_ms);
        self.auction(frame, auction, picture, chosen.as_deref());
        self.log(frame, log, picture, now_ms);
        frame.render_widget(Line::styled(KEYS, self.paint.faint()), foot);
    }

    /// Who coordinates, and whether what is shown is up to date; below, figures.
    fn head(&self, frame: &mut Frame<'_>, area: Rect, picture: &FleetModel, now_ms: u64) {
        let reach = picture.reach();
        let heard = match reach.heard_ms {
            Some(at) => format!("a coordinator was last heard {} ago", format_span(now_ms.saturating_sub(at))),
            None => "no coordinator was heard yet".to_owned(),
        };
        let who = match picture.coordinator() {
            Some(shown) => format!("{} coordinates, term {}", shown.node, shown.term),
            None => "nobody is known to coordinate".to_owned(),
        };
        let state = match reach.state {
            ReachabilityState::Whole => Span::styled("live", self.paint.good()),
            ReachabilityState::Silent => {
                Span::styled(format!("NO COORDINATOR: {heard}; what is shown is old"), self.paint.bad())
            }
            ReachabilityState::Alone => {
                Span::styled(format!("CUT OFF: {heard}; what is shown is old"), self.paint.bad())
            }
        };
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let first = Line::from_iter([Span::styled(" Consort ", bold), Span::raw(who), Span::raw("   "), state]);
        let kpis = picture.kpis();
        let success = kpis.success.map_or("-".to_owned(), |share| format!("{:.0} %", share * 100.0));
        let conclude = kpis.conclude_ms.map_or("-".to_owned(), format_span);
        let second = format!(
            " {}, {} under way, success {success}, median {conclude}   {} of {} at work   {}",
            count(kpis.missions, "mission", "missions"),
            kpis.under_way,
            kpis.busy,
            count(kpis.in_service, "robot", "robots"),
            count(kpis.takeovers, "takeover", "takeovers")
        );
        frame.render_widget(ratatui::widgets::Paragraph::new(vec![first, Line::raw(second)]), area);
    }
}

/// A span of time in a few characters.
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
    use crate::fleet_model::FloorPlan;
    use consort_protocol::event::{Event, EventKind};
    use consort_protocol::keys::Key;
    use consort_protocol::ledger::MissionState;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use serde_json::json;

    const NOW_MS: u64 = 100_000;

    /// A fleet of two robots and one mission, as a coordinator shows it.
    fn picture() -> FleetModel {
        let mut picture = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
        let worker = json!({ "skills": ["navigation"], "place": "Dock", "pose": { "x": 0.0, "y": 0.0, "yaw": 0.0 },
            "battery": 0.42, "discharge": 0.0001, "useful_charge": 0.1, "speed": 0.5, "availability": "free",
            "estimator": "standard" });
        let node = |name: &str, alive: bool| {
            json!({ "node": name, "alive": alive, "status": if alive { "alive" } else { "down" }, "age_ms": 100,
                "may_vote": true, "stationary": false, "mains_powered": false, "leaving": false, "robot": worker })
        };
        picture.apply_view(&Key::ViewFleet, &json!({ "nodes": [node("ada", true), node("bea", false)] }), NOW_MS);
        let coordinator = json!({ "node": "ada", "term": 3, "since_ms": 1000, "voters": ["ada"], "observers": [] });
        picture.apply_view(&Key::ViewCoordinator, &coordinator, NOW_MS);
        let mission = json!({ "mission": "lab-samples-1", "state": "running", "detail": "running", "done": 4, "steps": 16,
            "holders": { "r1": "ada" }, "parameters": {}, "priority": 0, "submitted_at_ms": 40_000 });
        picture.apply_view(&Key::ViewMissions, &json!({ "missions": [mission] }), NOW_MS);
        picture
    }

    fn drawn(screen: &mut Tui, picture: &FleetModel, width: u16, height: u16) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| screen.draw(frame, picture, NOW_MS)).unwrap();
        terminal.backend().to_string()
    }

    fn press(screen: &mut Tui, code: KeyCode) -> KeyOutcome {
        screen.handle_key(KeyEvent::new(code, KeyModifiers::NONE))
    }

    #[test]
    fn the_fleet_is_on_one_screen() {
        for (width, height) in [(140, 40), (80, 24)] {
            let text = drawn(&mut Tui::new(ColorMode::Plain), &picture(), width, height);
            for part in ["ada coordinates, term 3", "lab-samples-1", "running", "4/16", "42 %", "bea", "down", "q quit"]
            {
                assert!(text.contains(part), "{part} is not on {width}x{height}:\n{text}");
            }
        }
    }

    #[test]
    fn a_fleet_that_is_no_longer_heard_is_said_to_be_so() {
        let mut picture = picture();
        picture.apply_links(0, NOW_MS + 10_000);
        let text = drawn(&mut Tui::new(ColorMode::Plain), &picture, 140, 40);
        assert!(text.contains("what is shown is old"), "{text}");
    }

    #[test]
    fn what_happens_is_in_the_log_with_the_newest_at_the_top() {
        let mut picture = picture();
        for (sequence, state) in [(1, MissionState::Running), (2, MissionState::Completed)] {
            let mission = "lab-samples-1".parse().unwrap();
            let what = EventKind::Mission { mission, state, submitted_at_ms: 0 };
            let event = Event { node: "ada".parse().unwrap(), sequence, at_ms: NOW_MS, kind: what };
            picture.apply_event(&event, NOW_MS);
        }
        let text = drawn(&mut Tui::new(ColorMode::Plain), &picture, 140, 40);
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
        drawn(&mut screen, &picture(), 140, 40);
        assert_eq!(screen.rows[0], 1, "there are two robots");
        press(&mut screen, KeyCode::Up);
        press(&mut screen, KeyCode::Up);
        assert_eq!(screen.rows[0], 0);
        assert_eq!(press(&mut screen, KeyCode::Char('q')), KeyOutcome::Quit);
        let control_c = KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(screen.handle_key(control_c), KeyOutcome::Quit);
    }

    #[test]
    fn nothing_and_no_room_are_drawn_too() {
        let nothing = FleetModel::new("ward", "desk", FloorPlan::default(), 0);
        let text = drawn(&mut Tui::new(ColorMode::Color), &nothing, 120, 30);
        assert!(text.contains("nobody is known to coordinate"), "{text}");
        drawn(&mut Tui::new(ColorMode::Color), &picture(), 1, 1);
    }
}
