//! Plans of the active missions, as the coordinator sends them to the human task proxies of
//! unmanaged roles.
//!
//! A message is bounded ([`codec::MESSAGE_BYTES_MAX`]), so the reply is split into as many parts as
//! needed. Each part contains the total number of plans. A receiver that lacks a part ignores the
//! reply, since plans that are not listed count as ended.

use crate::codec;
use crate::ids::{ClusterId, MissionId, RoleId};
use crate::lease::RoleHolder;
use crate::ledger::Branch;
use crate::plan::{LocalPlan, Signal, StepIndex};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Bytes reserved in each part for the fields around the plans and for the cluster envelope, with a
/// margin.
const FRAME: usize = 256;

/// Plan of an unmanaged role in an active mission.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActivePlan {
    /// The mission.
    pub mission: MissionId,
    /// Branch of the mission that is executed.
    pub branch: Branch,
    /// Plan of the unmanaged role in that branch.
    pub plan: LocalPlan,
    /// Steps that have ended according to the ledger.
    pub ended: BTreeSet<StepIndex>,
    /// Holders of the managed roles.
    pub holders: BTreeMap<RoleId, RoleHolder>,
    /// Managed roles without a holder: tasks that name such a role wait.
    pub vacant: BTreeSet<RoleId>,
    /// Signals from other roles to this role, according to the ledger.
    pub signals: BTreeSet<Signal>,
}

/// All plans of unmanaged roles, or a part of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActiveMissions {
    /// Cluster of the missions: a newly created ledger may have other missions with the same names.
    pub cluster: Option<ClusterId>,
    /// Number of plans in all parts.
    pub count: u32,
    /// Plans in this part.
    pub plans: Vec<ActivePlan>,
}

impl ActiveMissions {
    /// Splits the reply into parts that each fit a message; a reply without plans has 1 part. Also
    /// returns the plans that are too large for any message and cannot be sent.
    pub fn split(cluster: Option<ClusterId>, plans: Vec<ActivePlan>) -> (Vec<ActiveMissions>, Vec<ActivePlan>) {
        let size = |plan: &ActivePlan| codec::encode(plan).map_or(usize::MAX, |bytes| bytes.len());
        let (plans, too_large): (Vec<_>, Vec<_>) =
            plans.into_iter().partition(|plan| size(plan) <= codec::MESSAGE_BYTES_MAX - FRAME);
        let count = u32::try_from(plans.len()).expect("a ledger holds fewer than 2^32 missions");
        let mut parts = vec![ActiveMissions { cluster, count, plans: vec![] }];
        let mut used = FRAME;
        for plan in plans {
            let size_of_plan = size(&plan);
            if used + size_of_plan > codec::MESSAGE_BYTES_MAX {
                parts.push(ActiveMissions { cluster, count, plans: vec![] });
                used = FRAME;
            }
            used += size_of_plan;
            parts.last_mut().expect("the list starts with 1 part").plans.push(plan);
        }
        (parts, too_large)
    }

    /// Joins the parts; repeated parts count once. Returns `None` if a part is missing, or if the
    /// parts belong to different replies.
    pub fn join(parts: Vec<ActiveMissions>) -> Option<ActiveMissions> {
        let (cluster, count) = parts.first().map(|part| (part.cluster, part.count))?;
        if parts.iter().any(|part| (part.cluster, part.count) != (cluster, count)) {
            return None;
        }
        let plans = parts.into_iter().flat_map(|part| part.plans);
        let plans: BTreeMap<_, _> = plans.map(|live| ((live.mission.clone(), live.plan.role.clone()), live)).collect();
        (plans.len() == count as usize).then(|| ActiveMissions { cluster, count, plans: plans.into_values().collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{TaskId, TaskType};
    use crate::message::ClusterEnvelope;
    use crate::mission::TaskSpec;
    use crate::plan::{Step, StepAction};

    /// Creates a plan of about `bytes` bytes.
    fn plan(number: usize, bytes: usize) -> ActivePlan {
        let nurse = RoleId::new("nurse").unwrap();
        let mut spec = TaskSpec::of(TaskType::new("deposit").unwrap(), vec![nurse.clone()]);
        spec.parameters.insert("item".to_owned(), "x".repeat(bytes));
        let step = Step { action: StepAction::Task { id: TaskId::new("deposit").unwrap(), spec }, after: vec![] };
        ActivePlan {
            mission: MissionId::new(format!("mission-{number}")).unwrap(),
            branch: Branch::Main,
            plan: LocalPlan::of(nurse, vec![step]),
            ended: BTreeSet::new(),
            holders: BTreeMap::new(),
            vacant: BTreeSet::new(),
            signals: BTreeSet::new(),
        }
    }

    #[test]
    fn each_part_fits_a_message_with_its_envelope() {
        let cluster = Some(ClusterId(u64::MAX));
        // Eight of the large plans would not fit a message; hundreds of the small plans do.
        let mut plans: Vec<ActivePlan> = (100..112).map(|number| plan(number, 30_000)).collect();
        plans.extend((112..400).map(|number| plan(number, 20)));
        plans.push(plan(400, codec::MESSAGE_BYTES_MAX - FRAME - 100));
        let (parts, too_large) = ActiveMissions::split(cluster, plans.clone());
        assert_eq!(too_large, []);
        for part in &parts {
            let payload = codec::encode(part).expect("a part fits");
            codec::encode(&ClusterEnvelope { cluster, payload }).expect("the envelope fits, too");
        }
        assert!(parts.len() <= 8, "{} parts", parts.len());
        assert_eq!(ActiveMissions::join(parts), Some(ActiveMissions { cluster, count: 301, plans }));
    }

    #[test]
    fn a_plan_that_is_too_large_does_not_block_the_others() {
        let (parts, too_large) =
            ActiveMissions::split(None, vec![plan(1, 20), plan(2, codec::MESSAGE_BYTES_MAX), plan(3, 20)]);
        assert_eq!(too_large, [plan(2, codec::MESSAGE_BYTES_MAX)]);
        assert_eq!(ActiveMissions::join(parts).unwrap().plans, [plan(1, 20), plan(3, 20)]);
    }

    #[test]
    fn a_reply_with_a_missing_part_is_rejected() {
        let (parts, _) = ActiveMissions::split(None, (1..6).map(|number| plan(number, 30_000)).collect());
        assert!(parts.len() > 1);
        for lost in 0..parts.len() {
            let mut received = parts.clone();
            received.remove(lost);
            assert_eq!(ActiveMissions::join(received), None);
        }
        let repeated = parts.iter().chain(&parts).cloned().collect();
        assert_eq!(ActiveMissions::join(repeated).unwrap().plans.len(), 5);
        assert_eq!(ActiveMissions::join(vec![]), None, "no parts are not a reply");
        let (nothing, _) = ActiveMissions::split(None, vec![]);
        assert_eq!(ActiveMissions::join(nothing).unwrap().plans, [], "a reply without plans is valid");
    }

    #[test]
    fn parts_of_two_replies_are_not_joined() {
        let (mut parts, _) = ActiveMissions::split(Some(ClusterId(1)), vec![plan(1, 20)]);
        parts.extend(ActiveMissions::split(Some(ClusterId(2)), vec![plan(1, 20)]).0);
        assert_eq!(ActiveMissions::join(parts), None);
    }
}
