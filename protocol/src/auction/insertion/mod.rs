//! Insertion of a role in the timeline of a robot.
//!
//! A robot that has promised roles bids for another at the best position among them. Its timeline is a [`Timeline`]:
//! a role that waits for others has an estimated release, before which its robot does not begin; the latest begin of a promised
//! role is its begin without the new role, plus the time by which it may still be delayed. The marginal cost of a position is the increase of the sum of the ends of all roles,
//! and of the energy:
//!
//! ```text
//!   before:  held ─┤ a ├─┤ b ├                  cost after - cost before
//!   after:   held ─┤ a ├─┤ new ├─┤ b ├            = end of new + delay of b
//! ```

use super::charging_stop::ChargingStop;
use crate::bounds::{self, ELEMENTS_MAX};
use crate::ids::{MissionId, PlaceId, RobotId, RoleId};
use crate::mission::ROLES_MAX;
use crate::timeline::{Job, Timeline, Travel, Window};
use crate::units::{Energy, Seconds, SharePerSecond};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Seconds for which a full battery counts with [`Objective::LeastEnergy`]: time decides between equal energies only.
const BATTERY_S: f64 = 1e6;

/// Objective by which robots insert roles in their timelines, and by which the coordinator chooses among their bids.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Objective {
    /// The least sum of the ends of all roles.
    #[default]
    EarliestEnd,
    /// The least energy.
    LeastEnergy,
    /// The least sum of ends and energy.
    Weighted {
        /// Seconds for which a full battery counts.
        battery_s: Seconds,
    },
}

impl Objective {
    /// Returns the cost in seconds of a time in seconds and an energy in full batteries.
    pub fn cost(self, time_s: f64, energy: f64) -> f64 {
        let battery_s = match self {
            Objective::EarliestEnd => 0.0,
            Objective::LeastEnergy => BATTERY_S,
            Objective::Weighted { battery_s } => battery_s.get(),
        };
        time_s + energy * battery_s
    }
}

/// Places, time and energy of the tasks of a role, without the first drive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RoleSpan {
    /// Destination of the first drive; `None` if the robot does not drive first.
    pub from: Option<PlaceId>,
    /// Place where the role ends; `None` if the robot does not drive.
    pub to: Option<PlaceId>,
    /// Estimated time.
    pub time: Seconds,
    /// Estimated energy.
    pub energy: Energy,
}

/// Role of a mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RoleOfMission {
    /// The mission.
    pub mission: MissionId,
    /// The role.
    pub role: RoleId,
}

/// Role that a robot has promised.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PromisedRole {
    /// The robot.
    pub robot: RobotId,
    /// The role.
    pub role: RoleOfMission,
    /// Its tasks.
    pub span: RoleSpan,
    /// Time by which the role may be delayed; `None` for any. Such roles are the last ones: their missions have a lower
    /// priority.
    pub slack: Option<Seconds>,
    /// Estimated time until it can begin, by what others do before; 0 if it can begin, or if that is unknown.
    pub release: Seconds,
    /// The robot has to charge before it.
    pub charges: bool,
}

/// Timelines of the robots of a fleet, as a call for bids contains them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Timelines {
    /// Objective of insertions.
    pub objective: Objective,
    /// Promised roles, those of each robot in their order. A robot that is not contained bids for the time after all
    /// that it has promised.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub promised: Vec<PromisedRole>,
    /// Roles of the call that can start now. A free robot bids for such a role before all that it has promised, since its
    /// promised roles cannot start yet.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub startable: BTreeSet<RoleId>,
    /// Time until the deadline of the mission; `None` without one.
    pub ends_within: Option<Seconds>,
    /// Estimated time until roles of the call can begin, by what others do before, as far as it is known.
    #[serde(deserialize_with = "bounds::collection::<_, _, ROLES_MAX>")]
    pub releases: BTreeMap<RoleId, Seconds>,
}

/// Position of a role in the timeline of a robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlannedRole {
    /// Its tasks.
    pub span: RoleSpan,
    /// Time until the robot begins it: the robot is free, and the role is released.
    pub start: Seconds,
    /// The promised role that follows; `None` if it comes last.
    pub before: Option<RoleOfMission>,
    /// Time by which each promised role after it ends later at most.
    pub delay: Seconds,
    /// Number of those roles.
    pub delayed: u32,
    /// Time by which a promised role may be delayed, by all insertions before it. Set by the coordinator.
    pub delay_max: Seconds,
    /// Number of all promised roles of the timeline.
    pub promised: u32,
    /// Estimated energy of the promised roles, with the drives to them, except for those of a lower priority.
    pub energy: Energy,
    /// Additional energy of the drives to promised roles, as a share of a full battery; negative if they are shorter.
    pub detour_energy: f64,
    /// Stop at a charger before the role. The span and the start contain its time.
    #[serde(default)]
    pub charging: Option<ChargingStop>,
}

impl PlannedRole {
    /// Returns the position of a role in a timeline without promised roles.
    pub fn alone(span: RoleSpan, start: Seconds) -> PlannedRole {
        PlannedRole {
            span,
            start,
            before: None,
            delay: Seconds::ZERO,
            delayed: 0,
            delay_max: Seconds::ZERO,
            promised: 0,
            energy: Energy::ZERO,
            detour_energy: 0.0,
            charging: None,
        }
    }

    /// Returns the sum of the times by which promised roles end later, in seconds.
    pub fn delay_sum_s(&self) -> f64 {
        self.delay.get() * f64::from(self.delayed)
    }
}

/// State in which the timeline of a robot begins.
#[derive(Debug, Clone, Copy)]
pub struct TimelineStart<'a> {
    /// Place where the robot is free.
    pub place: &'a PlaceId,
    /// Time until then.
    pub time: Seconds,
    /// Discharge while it drives.
    pub discharge: SharePerSecond,
    /// The role comes before all promised roles: it can start, and they cannot.
    pub comes_first: bool,
    /// Time by which the role should end; `None` for any.
    pub ends_within: Option<Seconds>,
    /// Time before which the role cannot begin.
    pub release: Seconds,
}

impl TimelineStart<'_> {
    /// Returns the time at which the robot begins the role if it does nothing else before.
    pub fn begin(&self) -> Seconds {
        if self.release > self.time { self.release } else { self.time }
    }
}

/// Best insertion of a role.
#[derive(Debug, Clone, PartialEq)]
pub struct RoleInsertion {
    /// Place where the robot is free for the role.
    pub from: PlaceId,
    /// Place where the promised roles after it end, except for those of a lower priority; `None` without any, or if they do not
    /// say.
    pub ends_at: Option<PlaceId>,
    /// Position of the role.
    pub planned: PlannedRole,
}

/// Returns the insertion of a role with the least marginal cost, among those with which it ends in time, if there are any; the
/// last of those that are equal to a millisecond, which delays the fewest roles. Returns `None` without a position at which all
/// roles can be reached, and before all roles of a lower priority.
pub fn insert_role(
    start: TimelineStart<'_>,
    promised: &[&PromisedRole],
    span: RoleSpan,
    objective: Objective,
    travel: &impl Travel<PlaceId>,
) -> Option<RoleInsertion> {
    let (travel, discharge) = (Drives(travel), start.discharge.get());
    let empty = || Timeline::new(Some(start.place.clone()), start.time.get());
    let jobs: Vec<Job<usize, Option<PlaceId>>> =
        promised.iter().enumerate().map(|(index, promised)| job(index, &promised.span, promised.release)).collect();
    let planned = empty().with_jobs(jobs, &travel);
    let promise = |((job, begin_s), promised): ((&Job<usize, Option<PlaceId>>, f64), &&PromisedRole)| {
        let slack = promised.slack.filter(|_| !start.comes_first);
        let latest_s = slack.map_or(f64::INFINITY, |slack| begin_s + slack.get());
        Job { window: Window { latest_s, ..Window::ANY }, ..job.clone() }
    };
    let jobs: Vec<_> = planned.begins().zip(promised).map(promise).collect();
    let timeline = empty().with_jobs(jobs, &travel);
    let delayed = |position: usize| u32::try_from(promised.len() - position).unwrap_or(u32::MAX);
    let before_lower = promised.iter().position(|promised| promised.slack.is_none()).unwrap_or(promised.len());
    let last = if start.comes_first { 0 } else { before_lower };
    let new = job(promised.len(), &span, start.release);
    let found = timeline.cheapest_insertion(&new, &travel, |found| {
        let delays_s = found.delay_s * f64::from(delayed(found.position));
        let energy = span.energy.get() + discharge * found.added_travel_s;
        let ends_s = found.begin_s + span.time.get();
        let is_late = start.ends_within.is_some_and(|within| ends_s > within.get());
        let cost = objective.cost(ends_s + delays_s, energy);
        (found.position > last, is_late, (cost * 1e3).round(), delayed(found.position))
    });
    let found = found.filter(|found| found.position <= last)?;
    let ended = found.position.checked_sub(1).and_then(|last| timeline.begins().nth(last));
    let free_s = ended.map_or(start.time.get(), |(job, begin_s)| begin_s + job.duration_s);
    let free = Some(start.place.clone());
    let detour_s = found.added_travel_s - travel.seconds(ended.map_or(&free, |(job, _)| &job.to), &new.from);
    // The energy of roles of a lower priority is left out: they wait if the charge is too low for them.
    let kept = &promised[..before_lower];
    let kept_jobs = timeline.jobs().take(before_lower).cloned();
    let ways_s = empty().with_jobs(kept_jobs, &travel).travel_s(&travel);
    let driven_s = ways_s + if found.position < before_lower { detour_s } else { 0.0 };
    let energy_kept: f64 = kept.iter().map(|promised| promised.span.energy.get()).sum();
    let planned = PlannedRole {
        start: Seconds::new(free_s.max(start.release.get())).ok()?,
        before: promised.get(found.position).map(|next| next.role.clone()),
        delay: Seconds::new(found.delay_s).ok()?,
        delayed: delayed(found.position),
        delay_max: Seconds::ZERO,
        promised: delayed(0),
        energy: Energy::of_share(energy_kept + discharge * driven_s),
        detour_energy: discharge * detour_s,
        charging: None,
        span,
    };
    let end_of = |roles: &[&PromisedRole]| roles.iter().rev().find_map(|role| role.span.to.clone());
    let from = end_of(&promised[..found.position]).unwrap_or_else(|| start.place.clone());
    Some(RoleInsertion { from, ends_at: end_of(&kept[found.position..]), planned })
}

/// State of a robot after the roles that it has promised, except for those of a lower priority.
#[derive(Debug, Clone, PartialEq)]
pub struct TimelineEnd {
    /// Place where the robot is.
    pub place: PlaceId,
    /// Time until then.
    pub time: Seconds,
    /// Energy of these roles, with the drives to them.
    pub energy: Energy,
    /// The first promised role of a lower priority.
    pub before: Option<RoleOfMission>,
    /// Number of promised roles of a lower priority.
    pub delayed: u32,
}

/// Returns the state of a robot after its promised roles; `None` if they cannot be reached.
pub fn end_of_promised(
    start: TimelineStart<'_>,
    promised: &[&PromisedRole],
    travel: &impl Travel<PlaceId>,
) -> Option<TimelineEnd> {
    let before_lower = promised.iter().position(|promised| promised.slack.is_none()).unwrap_or(promised.len());
    let (kept, lower) = promised.split_at(before_lower);
    let travel = Drives(travel);
    let jobs = kept.iter().enumerate().map(|(index, promised)| job(index, &promised.span, promised.release));
    let timeline = Timeline::new(Some(start.place.clone()), start.time.get()).with_jobs(jobs, &travel);
    let energy: f64 = kept.iter().map(|promised| promised.span.energy.get()).sum();
    let ends_at = kept.iter().rev().find_map(|promised| promised.span.to.clone());
    Some(TimelineEnd {
        place: ends_at.unwrap_or_else(|| start.place.clone()),
        time: Seconds::new(timeline.free_from_s()).ok()?,
        energy: Energy::of_share(energy + start.discharge.over(Seconds::new(timeline.travel_s(&travel)).ok()?)),
        before: lower.first().map(|next| next.role.clone()),
        delayed: u32::try_from(lower.len()).unwrap_or(u32::MAX),
    })
}

fn job(key: usize, span: &RoleSpan, release: Seconds) -> Job<usize, Option<PlaceId>> {
    let RoleSpan { from, to, time, .. } = span;
    Job { to: to.clone(), duration_s: time.get(), release_s: release.get(), ..Job::at(key, from.clone()) }
}

/// Drives between the places of roles. Without a place the robot does not drive.
struct Drives<'a, T>(&'a T);

impl<T: Travel<PlaceId>> Travel<Option<PlaceId>> for Drives<'_, T> {
    fn seconds(&self, from: &Option<PlaceId>, to: &Option<PlaceId>) -> f64 {
        from.as_ref().zip(to.as_ref()).map_or(0.0, |(from, to)| self.0.seconds(from, to))
    }
}

#[cfg(test)]
mod tests;
