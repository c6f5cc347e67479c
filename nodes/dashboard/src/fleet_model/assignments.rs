//! Role assignments over time, for the schedule chart, with their planned durations, and the roles that robots get later.

use super::state::{MissionModel, NextRole, RoleAssignment};
use super::{FleetModel, bounds};
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::RolePhase;
use consort_protocol::view::PromisedRoleView;

/// Time after a change in which a view does not change a role's holder again, in milliseconds: the
/// view may be older than the change.
const HOLDER_SETTLED_MS: u64 = 2000;

/// Maximum number of assignments of a mission.
const ASSIGNMENTS_MAX: usize = 60;

/// The robot works in the role.
const ACTIVE: &str = "active";

/// The role was completed.
const COMPLETED: &str = "completed";

/// The role was released for another robot.
pub(super) const RELEASED: &str = "released";

/// The mission ended otherwise.
const ABORTED: &str = "aborted";

/// Returns the state of an assignment after an ending.
pub(super) fn state_after(ending: EndReason) -> &'static str {
    match ending {
        EndReason::Over => COMPLETED,
        EndReason::Replaced | EndReason::Released => RELEASED,
        EndReason::Canceled | EndReason::Failed | EndReason::NeedsIntervention => ABORTED,
    }
}

impl MissionModel {
    /// Starts an assignment, unless it is known already.
    pub(super) fn start_assignment(&mut self, role: &str, by: &str, at_ms: u64) {
        if self.is_assigned(role, by) || self.ended {
            return;
        }
        self.end_assignment(role, at_ms, RELEASED);
        let (role, by, state) = (role.to_owned(), by.to_owned(), ACTIVE.to_owned());
        self.assignments.push(RoleAssignment { role, by, from_ms: at_ms, to_ms: None, state, planned_ms: None });
        if self.assignments.len() > ASSIGNMENTS_MAX {
            self.assignments.remove(0);
        }
    }

    /// Checks whether a robot has a role.
    pub(super) fn is_assigned(&self, role: &str, by: &str) -> bool {
        self.assignments
            .iter()
            .any(|assignment| assignment.to_ms.is_none() && assignment.role == role && assignment.by == by)
    }

    /// Ends the assignment of a role.
    pub(super) fn end_assignment(&mut self, role: &str, at_ms: u64, word: &str) {
        for assignment in
            self.assignments.iter_mut().filter(|assignment| assignment.to_ms.is_none() && assignment.role == role)
        {
            assignment.end(at_ms, word);
        }
    }

    /// Marks an assignment as suspended or active.
    pub(super) fn set_suspended(&mut self, role: &str, by: &str, suspended: bool) {
        let open = |assignment: &&mut RoleAssignment| {
            assignment.to_ms.is_none() && assignment.role == role && assignment.by == by
        };
        for assignment in self.assignments.iter_mut().filter(open) {
            if suspended { "suspended" } else { ACTIVE }.clone_into(&mut assignment.state);
        }
    }

    /// Ends all assignments of the mission.
    pub(super) fn end_all_assignments(&mut self, at_ms: u64, completed: bool) {
        for assignment in self.assignments.iter_mut().filter(|assignment| assignment.to_ms.is_none()) {
            assignment.end(at_ms, if completed { COMPLETED } else { ABORTED });
        }
    }

    /// Applies the role holders of the ledger, for missed events.
    pub(super) fn apply_holders(&mut self, now_ms: u64) {
        let roles: Vec<_> = self.roles.iter().map(|(role, shown)| (role.clone(), shown.clone())).collect();
        for (role, shown) in roles {
            let Some(holder) = shown.holder.filter(|_| shown.phase != RolePhase::Promised) else { continue };
            let changes = self
                .assignments
                .iter()
                .filter(|assignment| assignment.role == role)
                .map(|assignment| assignment.to_ms.unwrap_or(assignment.from_ms));
            if changes.max().is_some_and(|changed| changed + HOLDER_SETTLED_MS > now_ms) {
                continue;
            }
            if shown.phase == RolePhase::Ended {
                let last = self.bars.iter().rfind(|bar| bar.role == role && bar.by == holder);
                self.end_assignment(&role, last.and_then(|bar| bar.to_ms).unwrap_or(now_ms), COMPLETED);
            } else {
                self.start_assignment(&role, &holder, now_ms);
            }
        }
    }
}

impl RoleAssignment {
    fn end(&mut self, at_ms: u64, word: &str) {
        self.to_ms = Some(at_ms.max(self.from_ms));
        word.clone_into(&mut self.state);
    }
}

impl FleetModel {
    /// Computes the planned durations of current assignments: from the winners' bids, at the speed
    /// of their world.
    pub(super) fn update_planned_times(&mut self) {
        let unplanned = |mission: &MissionModel| mission.assignments.iter().any(RoleAssignment::lacks_plan);
        let missions: Vec<String> =
            self.missions.iter().filter(|(_, mission)| unplanned(mission)).map(|(id, _)| id.clone()).collect();
        for id in missions {
            let rounds = || self.auctions.values().filter(|auction| auction.mission == id);
            let planned_time = |assignment: &RoleAssignment| {
                let of = rounds().filter(|auction| auction.chosen.get(&assignment.role) == Some(&assignment.by));
                let latest = of.max_by_key(|auction| (auction.term, auction.round))?;
                let offer =
                    latest.offers.iter().find(|offer| offer.role == assignment.role && offer.robot == assignment.by)?;
                offer.time_s
            };
            let Some(mission) = self.missions.get(&id) else { continue };
            let found: Vec<_> = (0..)
                .zip(&mission.assignments)
                .filter(|(_, assignment)| assignment.lacks_plan())
                .filter_map(|(index, assignment): (usize, &RoleAssignment)| {
                    Some((index, self.world_rate.wall_ms(planned_time(assignment)?)?))
                })
                .collect();
            if found.is_empty() {
                continue;
            }
            let Some(mission) = self.missions.get_mut(&id) else { continue };
            for (index, planned) in found {
                mission.assignments[index].planned_ms = Some(planned);
            }
        }
    }

    /// Returns the promised roles of a robot in their order.
    pub(super) fn next_roles(&self, promised: Vec<PromisedRoleView>) -> Vec<NextRole> {
        let next = |PromisedRoleView { mission, role, planned_at_ms, time_s }: PromisedRoleView| {
            let planned_ms = time_s.and_then(|time| self.world_rate.wall_ms(time.get()));
            NextRole {
                mission: mission.to_string(),
                role: role.to_string(),
                start_ms: planned_at_ms,
                // The measured rate of the world varies a little, and each change is sent.
                planned_ms: planned_ms.map(|ms| ms.saturating_add(500) / 1000 * 1000),
            }
        };
        promised.into_iter().take(bounds::NEXT_ROLES).map(next).collect()
    }
}

impl RoleAssignment {
    fn lacks_plan(&self) -> bool {
        self.to_ms.is_none() && self.planned_ms.is_none()
    }
}

/// World seconds per second: telemetry contains the time of its world. Bids are in world seconds.
#[derive(Debug, Clone, Default)]
pub(super) struct WorldRate {
    /// A robot, its world time, and the time of the report.
    from: Option<(String, f64, u64)>,
    rate: Option<f64>,
}

impl WorldRate {
    /// Minimum time of a measurement, in milliseconds.
    const MEASURED_OVER_MS: u64 = 2000;

    /// Time without telemetry after which another robot is used, in milliseconds.
    const LOST_AFTER_MS: u64 = 10_000;

    /// Applies a robot's world time.
    pub(super) fn observe(&mut self, robot: &str, world_s: f64, now_ms: u64) {
        match &self.from {
            Some((known, from_s, from_ms)) if known == robot && world_s >= *from_s => {
                let passed = now_ms.saturating_sub(*from_ms);
                if passed < WorldRate::MEASURED_OVER_MS {
                    return;
                }
                let rate = (world_s - from_s) * 1000.0 / passed as f64;
                self.rate = (rate > 0.0).then_some(rate);
            }
            Some((known, _, from_ms)) if known != robot && now_ms < from_ms + WorldRate::LOST_AFTER_MS => return,
            // The first robot, or a world that was restarted.
            Some(_) | None => {}
        }
        self.from = Some((robot.to_owned(), world_s, now_ms));
    }

    /// Returns how long a time of the world takes, in milliseconds; `None` before the rate is measured.
    pub(super) fn wall_ms(&self, world_s: f64) -> Option<u64> {
        Some((world_s * 1000.0 / self.rate?).round() as u64)
    }
}
