//! No robot in a role drives faster than a speed limit permits.
//!
//! The bound is that of a closure: each renewal of a lease contains the limits, and the body may then follow the latest
//! command from before. Whether a robot without a role has received a limit is not known. Around the end of a limit nothing
//! is checked, since clocks drift. The speed is that of the body, between two states in the same drive.

use super::InvariantViolation;
use super::active_goals::ActiveGoals;
use super::held::may_be_over;
use super::obeyed::Obeyed;
use super::reference_ledger::ReferenceLedger;
use crate::Fleet;
use crate::order_bounds::{SPEED_TOLERANCE_MPS, heeds_closures_within};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::ledger::{MapPart, SpeedLimit};
use consort_protocol::pose::Pose;
use consort_protocol::units::MetresPerSecond;
use consort_skills::actions::RobotBackend as _;
use consort_skills::environment::SpeedLimits;
use std::collections::BTreeMap;
use std::time::Duration;

pub(super) struct Limited {
    lease: Duration,
    reference: ReferenceLedger,
    /// Speed limits in the ledger, with the times of their latest changes.
    limits: BTreeMap<MapPart, (SpeedLimit, Duration)>,
    active: ActiveGoals,
    /// Latest states of the robots that drive in a role.
    motions: BTreeMap<RobotId, Motion>,
}

/// State of a body in a drive.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    /// The drive.
    goal: u64,
    /// The place that the robot has passed last, and the end of the drive.
    lane: (PlaceId, PlaceId),
    /// Time of the world.
    time_s: f64,
    pose: Pose,
}

impl Motion {
    /// Returns the speed since an earlier state of the same drive in metres per second.
    fn speed_mps(&self, earlier: &Motion) -> Option<f64> {
        let time_s = self.time_s - earlier.time_s;
        let is_same = (self.goal, &self.lane) == (earlier.goal, &earlier.lane);
        (is_same && time_s > 0.0).then(|| earlier.pose.distance(self.pose).get() / time_s)
    }
}

impl Limited {
    pub(super) fn new(lease: Duration) -> Limited {
        Limited {
            lease,
            reference: ReferenceLedger::default(),
            limits: BTreeMap::new(),
            active: ActiveGoals::default(),
            motions: BTreeMap::new(),
        }
    }

    /// Returns the limits that a robot in a role must keep to.
    fn in_force(&self, at: Duration) -> SpeedLimits {
        let must_heed = |(limit, since): &&(SpeedLimit, Duration)| {
            at > self.active.stopped_from(*since) + heeds_closures_within(self.lease) && !may_be_over(&limit.order, at)
        };
        let of_parts = |(limit, _): &(SpeedLimit, Duration)| {
            let speed = limit.speed_mps;
            limit.part.pairs().into_iter().map(move |lane| (lane, speed))
        };
        self.limits.values().filter(must_heed).flat_map(of_parts).collect()
    }

    /// Checks the speeds since the latest states. `state_of` returns the present state of a robot in a drive to a place.
    fn check(
        &mut self,
        at: Duration,
        state_of: impl Fn(&RobotId, u64, &PlaceId) -> Option<Motion>,
    ) -> Result<(), InvariantViolation> {
        let driving =
            self.active.goals.iter().filter(|(_, goal)| goal.in_role).filter_map(|((robot, id), goal)| {
                Some((robot.clone(), state_of(robot, *id, goal.drives_to.as_ref()?)?))
            });
        let (motions, limits): (BTreeMap<RobotId, Motion>, SpeedLimits) = (driving.collect(), self.in_force(at));
        let earlier = std::mem::replace(&mut self.motions, motions);
        for (robot, motion) in &self.motions {
            let (from, to) = &motion.lane;
            let limit = limits.on(from, to).map(MetresPerSecond::get);
            let speed = earlier.get(robot).and_then(|earlier| motion.speed_mps(earlier));
            if let Some((limit, speed)) = limit.zip(speed).filter(|(limit, speed)| *speed > limit + SPEED_TOLERANCE_MPS)
            {
                let reason = format!("{robot} drives from {from} to {to} at {speed:.2} m/s, allowed are {limit} m/s");
                return Err(reason.into());
            }
        }
        Ok(())
    }
}

impl Obeyed for Limited {
    const NAME: &'static str = "limited";

    fn followed(&mut self) -> (&mut ReferenceLedger, &mut ActiveGoals) {
        (&mut self.reference, &mut self.active)
    }

    /// Adopts the speed limits of the ledger.
    fn update(&mut self, at: Duration) {
        let limits: BTreeMap<MapPart, SpeedLimit> =
            self.reference.ledger.speed_limits().map(|limit| (limit.part.clone(), limit)).collect();
        self.limits.retain(|part, (limit, _)| limits.get(part) == Some(&*limit));
        for (part, limit) in limits {
            self.limits.entry(part).or_insert((limit, at));
        }
    }

    fn check_goals(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if self.limits.is_empty() {
            self.motions.clear();
            return Ok(());
        }
        self.check(at, |robot, goal, to| {
            let telemetry = fleet.world.telemetry(robot)?;
            let (lane, time_s) = ((telemetry.place, to.clone()), telemetry.time.as_secs());
            Some(Motion { goal, lane, time_s, pose: telemetry.pose })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::dates::DATE_MS;
    use crate::slug;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, OrderRequest, SpeedLimitChange};
    use consort_skills::actions::NavigateToPose;

    fn secs(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// Returns the state after the lanes of Ward were limited to 0.3 m/s at 100 s for 100 s, while garnet drives to Ward.
    fn limited() -> Limited {
        let mut state = Limited::new(secs(4));
        let (speed, until_ms) = (MetresPerSecond::new(0.3).unwrap(), Some(DATE_MS + 200_000));
        let change = SpeedLimitChange::Set { speed, until_ms, reason: String::new() };
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: DATE_MS + 100_000, request: None };
        let set = Command::ChangeSpeedLimits { parts: [MapPart::Place(slug("Ward"))].into(), order };
        state.reference.apply(Epoch { term: 1, index: 1 }, &[Command::first_wire_version(3), set]);
        state.update(secs(100));
        state.active.roles.insert((slug("garnet"), "lab-samples-1".parse().unwrap(), slug("r1")));
        let drive = NavigateToPose::to(Pose::new(0.0, 0.0, 0.0), Some(slug("Ward")));
        state.active.begin(&slug("garnet"), 7, &drive.into());
        state
    }

    /// Checks the state at which garnet has driven `x_m` in 10 s of the world since the start of a drive from `from`.
    fn check(state: &mut Limited, at: Duration, from: &str, x_m: f64) -> Result<(), String> {
        let motion = |goal, time_s, x_m| Motion {
            goal,
            lane: (slug(from), slug("Ward")),
            time_s,
            pose: Pose::new(x_m, 0.0, 0.0),
        };
        state.motions = [(slug("garnet"), motion(7, 50.0, 0.0))].into();
        state.check(at, |_, goal, _| Some(motion(goal, 60.0, x_m))).map_err(|violation| violation.0)
    }

    #[test]
    fn a_robot_that_exceeds_a_limit_after_the_bound_is_found() {
        let mut state = limited();
        assert_eq!(check(&mut state, secs(110), "Hall", 6.0), Ok(()), "a lease of 4.4 s, 2 s, and a command of 3.3 s");
        let violation = check(&mut state, secs(111), "Hall", 6.0).unwrap_err();
        assert_eq!(violation, "garnet drives from Hall to Ward at 0.60 m/s, allowed are 0.3 m/s");
        assert_eq!(check(&mut state, secs(111), "Hall", 3.0), Ok(()));
        assert_eq!(check(&mut state, secs(200), "Hall", 6.0), Ok(()), "the limit may be over");
        state.active.server_changed = secs(105);
        assert_eq!(check(&mut state, secs(111), "Hall", 6.0), Ok(()), "the driver server permits it");
    }

    #[test]
    fn the_speed_is_that_of_one_drive() {
        let motion = |goal, from: &str, time_s| Motion {
            goal,
            lane: (slug(from), slug("Ward")),
            time_s,
            pose: Pose::new(2.0 * time_s, 0.0, 0.0),
        };
        let now = motion(7, "Hall", 10.0);
        assert_eq!(now.speed_mps(&motion(7, "Hall", 8.0)), Some(2.0));
        for other in [motion(6, "Hall", 8.0), motion(7, "Dock", 8.0), motion(7, "Hall", 10.0)] {
            assert_eq!(now.speed_mps(&other), None, "{other:?}");
        }
    }
}
