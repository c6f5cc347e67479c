//! Time limits of tasks, as values.

use consort_protocol::ids::PlaceId;
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{Seconds, WorldTime};
use consort_skills::descriptor::{EstimateContext, EstimateError, Estimator};
use std::time::Duration;

/// Time limit for a task.
///
/// Tasks take place in the world, so they are timed by the driver's clock, never by the node's
/// clock. A driver without reports provides no clock: it gets `report_timeout` on the node's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TaskTimeout {
    /// Factor on the estimated duration. Raised: slow floors are tolerated, a stuck robot is
    /// noticed later. Default 3 (a guess: people and other robots in the way double a drive).
    pub(crate) factor: f64,
    /// Additional world time, so that the skill of a short task can retry by itself. Default 60 s
    /// (a guess).
    pub(crate) margin: Seconds,
    /// World time for a task that needs another participant: a joint task, or a task whose
    /// parameters name another role (`person_role`, `robot_role`, `from_role`, …). No estimate
    /// predicts the duration for people. Default 600 s (a guess: a clerk is called away, and
    /// returns).
    pub(crate) cooperative: Seconds,
    /// Node time without a report of the driver. Default 60 s: longer than a restart of its server
    /// takes.
    pub(crate) report_timeout: Duration,
}

impl Default for TaskTimeout {
    fn default() -> Self {
        let seconds = |number| Seconds::new(number).expect("a duration");
        TaskTimeout {
            factor: 3.0,
            margin: seconds(60.0),
            cooperative: seconds(600.0),
            report_timeout: Duration::from_secs(60),
        }
    }
}

impl TaskTimeout {
    /// Returns the time limit of a task in world time, from the robot's own estimate. Without an
    /// estimate, the limit is that of a cooperative task.
    pub(super) fn limit(&self, spec: &TaskSpec, estimate: Option<Seconds>) -> Seconds {
        match estimate {
            Some(time) if !is_cooperative(spec) => {
                Seconds::new(time.get() * self.factor).unwrap_or(self.cooperative) + self.margin
            }
            _ => self.cooperative,
        }
    }
}

/// Checks whether a task needs another participant. In the skill library, every parameter that
/// names a role ends in `role`.
fn is_cooperative(spec: &TaskSpec) -> bool {
    spec.is_joint() || spec.parameters.keys().any(|key| key == "role" || key.ends_with("_role"))
}

/// Checks whether people have closed every route of a task. `found` are the closed lanes that they have not closed.
pub(super) fn is_closed_by_people(
    estimator: &Estimator,
    task: &TaskSpec,
    context: &EstimateContext,
    found: Vec<(PlaceId, PlaceId)>,
) -> bool {
    let has_route = |context: &EstimateContext| {
        let estimate = estimator.estimate(task, context);
        !matches!(estimate, Err(EstimateError::Route(_)))
    };
    !has_route(context) && has_route(&EstimateContext { closed: found, ..context.clone() })
}

/// Timer of a single attempt at a task.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TaskTimer {
    limit: Seconds,
    silence: Duration,
    started: Option<WorldTime>,
}

impl TaskTimer {
    /// Creates the timer of an attempt that starts now.
    pub(super) fn new(timeout: &TaskTimeout, spec: &TaskSpec, estimate: Option<Seconds>) -> TaskTimer {
        TaskTimer { limit: timeout.limit(spec, estimate), silence: timeout.report_timeout, started: None }
    }

    /// Lets the time limit begin again at the next check.
    pub(super) fn restart(&mut self) {
        self.started = None;
    }

    /// Gives the attempt at least the time of another timer, which starts now.
    pub(super) fn extend(&mut self, other: TaskTimer, world: Option<WorldTime>) {
        let taken_s = world.zip(self.started).map_or(0.0, |(now, started)| now.as_secs() - started.as_secs());
        if other.limit.get() > self.limit.get() - taken_s {
            *self = other;
        }
    }

    /// Returns the reason to abort the attempt, if any. Call it periodically with the driver's
    /// clock and the age of that reading.
    pub(super) fn check(&mut self, world: Option<WorldTime>, silent_for: Duration) -> Option<String> {
        if silent_for >= self.silence {
            return Some(format!("the driver has reported nothing for {} s", silent_for.as_secs()));
        }
        let now = world?;
        // A clock that runs backwards belongs to another world: its server has restarted.
        let started = *self.started.get_or_insert(now);
        if now < started {
            self.started = Some(now);
            return None;
        }
        let taken = now.as_secs() - started.as_secs();
        (taken > self.limit.get()).then(|| format!("not completed after {taken:.0} s; the limit is {:.0}", self.limit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::energy_check::pricing_context;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::pose::Pose;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::environment::{Edge, Environment, Routes, SpeedLimits, TopologicalMap};
    use std::collections::BTreeMap;

    fn task(parameters: &[(&str, &str)]) -> TaskSpec {
        let parameters: BTreeMap<_, _> = parameters.iter().map(|(key, value)| (key, value)).collect();
        let json = serde_json::json!({ "type": "drive", "roles": ["r1"], "parameters": parameters });
        serde_json::from_value(json).unwrap()
    }

    fn seconds(number: f64) -> Seconds {
        Seconds::new(number).unwrap()
    }

    fn at(seconds: f64) -> Option<WorldTime> {
        Some(WorldTime::from_secs(seconds))
    }

    #[test]
    fn the_limit_is_three_times_the_estimate_plus_a_minute() {
        let timeout = TaskTimeout::default();
        assert_eq!(timeout.limit(&task(&[("to", "Dock")]), Some(seconds(40.0))), seconds(180.0));
        assert_eq!(timeout.limit(&task(&[]), None), seconds(600.0));
    }

    #[test]
    fn a_cooperative_task_has_a_longer_limit() {
        let timeout = TaskTimeout::default();
        assert_eq!(timeout.limit(&task(&[("person_role", "clerk")]), Some(seconds(2.0))), seconds(600.0));
        let mut joint = task(&[]);
        joint.roles.push("arm".parse().unwrap());
        assert_eq!(timeout.limit(&joint, Some(seconds(2.0))), seconds(600.0));
    }

    #[test]
    fn the_timer_uses_the_drivers_clock() {
        let mut timer = TaskTimer::new(&TaskTimeout::default(), &task(&[]), Some(seconds(0.0)));
        let fresh = Duration::ZERO;
        assert_eq!(timer.check(None, fresh), None);
        assert_eq!(timer.check(at(1000.0), fresh), None, "starts with the first reading");
        assert_eq!(timer.check(at(1060.0), fresh), None);
        assert_eq!(timer.check(at(1061.0), fresh).unwrap(), "not completed after 61 s; the limit is 60 s");
        assert_eq!(timer.check(at(3.0), fresh), None, "another world");
        assert_eq!(timer.check(at(62.0), fresh), None);
        assert_eq!(timer.check(at(64.0), fresh).unwrap(), "not completed after 61 s; the limit is 60 s");
    }

    /// A leg that the robot drives slowly takes as long as before when the speed limit is cleared on its way.
    #[test]
    fn an_extended_timer_leaves_no_less_time_than_before() {
        let timer = |estimate_s| TaskTimer::new(&TaskTimeout::default(), &task(&[]), Some(seconds(estimate_s)));
        let (mut timer_of_slow_drive, fresh) = (timer(200.0), Duration::ZERO);
        assert_eq!(timer_of_slow_drive.check(at(1000.0), fresh), None);
        timer_of_slow_drive.extend(timer(20.0), at(1100.0));
        assert_eq!(timer_of_slow_drive.check(at(1660.0), fresh), None, "660 s from the start");
        timer_of_slow_drive.extend(timer(20.0), at(1660.0));
        assert_eq!(timer_of_slow_drive.check(at(1660.0), fresh), None);
        assert_eq!(timer_of_slow_drive.check(at(1780.0), fresh), None, "120 s more");
        assert!(timer_of_slow_drive.check(at(1781.0), fresh).is_some());
    }

    #[test]
    fn a_driver_without_reports_times_out() {
        let mut timer = TaskTimer::new(&TaskTimeout::default(), &task(&[]), None);
        assert_eq!(timer.check(None, Duration::from_secs(59)), None);
        assert_eq!(timer.check(None, Duration::from_secs(60)).unwrap(), "the driver has reported nothing for 60 s");
    }

    #[test]
    fn a_task_is_closed_by_people_if_it_has_a_route_without_their_closures() {
        let place = |name: &str| -> PlaceId { name.parse().unwrap() };
        let map = TopologicalMap {
            places: [("Dock", 0.0), ("Ward", 10.0)].map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
            edges: vec![Edge { a: place("Dock"), b: place("Ward"), length_m: 10.0, one_way: false }],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
        let drive = serde_json::json!({ "type": "navigation", "roles": ["r1"], "parameters": { "to": "Ward" } });
        let drive: TaskSpec = serde_json::from_value(drive).unwrap();
        let is_closed = |by_people: &[(PlaceId, PlaceId)], found: &[(PlaceId, PlaceId)]| {
            let context = pricing_context(&idle_robot(), &[found, by_people].concat(), &SpeedLimits::default());
            is_closed_by_people(&estimator, &drive, &context, found.to_vec())
        };
        let (ward, lane) = (vec![(place("Ward"), place("Ward"))], vec![(place("Dock"), place("Ward"))]);
        assert!(is_closed(&ward, &[]));
        assert!(!is_closed(&[], &[]));
        assert!(!is_closed(&[], &lane), "the driver has found the way closed");
        assert!(!is_closed(&ward, &lane), "the way stays closed when people open the ward");
    }
}
