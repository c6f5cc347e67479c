//! Schedules of actions as plain data that can be stored, shrunk and replayed.

use super::chaos_fleet::{MISSIONS, ROOMS_WITHOUT_NURSE};
use super::person_action::{CancelSelection, ClosureAction, MissionAction, OrderAction, SpeedLimitAction};
use crate::disk::{CrashEffect, DiskFault};
use consort_protocol::api::{AlarmAction, ScheduleAction};
use consort_protocol::ledger::{MapPart, MissedOccurrences};
use consort_protocol::trust::NodeRole;
use serde::{Deserialize, Serialize};

/// All actions on a fleet, ordered by time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// The actions.
    pub steps: Vec<ScheduledAction>,
    /// World seconds per second of node time. In a slow world goals last longer than the driver servers
    /// keep them without commands.
    #[serde(default = "usual_speed", skip_serializing_if = "is_usual_speed")]
    pub world_speed: u32,
    /// Number of chargers, which robots use by themselves: at most 2. With chargers the batteries are small.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub chargers: usize,
    /// Robots know the power of the chargers, so they plan stops before roles, and they start with little charge.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub plans_stops: bool,
    /// The limits of the log, the history and the active missions are so small that every run reaches them.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub small_limits: bool,
}

/// World speed of most runs.
const USUAL_SPEED: u32 = 10;

fn usual_speed() -> u32 {
    USUAL_SPEED
}

fn is_usual_speed(speed: &u32) -> bool {
    *speed == USUAL_SPEED
}

fn is_zero(number: &usize) -> bool {
    *number == 0
}

impl Schedule {
    /// Returns the schedule of these actions at the usual speed of the world, without chargers and with the usual limits.
    pub fn of(steps: Vec<ScheduledAction>) -> Schedule {
        Schedule { steps, world_speed: USUAL_SPEED, chargers: 0, plans_stops: false, small_limits: false }
    }

    /// Returns the same schedule with other actions.
    pub(super) fn with_steps(&self, steps: Vec<ScheduledAction>) -> Schedule {
        Schedule { steps, ..*self }
    }

    /// Replaces the missions of all requests but poison by these, in turn. The run then has no chargers, since such a
    /// mission may need more than a small battery.
    #[must_use]
    pub fn requesting<'m>(mut self, missions: impl Iterator<Item = &'m str> + Clone) -> Schedule {
        if missions.clone().next().is_some() {
            (self.chargers, self.plans_stops) = (0, false);
        }
        let mut names = missions.cycle();
        for step in self.steps.iter_mut().filter(|step| !step.action.is_poison()) {
            if let ChaosAction::Submit { mission, .. } = &mut step.action
                && let Some(name) = names.next()
            {
                name.clone_into(mission);
            }
        }
        self
    }

    /// Returns the number by which missions last longer than at the usual speed.
    pub(super) fn slowdown(&self) -> u32 {
        USUAL_SPEED.div_ceil(self.world_speed.max(1))
    }
}

/// An action with its time. A fault also contains its duration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScheduledAction {
    /// Time in milliseconds since the start of the fleet.
    pub at_ms: u64,
    /// The action.
    #[serde(flatten)]
    pub action: ChaosAction,
}

/// Prefix of a name that stands for the robot that has the role of the carrier in the mission of a request at
/// that instant, as in `carrier of r0`.
pub(super) const CARRIER_OF: &str = "carrier of ";

/// Names of the requests in a circular wait.
pub(super) const WAITING: [&str; 2] = ["w0", "w1"];

/// An action. Nodes are given by name; `coordinator` is the coordinator at that instant. Crashes, departures,
/// cuts, partitions, revocations and orders may also name a carrier by its request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case")]
pub enum ChaosAction {
    /// A client requests the sample of a room and repeats the request until it is acknowledged.
    Submit {
        /// Name of the request.
        request: String,
        /// The client does not send the name. Each repetition then counts as a new request, so the
        /// mission may be carried out more than once.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        unnamed: bool,
        /// The requested mission.
        #[serde(default = "default_mission")]
        mission: String,
        /// The room.
        room: String,
        /// Priority: higher is served first.
        #[serde(default)]
        priority: i64,
        /// Deadline in seconds.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        deadline_s: Option<u32>,
    },
    /// A client cancels an acknowledged request and repeats this until it receives a reply.
    Cancel {
        /// Name of the request.
        request: String,
    },
    /// A client changes the schedule, and repeats this until it receives a reply.
    ChangeSchedule {
        /// The change.
        change: ScheduleAction,
        /// What becomes of missed occurrences, if it is added.
        #[serde(default)]
        missed: MissedOccurrences,
    },
    /// A person changes the orders to robots, and repeats this until it receives a reply.
    Order {
        /// The robot; `*` for all, `zone icu` for those in a zone.
        robot: String,
        /// The change.
        change: OrderAction,
    },
    /// A person closes or opens a zone, a place or a lane, and repeats this until it receives a reply.
    Closure {
        /// The zone, place or lane.
        part: MapPart,
        /// The change.
        change: ClosureAction,
    },
    /// A person raises or clears an alarm of the fleet, and repeats this until it receives a reply.
    Alarm {
        /// The alarm.
        alarm: String,
        /// The change.
        change: AlarmAction,
    },
    /// A person sets or clears the speed limit of a zone, a place or a lane, and repeats this until it receives a reply.
    SpeedLimit {
        /// The zone, place or lane.
        part: MapPart,
        /// The change.
        change: SpeedLimitAction,
    },
    /// A person changes the mission of an acknowledged request, and repeats this until it receives a reply.
    ChangeMission {
        /// Name of the request.
        request: String,
        /// The change.
        change: MissionAction,
    },
    /// A person cancels several missions at once, and repeats this until it receives a reply.
    CancelMissions {
        /// The missions.
        selection: CancelSelection,
    },
    /// A node is killed and restarted later.
    Crash {
        /// The node.
        node: String,
        /// State of its disk after the crash.
        disk: DiskAfterCrash,
        /// Downtime in milliseconds.
        for_ms: u64,
    },
    /// All nodes are killed at the same instant and restarted later.
    Blackout {
        /// State of their disks after the crash.
        disk: DiskAfterCrash,
        /// Downtime in milliseconds.
        for_ms: u64,
    },
    /// The operations of a node's bus do not return for this time, as when its buffers are full.
    /// Messages to the node still arrive, and its timers continue.
    Block {
        /// Name of the node.
        node: String,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// No message enters or leaves a node; all of them arrive afterwards. On the virtual bus the
    /// timers of the node continue, unlike those of a stopped process (SIGSTOP). Tests of real
    /// processes cover that case.
    Pause {
        /// The node.
        node: String,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The machine of a node is suspended: no message enters or leaves the node, and its process is
    /// replaced by a new one when the machine resumes, as a node does that notices a suspension.
    Suspend {
        /// The node.
        node: String,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// A node is gone for good.
    Remove {
        /// The node.
        node: String,
    },
    /// A person makes a node leave the fleet. Later it joins again with an empty disk; a node that could
    /// not leave in that time is restarted instead.
    Leave {
        /// The node.
        node: String,
        /// Time in milliseconds until the node joins again.
        for_ms: u64,
    },
    /// The certificate of a robot's node is revoked as soon as the robot holds a role. Its node runs on to the end of the
    /// action, and is then gone for good. Without effect in an open fleet.
    Revoke {
        /// The node.
        node: String,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The fleet starts with the previous wire version. From this time on its nodes are restarted with
    /// the latest program, in turn, and a person then raises the version.
    Upgrade {
        /// Interval between two restarts in milliseconds.
        interval_ms: u64,
    },
    /// Only nodes of the same group reach each other.
    Partition {
        /// The groups. `client` is the client that sends requests.
        groups: Vec<Vec<String>>,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// Messages are lost in a direction.
    Cut {
        /// The sender; `*` for all.
        from: String,
        /// The receiver; `*` for all.
        to: String,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// All links are bad.
    Weather {
        /// Share of lost messages.
        loss: f64,
        /// Share of duplicated publications.
        duplication: f64,
        /// Share of reordered publications.
        reordering: f64,
        /// Largest latency in milliseconds.
        delay_ms: u64,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// Writes to the disk of a node are slow.
    SlowDisk {
        /// The node.
        node: String,
        /// Largest duration of a write, in milliseconds.
        write_ms: u64,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The disk of a node has a fault, until a restart of the node or the end of the action. A node that
    /// could not write, or whose writes were not synced, is restarted at the end.
    Disk {
        /// The node.
        node: String,
        /// The fault.
        fault: DiskFault,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The clock of a node is fast or slow from its first start on.
    Drift {
        /// The node.
        node: String,
        /// Seconds that the clock counts per second.
        rate: f64,
    },
    /// The date of a node's clock is wrong.
    WrongDate {
        /// The node.
        node: String,
        /// Seconds by which it is ahead; negative if it is behind.
        ahead_s: i64,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The battery of a robot drops to the charge at which the robot stops.
    Battery {
        /// The robot.
        robot: String,
    },
    /// A node with a valid certificate of this role attacks the others; without effect in an open
    /// fleet.
    Hostile {
        /// Role in its certificate; none if absent.
        #[serde(default, skip_serializing_if = "Option::is_none", with = "role_name")]
        role: Option<NodeRole>,
        /// Its certificate is revoked halfway.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        revoked: bool,
        /// Duration in milliseconds.
        for_ms: u64,
    },
    /// The next skills of a robot fail.
    Skill {
        /// The robot.
        robot: String,
        /// The kind of failure.
        how: SkillFault,
        /// Number of consecutive failures.
        times: u32,
    },
}

/// A role of a node as its name.
mod role_name {
    use super::NodeRole;
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(role: &Option<NodeRole>, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_some(role.map_or("", NodeRole::as_str))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<NodeRole>, D::Error> {
        let name = String::deserialize(deserializer)?;
        if name.is_empty() { Ok(None) } else { name.parse().map(Some).map_err(D::Error::custom) }
    }
}

fn default_mission() -> String {
    MISSIONS[0].to_owned()
}

/// State of a disk after a crash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DiskAfterCrash {
    /// All writes are kept, acknowledged or not.
    Kept,
    /// All acknowledged writes are kept, and a random part of the others.
    Torn,
    /// All writes are kept, and the ledger file is damaged afterwards.
    Damaged,
    /// The node starts with an empty disk.
    Empty,
}

impl DiskAfterCrash {
    /// Returns the effect on the files.
    pub(crate) fn effect(self) -> CrashEffect {
        match self {
            DiskAfterCrash::Kept => CrashEffect::Kill,
            DiskAfterCrash::Torn | DiskAfterCrash::Empty => CrashEffect::PowerFailure,
            DiskAfterCrash::Damaged => CrashEffect::Damage,
        }
    }
}

/// Kind of skill failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkillFault {
    /// It fails.
    Fails,
    /// It panics.
    Panics,
    /// It does nothing for half a minute and continues afterwards.
    Hangs,
}

impl ChaosAction {
    /// Returns the duration in milliseconds; `None` for an instantaneous action.
    pub(crate) fn for_ms(&self) -> Option<u64> {
        self.clone().for_ms_mut().copied()
    }

    fn for_ms_mut(&mut self) -> Option<&mut u64> {
        match self {
            ChaosAction::Crash { for_ms, .. }
            | ChaosAction::Blackout { for_ms, .. }
            | ChaosAction::Pause { for_ms, .. }
            | ChaosAction::Suspend { for_ms, .. }
            | ChaosAction::Block { for_ms, .. }
            | ChaosAction::Leave { for_ms, .. }
            | ChaosAction::Revoke { for_ms, .. }
            | ChaosAction::WrongDate { for_ms, .. }
            | ChaosAction::Partition { for_ms, .. }
            | ChaosAction::Cut { for_ms, .. }
            | ChaosAction::Weather { for_ms, .. }
            | ChaosAction::SlowDisk { for_ms, .. }
            | ChaosAction::Disk { for_ms, .. }
            | ChaosAction::Hostile { for_ms, .. } => Some(for_ms),
            ChaosAction::Submit { .. }
            | ChaosAction::Cancel { .. }
            | ChaosAction::ChangeSchedule { .. }
            | ChaosAction::Order { .. }
            | ChaosAction::Closure { .. }
            | ChaosAction::Alarm { .. }
            | ChaosAction::SpeedLimit { .. }
            | ChaosAction::ChangeMission { .. }
            | ChaosAction::CancelMissions { .. }
            | ChaosAction::Remove { .. }
            | ChaosAction::Upgrade { .. }
            | ChaosAction::Drift { .. }
            | ChaosAction::Battery { .. }
            | ChaosAction::Skill { .. } => None,
        }
    }

    /// Returns the action with the names of nodes that `resolve` returns; `None` if there is no such node.
    pub(super) fn resolved(&self, resolve: impl Fn(&str) -> Option<String>) -> Option<ChaosAction> {
        let resolve = |name: &mut String| match name.starts_with(CARRIER_OF) {
            true => resolve(name).map(|found| *name = found),
            false => Some(()),
        };
        let mut action = self.clone();
        match &mut action {
            ChaosAction::Crash { node, .. } | ChaosAction::Remove { node } | ChaosAction::Leave { node, .. } => {
                resolve(node)?;
            }
            ChaosAction::Order { robot, .. } => resolve(robot)?,
            ChaosAction::Cut { from, to, .. } => {
                resolve(from)?;
                resolve(to)?;
            }
            ChaosAction::Partition { groups, .. } => {
                for place in 0..groups.len() {
                    for member in 0..groups[place].len() {
                        let named = groups[place][member].clone();
                        resolve(&mut groups[place][member])?;
                        let found = groups[place][member].clone();
                        if found != named {
                            let others = groups.iter_mut().enumerate().filter(|(other, _)| *other != place);
                            others.for_each(|(_, group)| group.retain(|name| *name != found));
                        }
                    }
                }
            }
            _ => {}
        }
        Some(action)
    }

    /// Returns the name of the submitted request, if the action is one.
    pub(crate) fn submitted_request(&self) -> Option<String> {
        if let ChaosAction::Submit { request, .. } = self { Some(request.clone()) } else { None }
    }

    /// Checks whether the action is a fault, not a request of a client or a person.
    pub(super) fn is_fault(&self) -> bool {
        !matches!(
            self,
            ChaosAction::Submit { .. }
                | ChaosAction::Cancel { .. }
                | ChaosAction::ChangeSchedule { .. }
                | ChaosAction::Order { .. }
                | ChaosAction::Closure { .. }
                | ChaosAction::Alarm { .. }
                | ChaosAction::SpeedLimit { .. }
                | ChaosAction::ChangeMission { .. }
                | ChaosAction::CancelMissions { .. }
        )
    }

    /// Checks whether the action requests a mission that cannot be completed.
    pub(super) fn is_poison(&self) -> bool {
        matches!(self, ChaosAction::Submit { room, .. } if ROOMS_WITHOUT_NURSE.contains(&room.as_str()))
    }

    /// Returns the action with another duration.
    #[must_use]
    pub(crate) fn with_duration_ms(&self, ms: u64) -> ChaosAction {
        let mut act = self.clone();
        if let Some(for_ms) = act.for_ms_mut() {
            *for_ms = ms;
        }
        act
    }
}

impl Schedule {
    /// Checks whether the schedule has no faults but hostile nodes.
    pub(super) fn has_only_hostile_nodes(&self) -> bool {
        let mut faults = self.steps.iter().filter(|step| step.action.is_fault());
        faults.all(|step| matches!(step.action, ChaosAction::Hostile { .. }))
    }

    /// Checks whether the schedule has no faults but missions that cannot be completed, and has some.
    pub(super) fn has_only_poison(&self) -> bool {
        let is_request =
            |action: &ChaosAction| matches!(action, ChaosAction::Submit { .. } | ChaosAction::Cancel { .. });
        self.steps.iter().all(|step| is_request(&step.action)) && self.steps.iter().any(|step| step.action.is_poison())
    }

    /// Sorts the actions by time; actions of the same instant keep their order.
    #[must_use]
    pub fn in_order(mut self) -> Schedule {
        self.steps.sort_by_key(|step| step.at_ms);
        self
    }
}
