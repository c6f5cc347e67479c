//! What a coordinator tells those who act in unmanaged roles: the plans of all missions under way.
//!
//! A message is bounded ([`codec::LIMIT`]), so the answer comes in as many parts as it takes, and each says how many plans
//! there are in all: whoever has not heard all of them has heard nothing, since what is not among them is over.

use crate::codec;
use crate::ids::{ClusterId, MissionId, RoleId};
use crate::lease::RoleHolder;
use crate::ledger::Branch;
use crate::plan::{LocalPlan, Signal, StepIndex};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// For whatever is around the plans of a part, the cluster's envelope included; and some more.
const FRAME: usize = 256;

/// A mission under way, for those who act in unmanaged roles.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActivePlan {
    /// The mission.
    pub mission: MissionId,
    /// Which of its branches is taken.
    pub branch: Branch,
    /// The plan of one unmanaged role in that branch.
    pub plan: LocalPlan,
    /// Steps that the ledger knows as ended.
    pub ended: BTreeSet<StepIndex>,
    /// Who holds the managed roles.
    pub holders: BTreeMap<RoleId, RoleHolder>,
    /// The managed roles that nobody holds: tasks that name one of them wait.
    pub vacant: BTreeSet<RoleId>,
    /// What other roles have told this one, as far as the ledger knows.
    pub signals: BTreeSet<Signal>,
}

/// All plans of unmanaged roles, or a part of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActiveMissions {
    /// Whose missions they are: a ledger founded anew may have others of the same names.
    pub cluster: Option<ClusterId>,
    /// How many plans there are in all parts.
    pub count: u32,
    /// Those in this part.
    pub plans: Vec<ActivePlan>,
}

impl ActiveMissions {
    /// The answer as parts, each of which fits a message; one without plans is an answer, too. Beside it plans that fit no
    /// message, which nobody can be told.
    pub fn split(cluster: Option<ClusterId>, plans: Vec<ActivePlan>) -> (Vec<ActiveMissions>, Vec<ActivePlan>) {
        let size = |plan: &ActivePlan| codec::encode(plan).map_or(usize::MAX, |bytes| bytes.len());
        let (plans, unfit): (Vec<_>, Vec<_>) =
            plans.into_iter().partition(|plan| size(plan) <= codec::MESSAGE_BYTES_MAX - FRAME);
        let count = u32::try_from(plans.len()).expect("fewer missions than that fit a ledger");
        let mut parts = vec![ActiveMissions { cluster, count, plans: vec![] }];
        let mut used = FRAME;
        for plan in plans {
            let more = size(&plan);
            if used + more > codec::MESSAGE_BYTES_MAX {
                parts.push(ActiveMissions { cluster, count, plans: vec![] });
                used = FRAME;
            }
            used += more;
            parts.last_mut().expect("there is one from the beginning").plans.push(plan);
        }
        (parts, unfit)
    }

    /// The parts put together, repeated ones once. `None` if one is lacking, or if they are not parts of one answer.
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

    /// A plan of about so many bytes.
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
    fn each_part_fits_a_message_within_its_envelope() {
        let cluster = Some(ClusterId(u64::MAX));
        // Eight of the large ones would not fit a message, and hundreds of the small ones do.
        let mut plans: Vec<ActivePlan> = (100..112).map(|number| plan(number, 30_000)).collect();
        plans.extend((112..400).map(|number| plan(number, 20)));
        plans.push(plan(400, codec::MESSAGE_BYTES_MAX - FRAME - 100));
        let (parts, unfit) = ActiveMissions::split(cluster, plans.clone());
        assert_eq!(unfit, []);
        for part in &parts {
            let said = codec::encode(part).expect("a part fits");
            codec::encode(&ClusterEnvelope { cluster, payload: said }).expect("with its envelope, too");
        }
        assert!(parts.len() <= 8, "{} parts", parts.len());
        assert_eq!(ActiveMissions::join(parts), Some(ActiveMissions { cluster, count: 301, plans }));
    }

    #[test]
    fn a_plan_that_fits_no_message_does_not_hold_up_the_others() {
        let (parts, unfit) =
            ActiveMissions::split(None, vec![plan(1, 20), plan(2, codec::MESSAGE_BYTES_MAX), plan(3, 20)]);
        assert_eq!(unfit, [plan(2, codec::MESSAGE_BYTES_MAX)]);
        assert_eq!(ActiveMissions::join(parts).unwrap().plans, [plan(1, 20), plan(3, 20)]);
    }

    #[test]
    fn an_answer_of_which_a_part_is_lacking_is_none() {
        let (parts, _) = ActiveMissions::split(None, (1..6).map(|number| plan(number, 30_000)).collect());
        assert!(parts.len() > 1);
        for lost in 0..parts.len() {
            let mut heard = parts.clone();
            heard.remove(lost);
            assert_eq!(ActiveMissions::join(heard), None);
        }
        let repeated = parts.iter().chain(&parts).cloned().collect();
        assert_eq!(ActiveMissions::join(repeated).unwrap().plans.len(), 5);
        assert_eq!(ActiveMissions::join(vec![]), None, "no answer is none");
        let (nothing, _) = ActiveMissions::split(None, vec![]);
        assert_eq!(ActiveMissions::join(nothing).unwrap().plans, [], "and nothing under way is one");
    }

    #[test]
    fn parts_of_two_answers_are_not_put_together() {
        let (mut parts, _) = ActiveMissions::split(Some(ClusterId(1)), vec![plan(1, 20)]);
        parts.extend(ActiveMissions::split(Some(ClusterId(2)), vec![plan(1, 20)]).0);
        assert_eq!(ActiveMissions::join(parts), None);
    }
}
