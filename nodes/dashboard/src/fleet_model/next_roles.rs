//! Roles that robots get later, with their planned starts.

use super::state::NextRole;
use super::{FleetModel, bounds};
use consort_protocol::units::Seconds;
use consort_protocol::view::{HeldRole, PromisedRoleView};

/// Rounds to seconds: the measured rate of the world varies a little, and each change is sent.
fn whole_seconds(ms: u64) -> u64 {
    ms.saturating_add(500) / 1000 * 1000
}

impl FleetModel {
    /// Returns the promised roles of a robot in their order. A role is planned to start when the role that the robot holds and
    /// the promised roles before it have taken their estimated times.
    pub(super) fn next_roles(
        &self,
        robot: &str,
        held: Option<&HeldRole>,
        promised: Vec<PromisedRoleView>,
    ) -> Vec<NextRole> {
        let wall_ms = |time: Seconds| Some((time.get() * 1000.0 / self.world_rate.rate()?).round() as u64);
        let mut start_ms = held.and_then(|held| {
            let mission = self.missions.get(held.mission.as_str())?;
            let begun_ms = mission.assigned_from_ms(held.role.as_str(), robot)?;
            Some(begun_ms.saturating_add(held.time_s.and_then(wall_ms)?))
        });
        let next = |PromisedRoleView { mission, role, time_s }: PromisedRoleView| {
            let planned_ms = time_s.and_then(wall_ms);
            let next = NextRole {
                mission: mission.to_string(),
                role: role.to_string(),
                start_ms: start_ms.map(whole_seconds),
                planned_ms: planned_ms.map(whole_seconds),
            };
            start_ms = start_ms.zip(planned_ms).map(|(start_ms, planned_ms)| start_ms.saturating_add(planned_ms));
            next
        };
        promised.into_iter().take(bounds::NEXT_ROLES).map(next).collect()
    }
}
