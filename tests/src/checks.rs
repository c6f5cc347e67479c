//! What must hold in every story.

use crate::{Fleet, RoleInterval};
use consort_protocol::ids::MissionId;
use consort_sim::world::SampleHolder;

impl Fleet {
    /// No task was begun or ended twice, and what was begun was ended.
    ///
    /// # Panics
    /// When it is not so.
    pub fn assert_each_task_once(&self, mission: &MissionId) {
        let tasks = self.task_counts(mission);
        assert!(!tasks.is_empty(), "seed {}: {mission} has no tasks\n{}", self.seed, self.event_log_text());
        for (task, counts) in tasks {
            assert_eq!(
                counts,
                (1, 1),
                "seed {}: {task} of {mission} (begun, ended)\n{}",
                self.seed,
                self.event_log_text()
            );
        }
    }

    /// The sample of a room went from its nurse into one robot's drawer, and from there to the arm: once each.
    ///
    /// # Panics
    /// When it is not so.
    pub fn assert_sample_delivered(&self, room: &str) {
        let id = format!("sample of {room}").as_str().into();
        let sample = self.world.with(|world| world.sample(&id).expect("a sample of this world"));
        let story = format!("seed {}: sample of {room}: {sample:?}\n{}", self.seed, self.event_log_text());
        let mut keepers = sample.history.iter().map(|(_, keeper)| keeper).chain([&sample.keeper]).collect::<Vec<_>>();
        // An arm lays down what it holds when the next sample comes.
        keepers.pop_if(|last| matches!(last, SampleHolder::Table(_)));
        assert_eq!(sample.place.as_str(), "Laboratory", "{story}");
        assert!(
            matches!(keepers[..], [SampleHolder::Person(_), SampleHolder::Drawer(_), SampleHolder::Arm(_)]),
            "{story}"
        );
    }

    /// At no instant did one robot act in two roles, or two robots in one.
    ///
    /// # Panics
    /// When they did.
    pub fn assert_exclusive_roles(&self) {
        let spells = self.event_log.role_intervals();
        for (index, one) in spells.iter().enumerate() {
            for other in &spells[index + 1..] {
                let same_role = (&one.mission, &one.role) == (&other.mission, &other.role);
                let clash = one.overlaps(other) && (one.robot == other.robot || same_role);
                assert!(!clash, "seed {}: {one:?} and {other:?}\n{}", self.seed, self.event_log_text());
            }
        }
    }

    /// Who acted in a role, in order.
    pub fn role_intervals_of(&self, mission: &MissionId, role: &str) -> Vec<RoleInterval> {
        let spells = self.event_log.role_intervals().into_iter();
        spells.filter(|spell| spell.mission == *mission && spell.role.as_str() == role).collect()
    }
}
