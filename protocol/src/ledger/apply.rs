//! The state machine.

use super::custody::HeldItem;
use super::entry::{Branch, MissionEntry, MissionState, RoleAssignment, RoleEntry, RolePhase, Submission};
use super::loss::ReleaseCause;
use crate::auction::AuctionRecord;
use crate::ids::{ClusterId, ItemId, MissionId, PlaceId, RequestId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::RoleKind;
use crate::mutants::{self, Mutant};
use crate::plan::StepIndex;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Ended missions that are kept to be looked at and to answer repeated requests; the oldest are dropped beyond.
pub const HISTORY_MAX: usize = 500;

/// What the fleet has promised and what came of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    cluster: Option<ClusterId>,
    pub(super) missions: BTreeMap<MissionId, MissionEntry>,
    requests: BTreeMap<RequestId, MissionId>,
    submitted: u64,
    wire: Option<u8>,
}

/// Something the coordinator wants to hold for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// The ledger gets its identity: the first command of all.
    Bootstrap {
        /// Unlike that of every other ledger of a fleet of this name.
        cluster: ClusterId,
    },
    /// A client asks for a mission.
    Submit(Box<Submission>),
    /// An auction has filled all open roles.
    Award {
        /// The mission.
        mission: MissionId,
        /// Of which branch's roles: a role may have the same name in both.
        branch: Branch,
        /// Who gets which open role: all of them, and no others.
        holders: BTreeMap<RoleId, RobotId>,
        /// How it came about.
        auction: AuctionRecord,
    },
    /// An auction could not fill the open roles. The mission stays pending.
    Defer {
        /// The mission.
        mission: MissionId,
        /// Of which branch's roles.
        branch: Branch,
        /// Why.
        auction: AuctionRecord,
    },
    /// The holder has confirmed a role.
    Accept {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// By which award.
        epoch: Epoch,
        /// Which life of the robot's node speaks.
        incarnation: u64,
        /// Whether that life took the plan up from what a former one had written down.
        from_checkpoint: bool,
    },
    /// Steps of a role have ended.
    Progress {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// By which award; for an unmanaged role, which is nobody's award, the default.
        epoch: Epoch,
        /// For an unmanaged role, of which branch's plan: it has the same name in both. For a managed role, whose award tells
        /// it, the default.
        branch: Branch,
        /// All steps that have ended so far.
        ended: BTreeSet<StepIndex>,
    },
    /// A role's holder is gone.
    Release {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// By which award it was held.
        epoch: Epoch,
        /// Why it is taken away, in words.
        cause: String,
        /// Whether the robot failed at the role, and was not merely silent: it is not asked for it again in this mission.
        robot_failed: bool,
        /// Where the robot was last known to be.
        place: Option<PlaceId>,
    },
    /// The mission cannot be carried out.
    Fail {
        /// The mission.
        mission: MissionId,
        /// Why, in words.
        cause: String,
        /// In which branch that is so; `None` if whichever is taken, as for a deadline.
        branch: Option<Branch>,
        /// Where its robots were last known to be.
        places: BTreeMap<RobotId, PlaceId>,
    },
    /// A client withdraws a mission.
    Cancel {
        /// The mission.
        mission: MissionId,
        /// On whose word.
        by: String,
        /// Where its robots were last known to be.
        places: BTreeMap<RobotId, PlaceId>,
    },
    /// A person has taken care of what a mission left in robots' hands.
    Resolve {
        /// The mission.
        mission: MissionId,
        /// Who.
        by: String,
    },
    /// From now on the fleet writes this version of the wire, and what comes with it may stand in the ledger. Whoever proposes it
    /// has seen to it that everybody can read it; nothing lowers it again.
    RaiseWireVersion {
        /// The version.
        wire: u8,
    },
}

/// What a command did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum CommandOutcome {
    /// The mission that the request stands for.
    Submitted {
        /// Its id.
        mission: MissionId,
        /// Whether the request had been made before.
        again: bool,
    },
    /// The roles were given under this epoch.
    Awarded {
        /// The award.
        epoch: Epoch,
    },
    /// It was done, or had been done before.
    Done,
    /// It does not fit the ledger, which is unchanged.
    Refused(CommandError),
}

/// Why a command does not fit the ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum CommandError {
    /// No such mission; ordinary for one that ended long ago.
    #[error("no mission {mission}")]
    NoMission {
        /// Its id.
        mission: MissionId,
    },
    /// The mission has ended.
    #[error("mission {mission} is {}", .state.as_str())]
    MissionEnded {
        /// Its id.
        mission: MissionId,
        /// How.
        state: MissionState,
    },
    /// No such role.
    #[error("mission {mission} has no role {role}")]
    NoRole {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// Another award holds the role, or none does.
    #[error("{role} of {mission} is held under epoch {}", .held.map_or("none".to_owned(), |epoch| epoch.to_string()))]
    StaleEpoch {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The award in force.
        held: Option<Epoch>,
    },
    /// What was said concerns the branch that is not taken; ordinary for what was long on its way.
    #[error("mission {mission} is in its {} branch, and this was said of the other", .taken.as_str())]
    WrongBranch {
        /// The mission.
        mission: MissionId,
        /// Its branch now.
        taken: Branch,
    },
    /// The awarded roles are not the open ones.
    #[error("the open roles of {mission} are {}", .open.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", "))]
    NotOpen {
        /// The mission.
        mission: MissionId,
        /// Its open roles.
        open: BTreeSet<RoleId>,
    },
    /// A robot would hold two roles.
    #[error("{robot} would hold two roles: it has {role} of {mission}")]
    TwoRoles {
        /// The robot.
        robot: RobotId,
        /// The mission of the role that it has.
        mission: MissionId,
        /// The role that it has.
        role: RoleId,
    },
    /// A robot has something of a mission that waits for a person.
    #[error("{robot} has the {item} of {mission}, which needs rescue")]
    CarriesItem {
        /// The robot.
        robot: RobotId,
        /// What it has, or may have.
        item: ItemId,
        /// The mission that waits.
        mission: MissionId,
    },
    /// The mission does not wait for a person.
    #[error("mission {mission} is {state}; only one that needs rescue can be closed")]
    NoInterventionNeeded {
        /// The mission.
        mission: MissionId,
        /// How it stands, in a word.
        state: String,
    },
    /// The robot's node has started anew, and a later life of it has confirmed the role; ordinary for a report that was
    /// long on its way.
    #[error("a later life of {robot} has confirmed {role} of {mission}")]
    StaleIncarnation {
        /// The robot.
        robot: RobotId,
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
    /// The robot's node has started anew since it confirmed the role, and knows nothing of the plan.
    #[error("{robot} has started anew since it confirmed {role} of {mission}")]
    Restarted {
        /// The robot.
        robot: RobotId,
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
    },
}

impl Ledger {
    /// Carries out the command that stands at `at` in the log.
    pub fn apply(&mut self, at: Epoch, command: Command) -> CommandOutcome {
        let done = match command {
            Command::Bootstrap { cluster } => Ok(self.found(cluster)),
            Command::Submit(submission) => return self.submit(*submission),
            Command::Award { mission, branch, holders, auction } => self.award(&mission, branch, holders, auction, at),
            Command::Defer { mission, branch, auction } => self.defer(&mission, branch, auction),
            Command::Accept { mission, role, epoch, incarnation, from_checkpoint } => {
                self.accept(&mission, &role, epoch, incarnation, from_checkpoint)
            }
            Command::Progress { mission, role, epoch, branch, ended } => {
                self.progress(&mission, &role, epoch, branch, &ended)
            }
            Command::Release { mission, role, epoch, cause, robot_failed: blamed, place } => {
                self.release(&mission, &role, epoch, &ReleaseCause { cause, robot_failed: blamed, place })
            }
            Command::Fail { mission, cause, branch, places } => self.fail(&mission, cause, branch, &places),
            Command::Cancel { mission, by, places } => self.cancel(&mission, by, &places),
            Command::Resolve { mission, by } => self.resolve(&mission, &by),
            Command::RaiseWireVersion { wire } => Ok(self.raise(wire)),
        };
        done.unwrap_or_else(CommandOutcome::Refused)
    }

    /// Which founding of the fleet's ledger this is; `None` until the founding is committed.
    pub fn cluster(&self) -> Option<ClusterId> {
        self.cluster
    }

    /// Which version of the wire the fleet writes; `None` until that is said first, right after the founding.
    pub fn wire(&self) -> Option<u8> {
        self.wire
    }

    /// Makes this the ledger of another cluster, with all that it holds. Never part of the log: only whoever recovers one
    /// copy, outside the fleet, may say that the others are strangers to it.
    pub fn replace_cluster(&mut self, cluster: ClusterId) {
        self.cluster = Some(cluster);
    }

    /// All missions that are kept, by id.
    pub fn missions(&self) -> impl Iterator<Item = &MissionEntry> {
        self.missions.values()
    }

    /// A mission.
    pub fn mission(&self, id: &MissionId) -> Option<&MissionEntry> {
        self.missions.get(id)
    }

    /// The mission that a request stands for.
    pub fn mission_of_request(&self, request: &RequestId) -> Option<&MissionEntry> {
        self.missions.get(self.requests.get(request)?)
    }

    /// Missions that have not ended, in the order in which they are served: by priority, then as they were submitted.
    pub fn active_missions(&self) -> Vec<&MissionEntry> {
        let mut live: Vec<_> = self.missions.values().filter(|entry| !entry.state.is_final()).collect();
        live.sort_by_key(|entry| entry.rank());
        live
    }

    /// Whether so many missions, or more, are under way.
    pub fn has_active(&self, count: usize) -> bool {
        self.missions.values().filter(|entry| !entry.state.is_final()).take(count).count() == count
    }

    /// What robots have of missions that wait for a person, or that recover from the loss of it, with those missions. Such
    /// robots are given no role of another mission.
    pub fn held_items(&self) -> impl Iterator<Item = (&MissionEntry, HeldItem)> {
        self.missions.values().flat_map(|entry| {
            let items = match &entry.state {
                MissionState::NeedsRescue { items, .. } => items.clone(),
                MissionState::Pending | MissionState::Running => entry.unmoved_items(),
                MissionState::Completed | MissionState::Failed { .. } | MissionState::Canceled { .. } => vec![],
            };
            items.into_iter().map(move |item| (entry, item))
        })
    }

    /// The role that a robot holds now, with its award.
    pub fn held_by(&self, robot: &RobotId) -> Option<(&MissionEntry, &RoleId, Epoch)> {
        self.missions.values().filter(|entry| !entry.state.is_final()).find_map(|entry| {
            entry.roles.iter().find_map(|(id, role)| match (&role.holder, role.phase) {
                (Some(holder), RolePhase::Awarded | RolePhase::Active) if holder.robot == *robot => {
                    Some((entry, id, holder.epoch))
                }
                _ => None,
            })
        })
    }

    /// Once founded, a ledger stays what it is: a second founder may have stood in for the first.
    fn found(&mut self, cluster: ClusterId) -> CommandOutcome {
        self.cluster.get_or_insert(cluster);
        CommandOutcome::Done
    }

    fn raise(&mut self, wire: u8) -> CommandOutcome {
        self.wire = self.wire.max(Some(wire));
        CommandOutcome::Done
    }

    fn submit(&mut self, submission: Submission) -> CommandOutcome {
        if let Some(mission) = self.requests.get(&submission.request)
            && !mutants::is_active(Mutant::RequestForgotten)
        {
            return CommandOutcome::Submitted { mission: mission.clone(), again: true };
        }
        self.submitted += 1;
        let number = self.submitted;
        let name: String = submission.mission.name.as_str().chars().take(40).collect();
        let id = MissionId::new(format!("{name}-{number}")).expect("a task's name, a dash and a number are a slug");
        let roles = RoleEntry::all_open(&submission.mission);
        self.requests.insert(submission.request.clone(), id.clone());
        let state = MissionState::Pending;
        let entry = MissionEntry {
            id: id.clone(),
            number,
            submission,
            state,
            roles,
            auction: None,
            branch: Branch::Main,
            items_at_recovery: vec![],
            former_holders: vec![],
            releases: vec![],
            release_count: 0,
        };
        self.missions.insert(id.clone(), entry);
        CommandOutcome::Submitted { mission: id, again: false }
    }

    fn award(
        &mut self,
        mission: &MissionId,
        branch: Branch,
        holders: BTreeMap<RoleId, RobotId>,
        auction: AuctionRecord,
        at: Epoch,
    ) -> Result<CommandOutcome, CommandError> {
        let open = self.in_branch(mission, branch)?.open_roles();
        if open.is_empty() || !holders.keys().eq(open.iter()) {
            return Err(CommandError::NotOpen { mission: mission.clone(), open });
        }
        let mut taken: BTreeMap<&RobotId, &RoleId> = BTreeMap::new();
        for (role, robot) in &holders {
            let two = |mission: &MissionId, role: &RoleId| CommandError::TwoRoles {
                robot: robot.clone(),
                mission: mission.clone(),
                role: role.clone(),
            };
            if let Some((held, role, _)) = self.held_by(robot) {
                return Err(two(&held.id, role));
            }
            if let Some(role) = taken.insert(robot, role) {
                return Err(two(mission, role));
            }
            let mut others = self.held_items().filter(|(entry, _)| entry.id != *mission);
            if let Some((entry, kept)) = others.find(|(_, kept)| kept.robot == *robot) {
                let (robot, item, mission) = (robot.clone(), kept.item, entry.id.clone());
                return Err(CommandError::CarriesItem { robot, item, mission });
            }
        }
        let entry = self.active_mission(mission)?;
        entry.former_holders.clear();
        for (id, robot) in holders {
            if let Some(role) = entry.roles.get_mut(&id) {
                role.holder = Some(RoleAssignment { robot, epoch: at, incarnation: None });
                role.phase = RolePhase::Awarded;
                role.ended.clear();
            }
        }
        entry.auction = Some(auction);
        entry.state = MissionState::Running;
        Ok(CommandOutcome::Awarded { epoch: at })
    }

    fn defer(
        &mut self,
        mission: &MissionId,
        branch: Branch,
        auction: AuctionRecord,
    ) -> Result<CommandOutcome, CommandError> {
        self.in_branch(mission, branch)?.auction = Some(auction);
        Ok(CommandOutcome::Done)
    }

    fn accept(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        incarnation: u64,
        resumes: bool,
    ) -> Result<CommandOutcome, CommandError> {
        let role = self.held_role(mission, role_id, epoch)?;
        let Some(holder) = &mut role.holder else { return Ok(CommandOutcome::Done) };
        match holder.incarnation {
            Some(known) if known > incarnation => {
                let (robot, mission, role) = (holder.robot.clone(), mission.clone(), role_id.clone());
                return Err(CommandError::StaleIncarnation { robot, mission, role });
            }
            Some(known) if known < incarnation && resumes => holder.incarnation = Some(incarnation),
            Some(known) if known < incarnation => {
                let (robot, mission, role) = (holder.robot.clone(), mission.clone(), role_id.clone());
                return Err(CommandError::Restarted { robot, mission, role });
            }
            Some(_) => {}
            None => {
                holder.incarnation = Some(incarnation);
                role.phase = RolePhase::Active;
            }
        }
        Ok(CommandOutcome::Done)
    }

    fn progress(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        branch: Branch,
        ended: &BTreeSet<StepIndex>,
    ) -> Result<CommandOutcome, CommandError> {
        let entry = self.active_mission(mission)?;
        let (taken, steps) = (entry.branch, entry.plan(role_id).map_or(0, |plan| plan.steps.len()));
        let role = self.held_role(mission, role_id, epoch)?;
        if role.kind == RoleKind::Unmanaged && branch != taken {
            return Err(CommandError::WrongBranch { mission: mission.clone(), taken });
        }
        role.ended.extend(ended.iter().filter(|step| (**step as usize) < steps));
        if role.ended.len() == steps {
            role.phase = RolePhase::Ended;
        }
        self.complete_if_done(mission)
    }

    fn fail(
        &mut self,
        mission: &MissionId,
        cause: String,
        branch: Option<Branch>,
        places: &BTreeMap<RobotId, PlaceId>,
    ) -> Result<CommandOutcome, CommandError> {
        if let Some(branch) = branch {
            self.in_branch(mission, branch)?;
        }
        self.end(mission, MissionState::Failed { cause }, places)
    }

    pub(super) fn active_mission(&mut self, mission: &MissionId) -> Result<&mut MissionEntry, CommandError> {
        match self.missions.get_mut(mission) {
            None => Err(CommandError::NoMission { mission: mission.clone() }),
            Some(entry) if entry.state.is_final() => {
                Err(CommandError::MissionEnded { mission: mission.clone(), state: entry.state.clone() })
            }
            Some(entry) => Ok(entry),
        }
    }

    /// A mission that has not ended, and of which this branch is taken.
    fn in_branch(&mut self, mission: &MissionId, branch: Branch) -> Result<&mut MissionEntry, CommandError> {
        let entry = self.active_mission(mission)?;
        match entry.branch {
            taken if taken != branch => Err(CommandError::WrongBranch { mission: mission.clone(), taken }),
            _ => Ok(entry),
        }
    }

    /// A role that is held under `epoch` and has not ended, or an unmanaged one.
    pub(super) fn held_role(
        &mut self,
        mission: &MissionId,
        id: &RoleId,
        epoch: Epoch,
    ) -> Result<&mut RoleEntry, CommandError> {
        let (mission_id, role_id) = (mission.clone(), id.clone());
        let entry = self.active_mission(mission)?;
        let Some(role) = entry.roles.get_mut(id) else {
            return Err(CommandError::NoRole { mission: mission_id, role: role_id });
        };
        let held = role.holder.as_ref().map(|holder| holder.epoch);
        if role.kind == RoleKind::Managed && held != Some(epoch) && !mutants::is_active(Mutant::RefusedApplied) {
            return Err(CommandError::StaleEpoch { mission: mission_id, role: role_id, held });
        }
        Ok(role)
    }

    pub(super) fn prune_history(&mut self) {
        // What waits for a person is not forgotten.
        let ended = self.missions.values().filter(|entry| entry.state.is_final() && !entry.state.needs_intervention());
        let mut ended: Vec<(u64, MissionId, RequestId)> =
            ended.map(|entry| (entry.number, entry.id.clone(), entry.submission.request.clone())).collect();
        if ended.len() <= HISTORY_MAX {
            return;
        }
        ended.sort();
        for (_, mission, request) in ended.drain(..ended.len() - HISTORY_MAX) {
            self.missions.remove(&mission);
            self.requests.remove(&request);
        }
    }
}

#[cfg(test)]
mod tests;
