//! The state machine.

use super::entry::{Holder, MissionEntry, MissionState, RoleEntry, RolePhase, Submission};
use crate::auction::AuctionRecord;
use crate::ids::{ClusterId, MissionId, RequestId, RobotId, RoleId};
use crate::lease::Epoch;
use crate::mission::RoleKind;
use crate::plan::StepIndex;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Ended missions that are kept to be looked at and to answer repeated requests; the oldest are dropped beyond.
pub const HISTORY_MAX: usize = 500;

/// What the fleet has promised and what came of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ledger {
    cluster: Option<ClusterId>,
    missions: BTreeMap<MissionId, MissionEntry>,
    requests: BTreeMap<RequestId, MissionId>,
    submitted: u64,
}

/// Something the coordinator wants to hold for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// The ledger gets its identity: the first command of all.
    Found {
        /// Unlike that of every other ledger of a fleet of this name.
        cluster: ClusterId,
    },
    /// A client asks for a mission.
    Submit(Box<Submission>),
    /// An auction has filled all open roles.
    Award {
        /// The mission.
        mission: MissionId,
        /// Who gets which open role: all of them, and no others.
        holders: BTreeMap<RoleId, RobotId>,
        /// How it came about.
        auction: AuctionRecord,
    },
    /// An auction could not fill the open roles. The mission stays pending.
    Defer {
        /// The mission.
        mission: MissionId,
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
    },
    /// Steps of a role have ended.
    Progress {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// By which award; for an unmanaged role, which is nobody's award, the default.
        epoch: Epoch,
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
    },
    /// The mission cannot be carried out.
    Fail {
        /// The mission.
        mission: MissionId,
        /// Why, in words.
        cause: String,
    },
    /// A client withdraws a mission.
    Cancel {
        /// The mission.
        mission: MissionId,
        /// On whose word.
        by: String,
    },
}

/// What a command did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
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
    Refused(Refused),
}

/// Why a command does not fit the ledger.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
pub enum Refused {
    /// No such mission; ordinary for one that ended long ago.
    #[error("no mission {mission}")]
    NoMission {
        /// Its id.
        mission: MissionId,
    },
    /// The mission has ended.
    #[error("mission {mission} is {}", .state.word())]
    Over {
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
    Epoch {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The award in force.
        held: Option<Epoch>,
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
    /// The robot's node has started anew since it confirmed the role, and knows nothing of it.
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
    pub fn apply(&mut self, at: Epoch, command: Command) -> Outcome {
        let done = match command {
            Command::Found { cluster } => Ok(self.found(cluster)),
            Command::Submit(submission) => return self.submit(*submission),
            Command::Award { mission, holders, auction } => self.award(&mission, holders, auction, at),
            Command::Defer { mission, auction } => self.defer(&mission, auction),
            Command::Accept { mission, role, epoch, incarnation } => self.accept(&mission, &role, epoch, incarnation),
            Command::Progress { mission, role, epoch, ended } => self.progress(&mission, &role, epoch, &ended),
            Command::Release { mission, role, epoch, cause } => self.release(&mission, &role, epoch, &cause),
            Command::Fail { mission, cause } => self.end(&mission, MissionState::Failed { cause }),
            Command::Cancel { mission, by } => self.end(&mission, MissionState::Canceled { by }),
        };
        done.unwrap_or_else(Outcome::Refused)
    }

    /// Which founding of the fleet's ledger this is; `None` until the founding is committed.
    pub fn cluster(&self) -> Option<ClusterId> {
        self.cluster
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
    pub fn requested(&self, request: &RequestId) -> Option<&MissionEntry> {
        self.missions.get(self.requests.get(request)?)
    }

    /// Missions that have not ended, in the order in which they were submitted.
    pub fn live(&self) -> Vec<&MissionEntry> {
        let mut live: Vec<_> = self.missions.values().filter(|entry| !entry.state.is_end()).collect();
        live.sort_by_key(|entry| entry.number);
        live
    }

    /// The role that a robot holds now, with its award.
    pub fn held_by(&self, robot: &RobotId) -> Option<(&MissionEntry, &RoleId, Epoch)> {
        self.missions.values().filter(|entry| !entry.state.is_end()).find_map(|entry| {
            entry.roles.iter().find_map(|(id, role)| match (&role.holder, role.phase) {
                (Some(holder), RolePhase::Awarded | RolePhase::Active) if holder.robot == *robot => {
                    Some((entry, id, holder.epoch))
                }
                _ => None,
            })
        })
    }

    /// Once founded, a ledger stays what it is: a second founder may have stood in for the first.
    fn found(&mut self, cluster: ClusterId) -> Outcome {
        self.cluster.get_or_insert(cluster);
        Outcome::Done
    }

    fn submit(&mut self, submission: Submission) -> Outcome {
        if let Some(mission) = self.requests.get(&submission.request) {
            return Outcome::Submitted { mission: mission.clone(), again: true };
        }
        self.submitted += 1;
        let number = self.submitted;
        let name: String = submission.mission.name.as_str().chars().take(40).collect();
        let id = MissionId::new(format!("{name}-{number}")).expect("a task's name, a dash and a number are a slug");
        let roles = submission.mission.roles.iter().map(|(role, declared)| {
            let entry = RoleEntry { kind: declared.kind, phase: RolePhase::Open, holder: None, ended: BTreeSet::new() };
            (role.clone(), entry)
        });
        let roles = roles.collect();
        self.requests.insert(submission.request.clone(), id.clone());
        let state = MissionState::Pending;
        let entry = MissionEntry { id: id.clone(), number, submission, state, roles, auction: None };
        self.missions.insert(id.clone(), entry);
        Outcome::Submitted { mission: id, again: false }
    }

    fn award(
        &mut self,
        mission: &MissionId,
        holders: BTreeMap<RoleId, RobotId>,
        auction: AuctionRecord,
        at: Epoch,
    ) -> Result<Outcome, Refused> {
        let open = self.live_mission(mission)?.open_roles();
        if open.is_empty() || !holders.keys().eq(open.iter()) {
            return Err(Refused::NotOpen { mission: mission.clone(), open });
        }
        let mut taken: BTreeMap<&RobotId, &RoleId> = BTreeMap::new();
        for (role, robot) in &holders {
            let two = |mission: &MissionId, role: &RoleId| Refused::TwoRoles {
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
        }
        let entry = self.live_mission(mission)?;
        for (id, robot) in holders {
            if let Some(role) = entry.roles.get_mut(&id) {
                role.holder = Some(Holder { robot, epoch: at, incarnation: None });
                role.phase = RolePhase::Awarded;
                role.ended.clear();
            }
        }
        entry.auction = Some(auction);
        entry.state = MissionState::Running;
        Ok(Outcome::Awarded { epoch: at })
    }

    fn defer(&mut self, mission: &MissionId, auction: AuctionRecord) -> Result<Outcome, Refused> {
        self.live_mission(mission)?.auction = Some(auction);
        Ok(Outcome::Done)
    }

    fn accept(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        incarnation: u64,
    ) -> Result<Outcome, Refused> {
        let role = self.held_role(mission, role_id, epoch)?;
        let Some(holder) = &mut role.holder else { return Ok(Outcome::Done) };
        match holder.incarnation {
            Some(known) if known != incarnation => {
                let (robot, mission, role) = (holder.robot.clone(), mission.clone(), role_id.clone());
                return Err(Refused::Restarted { robot, mission, role });
            }
            Some(_) => {}
            None => {
                holder.incarnation = Some(incarnation);
                role.phase = RolePhase::Active;
            }
        }
        Ok(Outcome::Done)
    }

    fn progress(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        ended: &BTreeSet<StepIndex>,
    ) -> Result<Outcome, Refused> {
        let steps = self.live_mission(mission)?.plan(role_id).map_or(0, |plan| plan.steps.len());
        let role = self.held_role(mission, role_id, epoch)?;
        role.ended.extend(ended.iter().filter(|step| (**step as usize) < steps));
        if role.ended.len() == steps {
            role.phase = RolePhase::Ended;
        }
        let entry = self.live_mission(mission)?;
        let managed = |role: &&RoleEntry| role.kind == RoleKind::Managed;
        if entry.roles.values().filter(managed).all(|role| role.phase == RolePhase::Ended) {
            entry.state = MissionState::Completed;
            self.forget_oldest();
        }
        Ok(Outcome::Done)
    }

    fn release(
        &mut self,
        mission: &MissionId,
        role_id: &RoleId,
        epoch: Epoch,
        cause: &str,
    ) -> Result<Outcome, Refused> {
        let role = self.held_role(mission, role_id, epoch)?;
        if role.phase == RolePhase::Ended {
            return Ok(Outcome::Done); // carried out: nobody needs to do it again
        }
        let robot = role.holder.as_ref().map(|holder| holder.robot.to_string());
        if self.live_mission(mission)?.has_told(role_id) {
            let who = robot.unwrap_or_default();
            let cause = format!("{who} was lost as {role_id} after others had acted on its work: {cause}");
            return self.end(mission, MissionState::Failed { cause });
        }
        let role = self.held_role(mission, role_id, epoch)?;
        role.holder = None;
        role.phase = RolePhase::Open;
        role.ended.clear();
        self.live_mission(mission)?.state = MissionState::Pending;
        Ok(Outcome::Done)
    }

    fn end(&mut self, mission: &MissionId, state: MissionState) -> Result<Outcome, Refused> {
        self.live_mission(mission)?.state = state;
        self.forget_oldest();
        Ok(Outcome::Done)
    }

    fn live_mission(&mut self, mission: &MissionId) -> Result<&mut MissionEntry, Refused> {
        match self.missions.get_mut(mission) {
            None => Err(Refused::NoMission { mission: mission.clone() }),
            Some(entry) if entry.state.is_end() => {
                Err(Refused::Over { mission: mission.clone(), state: entry.state.clone() })
            }
            Some(entry) => Ok(entry),
        }
    }

    /// A role that is held under `epoch` and has not ended, or an unmanaged one.
    fn held_role(&mut self, mission: &MissionId, id: &RoleId, epoch: Epoch) -> Result<&mut RoleEntry, Refused> {
        let (mission_id, role_id) = (mission.clone(), id.clone());
        let entry = self.live_mission(mission)?;
        let Some(role) = entry.roles.get_mut(id) else {
            return Err(Refused::NoRole { mission: mission_id, role: role_id });
        };
        let held = role.holder.as_ref().map(|holder| holder.epoch);
        if role.kind == RoleKind::Managed && held != Some(epoch) {
            return Err(Refused::Epoch { mission: mission_id, role: role_id, held });
        }
        Ok(role)
    }

    fn forget_oldest(&mut self) {
        let ended = self.missions.values().filter(|entry| entry.state.is_end());
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
