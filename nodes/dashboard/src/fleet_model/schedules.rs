//! Schedules of the model, with their next occurrences.

use super::{FleetModel, bounds};
use consort_fleet::recurrence::{Recurrence, time_in_zone};
use consort_protocol::ledger::{Schedule, ScheduleRule};
use consort_protocol::view::{ScheduleView, SchedulesView};
use serde::Serialize;

/// Time after the next occurrence of a schedule within which its further occurrences are shown, in milliseconds:
/// a week.
const SHOWN_MS: u64 = 7 * 24 * 3_600_000;

/// A schedule.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScheduleModel {
    /// The schedule.
    #[serde(flatten)]
    pub view: ScheduleView,
    /// Its next occurrences in milliseconds since 1970; none if it is paused, or has ended.
    pub upcoming_ms: Vec<u64>,
}

impl ScheduleModel {
    fn of(view: ScheduleView) -> ScheduleModel {
        let ScheduleView { cron, zone, until_ms, missed, .. } = &view;
        let rule = ScheduleRule { cron: cron.clone(), zone: zone.clone(), until_ms: *until_ms, missed: *missed };
        // A later release may have rules that this one cannot read.
        let recurrence = Recurrence::parse(&rule).ok();
        let upcoming = std::iter::successors(view.next_ms, |after| recurrence.as_ref()?.next_after(*after));
        let last_ms = view.next_ms.map_or(0, |next| next.saturating_add(SHOWN_MS));
        let upcoming_ms = upcoming.take_while(|time| *time < last_ms).take(bounds::OCCURRENCES).collect();
        ScheduleModel { view, upcoming_ms }
    }
}

/// Describes the next occurrence of a schedule, or why there is none: `next 2026-11-27 08:00 CET`.
pub fn schedule_state(view: &ScheduleView) -> String {
    match (&view.pause, view.next_ms) {
        (Some(pause), _) => format!("paused by {} since {}", pause.by, time_in_zone(pause.since_ms, &view.zone)),
        (None, Some(next_ms)) => format!("next {}", time_in_zone(next_ms, &view.zone)),
        (None, None) => "no further occurrence".to_owned(),
    }
}

impl FleetModel {
    /// Applies the view of the schedules. The occurrences of an unchanged schedule are kept.
    pub(super) fn take_schedules(&mut self, view: SchedulesView) {
        let models = view.schedules.into_iter().take(Schedule::MAX).map(|view| {
            let name = view.schedule.to_string();
            let known = self.schedules.get(&name).filter(|known| known.view == view).cloned();
            (name, known.unwrap_or_else(|| ScheduleModel::of(view)))
        });
        let models = models.collect();
        self.schedules.replace(models);
    }
}
