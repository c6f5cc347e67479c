//! The panels.

use super::{Panel, Tui, format_span};
use consort_dashboard::fleet_model::{
    AuctionModel, FleetModel, MissionModel, RobotModel, ScheduleModel, schedule_state,
};
use ratatui::Frame;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Modifier, Style};
use ratatui::widgets::{Block, Cell, Row, Table, TableState};
use std::cmp::Reverse;

/// Returns the missions in the order of their rows: the latest first.
pub(super) fn latest_missions(model: &FleetModel) -> Vec<(&String, &MissionModel)> {
    let mut missions: Vec<(&String, &MissionModel)> = model.missions().iter().collect();
    missions.sort_by_key(|(id, mission)| Reverse((mission.number, mission.submitted_ms, (*id).clone())));
    missions
}

impl Tui {
    /// Draws rows under their headings, with a selected row; a selection beyond the last row is
    /// moved to it.
    fn table(
        &mut self,
        frame: &mut Frame<'_>,
        area: Rect,
        panel: Panel,
        (title, heads, widths): (String, &[&'static str], &[Constraint]),
        rows: Vec<Row<'static>>,
    ) {
        let focused = self.focus == panel;
        let selected = &mut self.rows[panel as usize];
        *selected = (*selected).min(rows.len().saturating_sub(1));
        let mut state = TableState::new().with_selected((!rows.is_empty()).then_some(*selected));
        let bold = Style::new().add_modifier(Modifier::BOLD);
        let border = if focused { self.paint.work().add_modifier(Modifier::BOLD) } else { self.paint.faint() };
        let block = Block::bordered().title(title).border_style(border);
        let shown = if focused { Style::new().add_modifier(Modifier::REVERSED) } else { Style::new() };
        let head = Row::new(heads.iter().map(|head| Cell::from(*head).style(bold)));
        let table = Table::new(rows, widths.iter().copied()).header(head).block(block).row_highlight_style(shown);
        frame.render_stateful_widget(table, area, &mut state);
    }

    pub(super) fn robots(&mut self, frame: &mut Frame<'_>, area: Rect, model: &FleetModel, now_ms: u64) {
        let paint = self.paint;
        let row = |(name, robot): (&String, &RobotModel)| {
            let (state, style) = match (robot.alive, &robot.problem, &robot.task) {
                (false, ..) => ("down".to_owned(), paint.bad()),
                (_, Some(problem), _) => (problem.clone(), paint.bad()),
                (_, _, Some(task)) => (task.clone(), paint.work()),
                (_, _, None) => (robot.availability.clone(), Style::new()),
            };
            let short = robot.battery <= robot.useful_charge;
            let battery = Cell::from(format!("{:.0} %", robot.battery * 100.0));
            let to = robot.destination.as_ref().map(|to| format!(" → {to}")).unwrap_or_default();
            Row::new([
                Cell::from(name.clone()),
                Cell::from(state).style(style),
                if short { battery.style(paint.bad()) } else { battery },
                Cell::from(format!("{}{to}", robot.place)),
                Cell::from(robot.mission.clone().unwrap_or_else(|| "-".to_owned())),
                Cell::from(format_span(
                    now_ms.saturating_sub(robot.telemetry_ms.unwrap_or(0).max(robot.last_contact_ms)),
                )),
            ])
        };
        let rows = model.robots().iter().map(row).collect();
        let heads = ["ROBOT", "DOES", "BATTERY", "PLACE", "MISSION", "AGE"];
        let widths = [
            Constraint::Max(12),
            Constraint::Fill(2),
            Constraint::Length(7),
            Constraint::Fill(2),
            Constraint::Fill(1),
            Constraint::Length(6),
        ];
        self.table(frame, area, Panel::Robots, (" Robots ".to_owned(), &heads, &widths), rows);
    }

    /// Draws the missions, and returns the selected mission.
    pub(super) fn missions(
        &mut self,
        frame: &mut Frame<'_>,
        area: Rect,
        model: &FleetModel,
        now_ms: u64,
    ) -> Option<String> {
        let paint = self.paint;
        let missions = latest_missions(model);
        let row = |(id, mission): &(&String, &MissionModel)| {
            let style = match mission.state.as_str() {
                "completed" => paint.good(),
                "failed" | "needs_intervention" => paint.bad(),
                "running" => paint.work(),
                _ => Style::new(),
            };
            let why =
                mission.cause.as_ref().or(mission.pending_reason.as_ref()).filter(|_| mission.state != "completed");
            // Holders, and orders of people about roles.
            let roles = mission.holders.iter().chain(&mission.orders).map(|(role, text)| format!("{role}: {text}"));
            let detail = why.cloned().unwrap_or_else(|| roles.collect::<Vec<_>>().join(", "));
            let until = mission.ended_ms.unwrap_or(now_ms);
            Row::new([
                Cell::from((*id).clone()),
                Cell::from(mission.state.clone()).style(style),
                Cell::from(format!("{}/{}", mission.done, mission.steps)),
                Cell::from(format_span(until.saturating_sub(mission.submitted_ms))),
                Cell::from(detail),
            ])
        };
        let rows = missions.iter().map(row).collect();
        let heads = ["MISSION", "STATE", "STEPS", "TIME", "ROBOTS, OR WHY"];
        let widths = [
            Constraint::Max(20),
            Constraint::Length(12),
            Constraint::Length(7),
            Constraint::Length(7),
            Constraint::Fill(1),
        ];
        self.table(frame, area, Panel::Missions, (" Missions ".to_owned(), &heads, &widths), rows);
        missions.get(self.rows[Panel::Missions as usize]).map(|(id, _)| (*id).clone())
    }

    pub(super) fn auction(&mut self, frame: &mut Frame<'_>, area: Rect, model: &FleetModel, mission: Option<&str>) {
        let paint = self.paint;
        let of_mission = model.auctions().values().filter(|auction| Some(auction.mission.as_str()) == mission);
        let auction = of_mission.max_by_key(|auction| (auction.term, auction.round));
        let title = match auction {
            Some(AuctionModel { mission, round, failure: None, .. }) => {
                format!(" Auction of {mission}, round {round} ")
            }
            Some(AuctionModel { mission, round, failure: Some(why), .. }) => {
                format!(" Auction of {mission}, round {round}: {why} ")
            }
            None => " Auction ".to_owned(),
        };
        let rows = auction.into_iter().flat_map(|auction| &auction.offers).map(|offer| {
            let (verdict, style) = match (offer.chosen, offer.verdict.as_str()) {
                (true, _) => ("won", paint.good()),
                (false, "bid") => ("outbid", Style::new()),
                (false, other) => (other, paint.faint()),
            };
            let time = offer.time_s.map_or("-".to_owned(), |time| format!("{time:.0} s"));
            let left = offer.remaining.map_or("-".to_owned(), |left| format!("{:.0} %", left * 100.0));
            Row::new([
                Cell::from(offer.role.clone()),
                Cell::from(offer.robot.clone()),
                Cell::from(verdict.to_owned()).style(style),
                Cell::from(time),
                Cell::from(left),
                Cell::from(offer.why.clone().unwrap_or_default()),
            ])
        });
        let rows = rows.collect();
        let heads = ["ROLE", "ROBOT", "ANSWER", "TIME", "LEFT", "WHY"];
        let widths = [
            Constraint::Max(12),
            Constraint::Max(12),
            Constraint::Length(8),
            Constraint::Length(6),
            Constraint::Length(5),
            Constraint::Fill(1),
        ];
        self.table(frame, area, Panel::Auction, (title, &heads, &widths), rows);
    }

    pub(super) fn schedules(&mut self, frame: &mut Frame<'_>, area: Rect, model: &FleetModel) {
        let paint = self.paint;
        let row = |(name, ScheduleModel { view, .. }): (&String, &ScheduleModel)| {
            let style = if view.pause.is_some() { paint.bad() } else { Style::new() };
            Row::new([
                Cell::from(name.clone()),
                Cell::from(view.mission.to_string()),
                Cell::from(schedule_state(view)).style(style),
                Cell::from(format!("{} {}", view.cron, view.zone)),
            ])
        };
        let rows = model.schedules().iter().map(row).collect();
        let heads = ["SCHEDULE", "MISSION", "STATE", "TIMES"];
        let widths = [Constraint::Length(12), Constraint::Length(14), Constraint::Length(26), Constraint::Fill(1)];
        self.table(frame, area, Panel::Schedules, (" Schedules ".to_owned(), &heads, &widths), rows);
    }

    pub(super) fn log(&mut self, frame: &mut Frame<'_>, area: Rect, model: &FleetModel, now_ms: u64) {
        let paint = self.paint;
        let rows = model.log().values().rev().map(|logged| {
            Row::new([
                Cell::from(format_span(now_ms.saturating_sub(logged.at_ms))),
                Cell::from(logged.label.clone()).style(if logged.alarm { paint.bad() } else { Style::new() }),
                Cell::from(logged.node.clone()),
                Cell::from(logged.text.clone()),
            ])
        });
        let rows = rows.collect();
        let widths = [Constraint::Length(7), Constraint::Max(14), Constraint::Max(12), Constraint::Fill(1)];
        self.table(frame, area, Panel::Log, (" Log ".to_owned(), &["AGO", "WHAT", "NODE", ""], &widths), rows);
    }
}
