//! Text of schedules, with a line for each action.

use super::person_action::{
    ALL_ROBOTS, CancelSelection, ClosureAction, IN_ZONE, MissionAction, OrderAction, SpeedLimitAction,
};
use super::schedule::{ChaosAction, DiskAfterCrash, Schedule, ScheduledAction, SkillFault};
use crate::disk::DiskFault;
use consort_protocol::api::{AlarmAction, ScheduleAction};
use consort_protocol::trust::NodeRole;
use std::fmt::{self, Display};
use std::time::Duration;

impl Display for Schedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.chargers > 0 {
            let stops = if self.plans_stops { ", at which robots plan stops" } else { "" };
            writeln!(f, "chargers: {}{stops}", self.chargers)?;
        }
        if self.small_limits {
            writeln!(f, "the smallest limits")?;
        }
        self.steps.iter().try_for_each(|step| writeln!(f, "{step}"))
    }
}

impl Display for ScheduledAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at = Duration::from_millis(self.at_ms).as_secs_f64();
        write!(f, "{at:8.3}  {}", self.action)
    }
}

/// Duration in milliseconds, formatted in seconds.
struct For(u64);

impl Display for For {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "for {:.3} s", Duration::from_millis(self.0).as_secs_f64())
    }
}

impl Display for ChaosAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fate = |disk: &DiskAfterCrash| match disk {
            DiskAfterCrash::Kept => "its disk kept",
            DiskAfterCrash::Torn => "its last unsynced writes lost",
            DiskAfterCrash::Damaged => "its store damaged",
            DiskAfterCrash::Empty => "its disk lost",
        };
        match self {
            ChaosAction::Submit { request, unnamed, mission, room, priority, deadline_s } => {
                let unnamed = if *unnamed { ", which is not named" } else { "" };
                write!(f, "request {request}{unnamed}: {mission} from {room}, priority {priority}")?;
                deadline_s.map_or(Ok(()), |seconds| write!(f, ", within {seconds} s"))
            }
            ChaosAction::Cancel { request } => write!(f, "request {request} is canceled"),
            ChaosAction::ChangeSchedule { change, missed } => match change {
                ScheduleAction::Add => write!(f, "a schedule is added; missed occurrences: {}", missed.as_str()),
                ScheduleAction::Pause => f.write_str("the schedule is paused"),
                ScheduleAction::Resume => f.write_str("the schedule is resumed"),
                ScheduleAction::Remove => f.write_str("the schedule is removed"),
            },
            ChaosAction::Order { robot, change } => {
                let in_zone = robot.strip_prefix(IN_ZONE).map(|zone| format!("every robot in zone {zone}"));
                let robot = if robot == ALL_ROBOTS { "every robot" } else { in_zone.as_deref().unwrap_or(robot) };
                match change {
                    OrderAction::Hold { for_s } => write!(f, "{robot} is held for {for_s} s"),
                    OrderAction::Release => write!(f, "{robot} is released"),
                    OrderAction::BeginMaintenance => write!(f, "the maintenance of {robot} begins"),
                    OrderAction::EndMaintenance => write!(f, "the maintenance of {robot} ends"),
                }
            }
            ChaosAction::Closure { part, change } => match change {
                ClosureAction::Close { for_s: None } => write!(f, "{part} is closed"),
                ClosureAction::Close { for_s: Some(for_s) } => write!(f, "{part} is closed for {for_s} s"),
                ClosureAction::Open => write!(f, "{part} is opened"),
            },
            ChaosAction::Alarm { alarm, change } => match change {
                AlarmAction::Raise => write!(f, "alarm {alarm} is raised"),
                AlarmAction::Clear => write!(f, "alarm {alarm} is cleared"),
            },
            ChaosAction::SpeedLimit { part, change } => match change {
                SpeedLimitAction::Set { speed_mps, for_s: None } => write!(f, "{part} is limited to {speed_mps} m/s"),
                SpeedLimitAction::Set { speed_mps, for_s: Some(for_s) } => {
                    write!(f, "{part} is limited to {speed_mps} m/s for {for_s} s")
                }
                SpeedLimitAction::Clear => write!(f, "the speed limit of {part} is cleared"),
            },
            ChaosAction::ChangeMission { request, change } => match change {
                MissionAction::Prioritize { priority } => {
                    write!(f, "request {request} has priority {priority} from now on")
                }
                MissionAction::Reassign { to, repeat } => {
                    let to = to.as_deref().unwrap_or("another robot");
                    let repeat = if *repeat { ", which may repeat tasks" } else { "" };
                    write!(f, "the carrier's role of request {request} is reassigned to {to}{repeat}")
                }
                MissionAction::Pin { robot } => {
                    write!(f, "the carrier's role of request {request} is pinned to {robot}")
                }
                MissionAction::Unpin => write!(f, "the order about the carrier's role of request {request} ends"),
            },
            ChaosAction::CancelMissions { selection } => match selection {
                CancelSelection::Requests(requests) => {
                    write!(f, "the requests {} are canceled together", requests.join(", "))
                }
                CancelSelection::Named(mission) => write!(f, "every mission {mission} is canceled"),
            },
            ChaosAction::Crash { node, disk, for_ms } => {
                write!(f, "{node} crashes, {}, down {}", fate(disk), For(*for_ms))
            }
            ChaosAction::Blackout { disk, for_ms } => {
                write!(f, "every node crashes, {}, down {}", fate(disk), For(*for_ms))
            }
            ChaosAction::Block { node, for_ms } => write!(f, "the bus of {node} is blocked {}", For(*for_ms)),
            ChaosAction::Pause { node, for_ms } => write!(f, "{node} is paused {}", For(*for_ms)),
            ChaosAction::Suspend { node, for_ms } => write!(f, "the machine of {node} is suspended {}", For(*for_ms)),
            ChaosAction::Remove { node } => write!(f, "{node} is gone for good"),
            ChaosAction::Leave { node, for_ms } => write!(f, "{node} leaves the fleet {}", For(*for_ms)),
            ChaosAction::Revoke { node, for_ms } => {
                write!(
                    f,
                    "{node} is revoked once it holds a role, runs on {} in all, and is gone for good",
                    For(*for_ms)
                )
            }
            ChaosAction::Upgrade { interval_ms } => {
                write!(
                    f,
                    "the fleet is upgraded, a node every {:.3} s",
                    Duration::from_millis(*interval_ms).as_secs_f64()
                )
            }
            ChaosAction::WrongDate { node, ahead_s, for_ms } => {
                write!(f, "the date of {node} is wrong by {ahead_s} s {}", For(*for_ms))
            }
            ChaosAction::Partition { groups, for_ms } => {
                let groups: Vec<_> = groups.iter().map(|group| group.join(" ")).collect();
                write!(f, "partition {} {}", groups.join(" | "), For(*for_ms))
            }
            ChaosAction::Cut { from, to, for_ms } => {
                write!(f, "messages from {from} to {to} are lost {}", For(*for_ms))
            }
            ChaosAction::Weather { loss, duplication, reordering, delay_ms, for_ms } => write!(
                f,
                "bad links: {loss:.2} lost, {duplication:.2} repeated, {reordering:.2} overtaken, up to {delay_ms} ms {}",
                For(*for_ms)
            ),
            ChaosAction::SlowDisk { node, write_ms, for_ms } => {
                write!(f, "the disk of {node} takes up to {write_ms} ms a write {}", For(*for_ms))
            }
            ChaosAction::Disk { node, fault, for_ms } => {
                let fault = match fault {
                    DiskFault::Fails => "fails",
                    DiskFault::Full => "is full",
                    DiskFault::Hangs => "hangs",
                    DiskFault::Lies => "does not sync",
                };
                write!(f, "the disk of {node} {fault} {}", For(*for_ms))
            }
            ChaosAction::Drift { node, rate } => write!(f, "the clock of {node} counts {rate:.4} s a second"),
            ChaosAction::Battery { robot } => write!(f, "the battery of {robot} runs down"),
            ChaosAction::Hostile { role, revoked, for_ms } => {
                let role = role.map_or("no role", NodeRole::as_str);
                let revoked = if *revoked { ", which is revoked halfway," } else { "" };
                write!(f, "a hostile node with a certificate of {role}{revoked} {}", For(*for_ms))
            }
            ChaosAction::Skill { robot, how, times } => {
                let how = match how {
                    SkillFault::Fails => "fails",
                    SkillFault::Panics => "panics",
                    SkillFault::Hangs => "hangs",
                };
                write!(f, "the skill of {robot} {how}, {times} in a row")
            }
        }
    }
}
