//! No robot enters a closed place or drives a closed lane, and no task fails because of a closure. An alarm closes parts of
//! the map, too.
//!
//! A robot in a role has received a closure, or has stopped, once the lease that it may have had at that time is over:
//! each later renewal contains the closure. Its body may then drive on for as long as the latest command permits. Whether a
//! robot without a role has received a closure is not known. A robot in a closed place may leave it through neighbouring
//! closed places. Around the end of a closure nothing is checked, since clocks drift.

use super::InvariantViolation;
use super::active_goals::ActiveGoals;
use super::held::may_be_over;
use super::obeyed::Obeyed;
use super::reference_ledger::ReferenceLedger;
use crate::Fleet;
use crate::order_bounds::heeds_closures_within;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::ledger::{MapPart, RobotOrder};
use consort_skills::actions::RobotBackend as _;
use std::collections::BTreeMap;
use std::time::Duration;

/// Cause of a drive that finds its way closed. No obstacle closes a way in these runs.
const WAY_IS_CLOSED: &str = "the ways between them are closed";

pub(super) struct Closed {
    lease: Duration,
    reference: ReferenceLedger,
    /// Closures in the ledger, also those of alarms, with the times of their latest changes.
    closures: BTreeMap<MapPart, (RobotOrder, Duration)>,
    /// Times at which closures ended, by part.
    opened: BTreeMap<MapPart, Duration>,
    active: ActiveGoals,
}

impl Closed {
    pub(super) fn new(lease: Duration) -> Closed {
        Closed {
            lease,
            reference: ReferenceLedger::default(),
            closures: BTreeMap::new(),
            opened: BTreeMap::new(),
            active: ActiveGoals::default(),
        }
    }

    /// Checks whether a robot in a role must heed a change of the closures at `since`.
    fn must_heed(&self, at: Duration, since: Duration) -> bool {
        at > self.active.stopped_from(since) + heeds_closures_within(self.lease)
    }

    /// Checks all drives; `place_of` returns the last place that a robot has passed.
    fn check(&self, at: Duration, place_of: impl Fn(&RobotId) -> Option<PlaceId>) -> Result<(), InvariantViolation> {
        for ((robot, _), goal) in self.active.goals.iter().filter(|(_, goal)| goal.in_role) {
            let Some((from, to)) = place_of(robot).zip(goal.drives_to.as_ref()).filter(|(from, to)| from != *to) else {
                continue;
            };
            let is_open = |place: &PlaceId| {
                let is_closed = self.closures.keys().any(|part| covers(part, place));
                let mut opened = self.opened.iter().filter(|(part, _)| covers(part, place));
                !is_closed && opened.all(|(_, ended)| self.must_heed(at, *ended))
            };
            let enters = |part: &MapPart| match part {
                MapPart::Lane(..) => *part == MapPart::of_lane(from.clone(), to.clone()),
                MapPart::Place(_) | MapPart::Zone(_) => covers(part, to) && is_open(&from),
            };
            for (part, (order, since)) in &self.closures {
                if enters(part) && self.must_heed(at, *since) && !may_be_over(order, at) {
                    let after_s = at.saturating_sub(*since).as_secs_f64();
                    let closed = order.closure_text();
                    let reason =
                        format!("{robot} drives from {from} to {to}, {after_s:.1} s after {part} was {closed}");
                    return Err(reason.into());
                }
            }
        }
        Ok(())
    }
}

/// Checks whether a part of the map is this place, or a zone with it.
fn covers(part: &MapPart, place: &PlaceId) -> bool {
    match part {
        MapPart::Zone(zone) => zone.places.contains(place),
        MapPart::Place(own) => own == place,
        MapPart::Lane(..) => false,
    }
}

impl Obeyed for Closed {
    const NAME: &'static str = "closed";

    fn followed(&mut self) -> (&mut ReferenceLedger, &mut ActiveGoals) {
        (&mut self.reference, &mut self.active)
    }

    /// Adopts the closures of the ledger.
    fn update(&mut self, at: Duration) {
        let ledger = &self.reference.ledger;
        let of_alarms = ledger.alarms().flat_map(|alarm| {
            let order = &alarm.order;
            alarm.plan.closes.iter().map(move |part| (part.clone(), order.clone()))
        });
        let closures = ledger.closures().map(|closure| (closure.part, closure.order));
        let closed: BTreeMap<MapPart, RobotOrder> = of_alarms.chain(closures).collect();
        let is_kept = |part: &MapPart, order: &RobotOrder| closed.get(part) == Some(order);
        let (kept, ended): (BTreeMap<_, _>, BTreeMap<_, _>) =
            std::mem::take(&mut self.closures).into_iter().partition(|(part, (order, _))| is_kept(part, order));
        self.closures = kept;
        self.opened.extend(ended.into_keys().map(|part| (part, at)));
        for (part, order) in closed {
            self.closures.entry(part).or_insert((order, at));
        }
    }

    /// Checks that no attempt at a task has failed because of a closure: the robot waits until the way is open.
    fn check_event(&self, event: &EventKind) -> Result<(), InvariantViolation> {
        match event {
            EventKind::TaskRetried { mission, task, cause, .. }
            | EventKind::TaskFailed { mission, task, cause, .. }
                if cause.contains(WAY_IS_CLOSED) =>
            {
                Err(format!("{task} of {mission} has failed in place of waiting: {cause}").into())
            }
            _ => Ok(()),
        }
    }

    fn check_goals(&mut self, at: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if self.closures.is_empty() {
            return Ok(());
        }
        self.check(at, |robot| fleet.world.telemetry(robot).map(|telemetry| telemetry.place))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::dates::DATE_MS;
    use crate::slug;
    use consort_protocol::cause::CauseClass;
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{ClosureChange, Command, OrderRequest};
    use consort_protocol::pose::Pose;
    use consort_skills::actions::NavigateToPose;

    fn secs(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    fn place(name: &str) -> PlaceId {
        slug(name)
    }

    /// Returns the state in which Nia closed these parts for two minutes at 100 s; leases last 4 s.
    fn closed(parts: &[MapPart]) -> Closed {
        let mut state = Closed::new(secs(4));
        change(&mut state, 2, parts, ClosureChange::Close { until_ms: Some(DATE_MS + 220_000), reason: String::new() });
        state.update(secs(100));
        state
    }

    fn change(state: &mut Closed, index: u64, parts: &[MapPart], change: ClosureChange) {
        let order = OrderRequest { change, by: "Nia".to_owned(), at_ms: DATE_MS + 100_000, request: None };
        let command = Command::ChangeClosures { parts: parts.iter().cloned().collect(), order };
        state.reference.apply(Epoch { term: 1, index }, &[Command::first_wire_version(3), command]);
    }

    /// Lets garnet begin a drive, in a role or without.
    fn begin(state: &mut Closed, to: &str, in_role: bool) {
        state.active.roles.clear();
        if in_role {
            state.active.roles.insert((slug("garnet"), "lab-samples-1".parse().unwrap(), slug("r1")));
        }
        state.active.goals.clear();
        let drive = NavigateToPose { pose: Pose::new(0.0, 0.0, 0.0), place: Some(place(to)), speed_max_mps: None };
        state.active.begin(&slug("garnet"), 7, &drive.into());
    }

    /// Checks the drive of garnet, which has last passed `from`.
    fn check(state: &Closed, at: Duration, from: &str) -> Result<(), String> {
        state.check(at, |_| Some(place(from))).map_err(|violation| violation.0)
    }

    #[test]
    fn a_robot_in_a_role_that_enters_a_closed_place_or_lane_is_found() {
        let mut state = closed(&[MapPart::Place(place("Ward")), MapPart::of_lane(place("A"), place("B"))]);
        begin(&mut state, "Ward", true);
        assert_eq!(check(&state, secs(110), "Hall"), Ok(()), "a lease of 4.4 s, 2 s, and a command of 3.3 s");
        let violation = check(&state, secs(111), "Hall").unwrap_err();
        assert_eq!(violation, "garnet drives from Hall to Ward, 11.0 s after Ward was closed by Nia");
        assert_eq!(check(&state, secs(111), "Ward"), Ok(()), "it returns to the place");
        assert_eq!(check(&state, secs(200), "Hall"), Ok(()), "the closure may be over");
        state.active.server_changed = secs(105);
        assert_eq!(check(&state, secs(111), "Hall"), Ok(()), "the driver server permits it");
        state.active.server_changed = Duration::ZERO;
        for (from, to) in [("A", "B"), ("B", "A")] {
            begin(&mut state, to, true);
            let violation = check(&state, secs(111), from).unwrap_err();
            assert_eq!(violation, format!("garnet drives from {from} to {to}, 11.0 s after A – B was closed by Nia"));
        }
        begin(&mut state, "B", true);
        assert_eq!(check(&state, secs(111), "C"), Ok(()), "another lane");
        begin(&mut state, "Ward", false);
        assert_eq!(check(&state, secs(111), "Hall"), Ok(()), "without a role it may not know the closure");
    }

    #[test]
    fn a_robot_may_leave_a_closed_place_through_another() {
        let (ward, hall) = (MapPart::Place(place("Ward")), MapPart::Place(place("Hall")));
        let mut state = closed(&[ward, hall.clone()]);
        begin(&mut state, "Hall", true);
        assert_eq!(check(&state, secs(150), "Ward"), Ok(()));
        begin(&mut state, "Ward", true);
        change(&mut state, 3, &[hall], ClosureChange::Open);
        state.update(secs(140));
        assert_eq!(check(&state, secs(150), "Hall"), Ok(()), "Hall may be closed for it");
        assert!(check(&state, secs(151), "Hall").is_err());
    }

    #[test]
    fn a_task_that_fails_because_of_a_closure_is_found() {
        let failed = |cause: &str| EventKind::TaskFailed {
            mission: "lab-samples-1".parse().unwrap(),
            role: slug("r1"),
            task: slug("navto_room"),
            cause: cause.to_owned(),
            class: CauseClass::Transient,
        };
        let state = Closed::new(secs(4));
        assert_eq!(state.check_event(&failed("chaos has it fail")), Ok(()));
        let violation =
            state.check_event(&failed("no route from A to B: the ways between them are closed")).unwrap_err().0;
        assert!(violation.starts_with("navto_room of lab-samples-1 has failed in place of waiting: "), "{violation}");
    }
}
