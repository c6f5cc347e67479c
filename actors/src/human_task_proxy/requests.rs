//! What people are asked to do, and which asks are to be called off, as values.

use crate::robot::StepRef;
use consort_protocol::codec;
use consort_protocol::ids::{ClusterId, MissionId, RobotId, RoleId, TaskId};
use consort_protocol::lease::RoleHolder;
use consort_protocol::ledger::Branch;
use consort_protocol::mission::TaskSpec;
use consort_skills::actions::{GoalId, PersonRequest};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// Dismissals that are repeated at a time; the oldest are given up beyond. Raised: more questions at each beat to a host of
/// people that does not answer. A guess: each is of a mission that ended, or lost a robot, while somebody was asked.
const DISMISSALS_MAX: usize = 64;

/// What an ask is about.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct RequestSubject {
    /// A ledger founded anew may have another mission of the same name.
    pub(super) cluster: Option<ClusterId>,
    pub(super) mission: MissionId,
    pub(super) branch: Branch,
    pub(super) role: RoleId,
    pub(super) task: TaskId,
    pub(super) spec: TaskSpec,
    /// A robot that gets its role back has another award, and is met anew.
    pub(super) holders: BTreeMap<RoleId, RoleHolder>,
}

/// Something that a person was asked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OpenRequest {
    pub(super) step: StepRef,
    matter: RequestSubject,
    /// How often it was asked before, and called off by somebody who did not know better.
    turn: u32,
}

impl OpenRequest {
    pub(super) fn first(spot: StepRef, matter: RequestSubject) -> OpenRequest {
        OpenRequest { step: spot, matter, turn: 0 }
    }

    /// Whoever asks about the same for the same time, be it another attendant or a later life of this one, asks under the
    /// same id: FNV-1a (Fowler, Noll, Vo) over what the ask is about.
    pub(super) fn id(&self) -> GoalId {
        let about = codec::encode_record(&(&self.matter, self.turn)).expect("an ask is smaller than a record");
        let step = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        GoalId(about.iter().fold(0xcbf2_9ce4_8422_2325, step))
    }

    /// What the host of people is told.
    pub(super) fn request(&self) -> PersonRequest {
        let RequestSubject { role, spec, holders, .. } = &self.matter;
        PersonRequest { role: role.clone(), task: spec.clone(), holders: RoleHolder::robots(holders) }
    }

    /// Whether the robots to be met, or their awards, are others by now.
    pub(super) fn is_outdated(&self, holders: &BTreeMap<RoleId, RoleHolder>) -> bool {
        self.matter.holders != *holders
    }

    /// The ask was called off, yet is still wanted: an id that was called off is not served again.
    pub(super) fn renew(&mut self) {
        self.turn += 1;
    }
}

/// Asks that were called off and of which the host of people has not said that it heard so, oldest first.
#[derive(Debug, Default)]
pub(super) struct PendingCancellations(VecDeque<GoalId>);

impl PendingCancellations {
    pub(super) fn add(&mut self, id: GoalId) {
        self.confirm(id);
        self.0.push_back(id);
        if self.0.len() > DISMISSALS_MAX {
            self.0.pop_front();
        }
    }

    /// The ask has ended, one way or the other.
    pub(super) fn confirm(&mut self, id: GoalId) {
        self.0.retain(|known| *known != id);
    }

    /// Those to be repeated.
    pub(super) fn pending(&self) -> impl Iterator<Item = GoalId> {
        self.0.iter().copied()
    }
}

/// Words by which missions were called off that are known again. The host of people repeats a word for some beats, 2.5 s
/// with its defaults, and not later; more than so many others are not said meanwhile by people who each stand at a place.
/// Raised: more memory, nothing else.
const WORDS_MAX: usize = 256;

/// The latest words by which people called missions off, oldest first, so that a repeated one does not call off the next
/// mission too.
#[derive(Debug, Default)]
pub(super) struct RecentCancelOrders(VecDeque<(String, RobotId, u64)>);

impl RecentCancelOrders {
    /// Whether a word was not heard before: who said it, to which robot, and when on the world's clock.
    pub(super) fn is_new(&mut self, by: &str, robot: &RobotId, said_ms: u64) -> bool {
        let known = |(other, to, at): &(String, RobotId, u64)| other == by && to == robot && *at == said_ms;
        if self.0.iter().any(known) {
            return false;
        }
        self.0.push_back((by.to_owned(), robot.clone(), said_ms));
        if self.0.len() > WORDS_MAX {
            self.0.pop_front();
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::TaskType;
    use consort_protocol::lease::Epoch;

    fn matter(holders: &[(&str, &str, u64)]) -> RequestSubject {
        let role = |name: &str| RoleId::new(name).unwrap();
        let holding = |(of, robot, index): &(&str, &str, u64)| {
            (role(of), RoleHolder { robot: RobotId::new(*robot).unwrap(), epoch: Epoch { term: 1, index: *index } })
        };
        RequestSubject {
            cluster: Some(ClusterId(7)),
            mission: MissionId::new("lab-samples-1").unwrap(),
            branch: Branch::Main,
            role: role("nurse"),
            task: TaskId::new("deposit").unwrap(),
            spec: TaskSpec::of(TaskType::new("deposit").unwrap(), vec![role("nurse")]),
            holders: holders.iter().map(holding).collect(),
        }
    }

    fn id(matter: RequestSubject) -> GoalId {
        OpenRequest::first(StepRef::Step(0), matter).id()
    }

    #[test]
    fn a_robot_that_gets_its_role_back_is_asked_for_anew() {
        let both = matter(&[("lab_arm", "arm", 2), ("r1", "amber", 2)]);
        let alone = matter(&[("r1", "amber", 2)]);
        let again = matter(&[("lab_arm", "arm", 9), ("r1", "amber", 2)]);
        let ids = std::collections::BTreeSet::from([id(both.clone()), id(alone), id(again.clone())]);
        assert_eq!(ids.len(), 3);
        let asked = OpenRequest::first(StepRef::Step(0), both.clone());
        assert!(asked.is_outdated(&again.holders) && !asked.is_outdated(&both.holders));
        assert_eq!(id(both.clone()), id(both), "and the same ask has the same id, whoever asks");
    }

    #[test]
    fn missions_of_one_name_in_two_clusters_and_branches_are_asked_for_apart() {
        let here = matter(&[("r1", "amber", 2)]);
        let founded_anew = RequestSubject { cluster: Some(ClusterId(8)), ..here.clone() };
        let recovered = RequestSubject { branch: Branch::Recovery, ..here.clone() };
        let ids = std::collections::BTreeSet::from([id(here), id(founded_anew), id(recovered)]);
        assert_eq!(ids.len(), 3);
    }

    #[test]
    fn what_was_called_off_and_is_still_wanted_is_asked_under_another_id() {
        let mut asked = OpenRequest::first(StepRef::Step(0), matter(&[]));
        let first = asked.id();
        asked.renew();
        assert_ne!(asked.id(), first);
        let mut other_life = OpenRequest::first(StepRef::Step(0), matter(&[]));
        other_life.renew();
        assert_eq!(other_life.id(), asked.id(), "which every attendant comes to");
    }

    #[test]
    fn a_word_is_known_again_for_as_long_as_it_is_repeated_and_not_for_ever() {
        let mut words = RecentCancelOrders::default();
        let amber = RobotId::new("amber").unwrap();
        assert!(words.is_new("Nia", &amber, 1000));
        assert!(!words.is_new("Nia", &amber, 1000), "repeated");
        for said_ms in [0, 2000] {
            assert!(words.is_new("Nia", &amber, said_ms), "another word, be it of a world that began anew");
        }
        assert!(words.is_new("Ria", &amber, 1000) && words.is_new("Nia", &RobotId::new("birch").unwrap(), 1000));
        assert!(!words.is_new("Nia", &amber, 1000));
        (10_000..20_000).for_each(|said_ms| assert!(words.is_new("Nia", &amber, said_ms)));
        assert_eq!(words.0.len(), WORDS_MAX, "and there is an end to it");
        assert!(!words.is_new("Nia", &amber, 19_999) && words.is_new("Nia", &amber, 1000));
    }

    #[test]
    fn a_dismissal_is_repeated_until_it_is_answered() {
        let mut dismissals = PendingCancellations::default();
        [1, 2, 1].into_iter().for_each(|id| dismissals.add(GoalId(id)));
        assert_eq!(dismissals.pending().collect::<Vec<_>>(), [GoalId(2), GoalId(1)]);
        assert_eq!(dismissals.pending().count(), 2, "looking at them does not end them");
        dismissals.confirm(GoalId(2));
        assert_eq!(dismissals.pending().collect::<Vec<_>>(), [GoalId(1)]);
        (10..200).for_each(|id| dismissals.add(GoalId(id)));
        assert_eq!(dismissals.pending().count(), DISMISSALS_MAX, "and there is an end to it");
    }
}
