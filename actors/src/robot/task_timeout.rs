//! How long a task may take before the robot gives it up for lost, as values.

use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{Seconds, WorldTime};
use std::time::Duration;

/// How long a robot waits for a task to end.
///
/// Tasks take place in the world, so they are timed by the body's own clock, never by the node's. A body that reports
/// nothing has no clock to go by: it is given `silence` on the node's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TaskTimeout {
    /// How many times as long as estimated a task may take. Raised: slower floors are put up with, a robot that is stuck
    /// is noticed later. Default 3 (a guess: people and other robots in the way double a drive).
    pub factor: f64,
    /// World time beyond that, so that short tasks may be tried again by their own skill. Default 60 s (a guess).
    pub margin: Seconds,
    /// World time for a task that takes somebody else to be done: a joint one, or one whose parameters name another role
    /// (`person_role`, `robot_role`, `from_role`, …). No estimate tells how long people take. Default 600 s (a guess: a
    /// nurse is called away, and returns).
    pub cooperative: Seconds,
    /// Node time without any report of the body. Default 60 s: longer than its host takes to be started anew.
    pub report_timeout: Duration,
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
    /// How long a task may take in the world, given the robot's own estimate of it; without one, as long as one that takes
    /// company.
    pub fn limit(&self, spec: &TaskSpec, estimate: Option<Seconds>) -> Seconds {
        match estimate {
            Some(time) if !takes_company(spec) => {
                Seconds::new(time.get() * self.factor).unwrap_or(self.cooperative) + self.margin
            }
            _ => self.cooperative,
        }
    }
}

/// Whether a task cannot be done alone. Parameters that name a role end in `role` throughout the library of skills.
fn takes_company(spec: &TaskSpec) -> bool {
    spec.is_joint() || spec.parameters.keys().any(|key| key == "role" || key.ends_with("_role"))
}

/// One attempt at a task, timed.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskTimer {
    bound: Seconds,
    silence: Duration,
    began: Option<WorldTime>,
}

impl TaskTimer {
    /// For an attempt that begins now.
    pub fn new(patience: &TaskTimeout, spec: &TaskSpec, estimate: Option<Seconds>) -> TaskTimer {
        TaskTimer { bound: patience.limit(spec, estimate), silence: patience.report_timeout, began: None }
    }

    /// Why the attempt is to be broken off, if it is; to be asked every now and then with the body's clock and how long ago
    /// it was read.
    pub fn check(&mut self, world: Option<WorldTime>, silent_for: Duration) -> Option<String> {
        if silent_for >= self.silence {
            return Some(format!("the body has reported nothing for {} s", silent_for.as_secs()));
        }
        let now = world?;
        // A clock that went back is another world's: its host has started anew.
        let began = *self.began.get_or_insert(now);
        if now < began {
            self.began = Some(now);
            return None;
        }
        let taken = now.as_secs() - began.as_secs();
        (taken > self.bound.get()).then(|| format!("no end after {taken:.0} s; allowed were {:.0}", self.bound))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn a_task_may_take_thrice_its_estimate_and_a_minute() {
        let patience = TaskTimeout::default();
        assert_eq!(patience.limit(&task(&[("to", "Dock")]), Some(seconds(40.0))), seconds(180.0));
        assert_eq!(patience.limit(&task(&[]), None), seconds(600.0));
    }

    #[test]
    fn a_task_that_takes_somebody_else_may_take_much_longer() {
        let patience = TaskTimeout::default();
        assert_eq!(patience.limit(&task(&[("person_role", "nurse")]), Some(seconds(2.0))), seconds(600.0));
        let mut joint = task(&[]);
        joint.roles.push("arm".parse().unwrap());
        assert_eq!(patience.limit(&joint, Some(seconds(2.0))), seconds(600.0));
    }

    #[test]
    fn time_is_the_bodys() {
        let mut watch = TaskTimer::new(&TaskTimeout::default(), &task(&[]), Some(seconds(0.0)));
        let fresh = Duration::ZERO;
        assert_eq!(watch.check(None, fresh), None);
        assert_eq!(watch.check(at(1000.0), fresh), None, "begins with the first reading");
        assert_eq!(watch.check(at(1060.0), fresh), None);
        assert_eq!(watch.check(at(1061.0), fresh).unwrap(), "no end after 61 s; allowed were 60 s");
        assert_eq!(watch.check(at(3.0), fresh), None, "another world");
        assert_eq!(watch.check(at(62.0), fresh), None);
        assert_eq!(watch.check(at(64.0), fresh).unwrap(), "no end after 61 s; allowed were 60 s");
    }

    #[test]
    fn a_body_that_says_nothing_makes_no_progress() {
        let mut watch = TaskTimer::new(&TaskTimeout::default(), &task(&[]), None);
        assert_eq!(watch.check(None, Duration::from_secs(59)), None);
        assert_eq!(watch.check(None, Duration::from_secs(60)).unwrap(), "the body has reported nothing for 60 s");
    }
}
