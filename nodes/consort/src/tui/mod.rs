//! The fleet on a terminal: a [`FleetModel`] drawn as text, and key bindings.
//!
//! It draws cells from values, and makes orders of keys; `consort watch` reads the keys, writes to the terminal, and
//! sends the orders.

mod dialog;
mod order;
mod panels;
#[cfg(test)]
mod tests;

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
