//! The drive of a robot because of an alarm, as a value: to an assembly place, or back to its plan after the alarm.

use super::own_tasks::{OwnTask, nearest};
use consort_protocol::ids::PlaceId;
use consort_protocol::units::{NodeTime, WorldTime};
use consort_skills::descriptor::{EstimateContext, Estimator};
use ractor::ActorId;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Node time for which a robot prefers other assembly places to one that it did not reach. A guess: most obstacles
/// are gone by then.
const AVOID_TIME: Duration = Duration::from_secs(60);

/// Node time after which a robot that did not reach a place tries again, unless there is another. A guess.
const RETRY_TIME: Duration = Duration::from_secs(5);

/// Drive of a robot because of an alarm.
#[derive(Default)]
pub(super) struct AlarmDrive {
    trip: Option<Trip>,
    /// Assembly place that the robot has reached.
    reached: Option<PlaceId>,
    /// Assembly places that the robot did not reach, until these times.
    avoided: BTreeMap<PlaceId, NodeTime>,
    /// Earliest time of the next drive back to the plan.
    returns_from: NodeTime,
}

/// Destination of a drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum AlarmDestination {
    /// An assembly place.
    Assembly(PlaceId),
    /// The place where the plan goes on.
    Return(PlaceId),
}

struct Trip {
    to: AlarmDestination,
    /// Present once its skill has started.
    task: Option<OwnTask>,
}

impl AlarmDestination {
    /// Returns the place.
    pub(super) fn place(&self) -> &PlaceId {
        match self {
            AlarmDestination::Assembly(place) | AlarmDestination::Return(place) => place,
        }
    }
}

impl AlarmDrive {
    /// Checks whether the robot drives.
    pub(super) fn is_driving(&self) -> bool {
        self.trip.is_some()
    }

    /// Checks whether the robot drives to an assembly place.
    pub(super) fn is_assembling(&self) -> bool {
        self.trip.as_ref().is_some_and(|trip| matches!(trip.to, AlarmDestination::Assembly(_)))
    }

    /// Checks whether the plan may go on: the robot neither drives nor waits to drive.
    pub(super) fn lets_plan_act(&self, now: NodeTime) -> bool {
        self.trip.is_none() && now >= self.returns_from
    }

    /// Checks whether the robot drives to a place where it is no longer expected. `assembly` are the places to which it
    /// may drive now, and `back` is the place where its plan may go on.
    pub(super) fn is_obsolete(&self, assembly: Option<&BTreeSet<PlaceId>>, back: Option<&PlaceId>) -> bool {
        self.trip.as_ref().is_some_and(|trip| match &trip.to {
            AlarmDestination::Assembly(place) => !assembly.is_some_and(|places| places.contains(place)),
            AlarmDestination::Return(place) => back != Some(place),
        })
    }

    /// Returns the nearest assembly place that can be reached. Returns `None` while the robot drives, and once it has
    /// reached one of the places. A place that was not reached lately comes last, and after a pause.
    pub(super) fn next_place(
        &mut self,
        places: &BTreeSet<PlaceId>,
        estimator: &Estimator,
        context: &EstimateContext,
        now: NodeTime,
    ) -> Option<PlaceId> {
        self.avoided.retain(|_, until| now < *until);
        if self.trip.is_some() || self.reached.as_ref().is_some_and(|reached| places.contains(reached)) {
            return None;
        }
        let mut drives = nearest(estimator, context, places);
        drives.sort_by_key(|drive| self.avoided.contains_key(&drive.to));
        let has_paused = |until: &NodeTime| now + (AVOID_TIME - RETRY_TIME) >= *until;
        let mut ordered = drives.into_iter().map(|drive| drive.to);
        ordered.find(|place| self.avoided.get(place).is_none_or(has_paused))
    }

    /// Begins a drive.
    pub(super) fn begin(&mut self, to: AlarmDestination) {
        self.trip = Some(Trip { to, task: None });
        self.reached = None;
    }

    /// Records that the skill of the drive has started.
    pub(super) fn set_running(&mut self, task: OwnTask) {
        if let Some(trip) = &mut self.trip {
            trip.task = Some(task);
        }
    }

    /// Returns the reason to abort the drive, if any.
    pub(super) fn check_timer(&mut self, world: Option<WorldTime>, silent_for: Duration) -> Option<String> {
        self.task_mut()?.timer.check(world, silent_for)
    }

    /// Returns the running drive.
    pub(super) fn task_mut(&mut self) -> Option<&mut OwnTask> {
        self.trip.as_mut()?.task.as_mut()
    }

    /// Checks whether the drive is this run of a skill.
    pub(super) fn is_run(&self, run: u64) -> bool {
        self.task().is_some_and(|task| task.skill.run() == run)
    }

    /// Checks whether this actor executes the drive.
    pub(super) fn is_executed_by(&self, actor: ActorId) -> bool {
        self.task().is_some_and(|task| task.skill.is_executed_by(actor))
    }

    fn task(&self) -> Option<&OwnTask> {
        self.trip.as_ref()?.task.as_ref()
    }

    /// Ends a drive that has succeeded. Returns its destination.
    pub(super) fn succeed(&mut self) -> Option<AlarmDestination> {
        let to = self.trip.take()?.to;
        if let AlarmDestination::Assembly(place) = &to {
            self.reached = Some(place.clone());
        }
        Some(to)
    }

    /// Ends a drive that has failed. The robot drives elsewhere, or again after a pause.
    pub(super) fn fail(&mut self, now: NodeTime) {
        match self.end_trip() {
            Some(AlarmDestination::Assembly(place)) => {
                self.avoided.insert(place, now + AVOID_TIME);
            }
            Some(AlarmDestination::Return(_)) => self.returns_from = now + RETRY_TIME,
            None => {}
        }
    }

    /// Ends the drive, which no longer serves.
    pub(super) fn stop(&mut self) {
        self.end_trip();
    }

    /// Forgets the reached place: the robot is no longer expected at assembly places.
    pub(super) fn end_assembly(&mut self) {
        self.reached = None;
    }

    fn end_trip(&mut self) -> Option<AlarmDestination> {
        let Trip { to, task } = self.trip.take()?;
        if let Some(task) = task {
            task.skill.halt();
        }
        Some(to)
    }
}

#[cfg(test)]
mod tests {
    use super::super::energy_check::pricing_context;
    use super::super::test_values::{at, idle_robot};
    use super::*;
    use consort_protocol::pose::Pose;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::environment::{Edge, Environment, Routes, SpeedLimits, TopologicalMap};

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn places(names: &[&str]) -> BTreeSet<PlaceId> {
        names.iter().map(|name| place(name)).collect()
    }

    /// Returns the next place of a robot in the middle of a map Near – Dock – Gate – Far.
    fn next(drive: &mut AlarmDrive, names: &[&str], closed: &[(PlaceId, PlaceId)], now: NodeTime) -> Option<String> {
        let edge = |a: &str, b: &str| Edge { a: place(a), b: place(b), length_m: 10.0, one_way: false };
        let positions = [("Near", -10.0), ("Dock", 0.0), ("Gate", 10.0), ("Far", 20.0)];
        let map = TopologicalMap {
            places: positions.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
            edges: vec![edge("Near", "Dock"), edge("Dock", "Gate"), edge("Gate", "Far")],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
        let context = pricing_context(&idle_robot(), closed, &SpeedLimits::default());
        drive.next_place(&places(names), &estimator, &context, now).map(|place| place.to_string())
    }

    #[test]
    fn a_robot_drives_once_to_the_nearest_place_that_it_can_reach() {
        let mut drive = AlarmDrive::default();
        let gate = [(place("Gate"), place("Gate"))];
        assert_eq!(next(&mut drive, &["Far"], &gate, at(0)), None, "it cannot reach any");
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(0)).as_deref(), Some("Near"));
        drive.begin(AlarmDestination::Assembly(place("Near")));
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(0)), None, "it drives");
        assert!(drive.is_assembling() && !drive.lets_plan_act(at(0)));
        assert_eq!(drive.succeed(), Some(AlarmDestination::Assembly(place("Near"))));
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(0)), None, "it is there");
        assert_eq!(next(&mut drive, &["Far"], &[], at(0)).as_deref(), Some("Far"), "another alarm");
        drive.end_assembly();
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(0)).as_deref(), Some("Near"), "the next alarm");
    }

    #[test]
    fn a_place_that_was_not_reached_comes_last_for_a_while() {
        let mut drive = AlarmDrive::default();
        drive.begin(AlarmDestination::Assembly(place("Near")));
        drive.fail(at(1_000));
        assert_eq!(next(&mut drive, &["Near"], &[], at(5_999)), None, "there is no other");
        assert_eq!(next(&mut drive, &["Near"], &[], at(6_000)).as_deref(), Some("Near"));
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(60_999)).as_deref(), Some("Far"));
        assert_eq!(next(&mut drive, &["Far", "Near"], &[], at(61_000)).as_deref(), Some("Near"));
    }

    #[test]
    fn a_drive_is_obsolete_when_the_robot_is_no_longer_expected_there() {
        let mut drive = AlarmDrive::default();
        let (near, dock) = (place("Near"), place("Dock"));
        assert!(!drive.is_obsolete(None, None));
        drive.begin(AlarmDestination::Assembly(near.clone()));
        assert!(!drive.is_obsolete(Some(&places(&["Near", "Far"])), None));
        assert!(drive.is_obsolete(Some(&places(&["Far"])), None), "another alarm");
        assert!(drive.is_obsolete(None, Some(&near)), "the alarm is cleared");
        drive.begin(AlarmDestination::Return(dock.clone()));
        assert!(!drive.is_obsolete(None, Some(&dock)) && drive.is_obsolete(None, None));
        assert!(drive.is_obsolete(Some(&places(&["Dock"])), None), "another alarm");
    }

    #[test]
    fn the_plan_waits_for_the_way_back_and_for_its_next_attempt() {
        let mut drive = AlarmDrive::default();
        drive.begin(AlarmDestination::Return(place("Dock")));
        assert!(!drive.lets_plan_act(at(0)) && !drive.is_assembling());
        drive.fail(at(1_000));
        assert!(!drive.lets_plan_act(at(5_999)) && drive.lets_plan_act(at(6_000)));
        drive.begin(AlarmDestination::Return(place("Dock")));
        assert_eq!(drive.succeed(), Some(AlarmDestination::Return(place("Dock"))));
        assert!(drive.lets_plan_act(at(6_000)));
    }
}
