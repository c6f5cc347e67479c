//! Assertions that hold in every test of a whole fleet.

use crate::{Fleet, RoleInterval};
use consort_protocol::ids::MissionId;
use consort_world::world::SampleHolder;

impl Fleet {
    /// Asserts that each task of the mission began once and ended once.
    ///
    /// # Panics
    /// If a task began or ended more or less than once, or if the mission has no tasks.
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

    /// Asserts that the sample of a room moved once from its nurse into the drawer of a robot, and
    /// once from there to the arm.
    ///
    /// # Panics
    /// If the sample took another path.
    pub fn assert_sample_delivered(&self, room: &str) {
        let id = format!("sample of {room}").as_str().into();
        let sample = self.world.with(|world| world.sample(&id).expect("a sample of this world"));
        let context = format!("seed {}: sample of {room}: {sample:?}\n{}", self.seed, self.event_log_text());
        let mut holders = sample.history.iter().map(|(_, holder)| holder).chain([&sample.holder]).collect::<Vec<_>>();
        // An arm lays down what it holds when the next sample arrives.
        holders.pop_if(|last| matches!(last, SampleHolder::Table(_)));
        assert_eq!(sample.place.as_str(), "Laboratory", "{context}");
        assert!(
            matches!(holders[..], [SampleHolder::Person(_), SampleHolder::Drawer(_), SampleHolder::Arm(_)]),
            "{context}"
        );
    }

    /// Asserts that no robot acted in two roles at once, and that no role had two active robots at
    /// once.
    ///
    /// # Panics
    /// If two intervals overlap.
    pub fn assert_exclusive_roles(&self) {
        let intervals = self.event_log.role_intervals();
        for (index, one) in intervals.iter().enumerate() {
            for other in &intervals[index + 1..] {
                let same_role = (&one.mission, &one.role) == (&other.mission, &other.role);
                let clash = one.overlaps(other) && (one.robot == other.robot || same_role);
                assert!(!clash, "seed {}: {one:?} and {other:?}\n{}", self.seed, self.event_log_text());
            }
        }
    }

    /// Returns the intervals in which robots acted in a role, in order.
    pub fn role_intervals_of(&self, mission: &MissionId, role: &str) -> Vec<RoleInterval> {
        let intervals = self.event_log.role_intervals().into_iter();
        intervals.filter(|interval| interval.mission == *mission && interval.role.as_str() == role).collect()
    }
}
