//! Charging of a robot: its activity, and the tasks that it executes for that.

use super::RobotCharging;
use super::policy::{Activity, Claim, LeaseOffer, OtherRobot, ReceivedLeases, Situation};
use super::reserve::ChargerReserve;
use crate::robot::own_tasks::{Drive, OwnTask, dock_at, drive_to, nearest, places};
use consort_protocol::auction::BidLimits;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::{ChargerClaim, Charging};
use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{BatteryShare, NodeTime, WorldTime};
use consort_skills::descriptor::{EstimateContext, Estimator};
use ractor::ActorId;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Node time for which a robot avoids a place where a task of charging has failed. A guess: most
/// obstacles are gone by then.
const AVOID_TIME: Duration = Duration::from_secs(60);

/// Node time within which the charge of a connected robot must rise by [`RISE_MIN`], and for which the robot otherwise
/// avoids the charger. Raised: a robot stays longer at a charger that has failed. A guess: even a slow charger gives
/// several times as much.
const RISE_TIME: Duration = Duration::from_secs(15 * 60);

/// Rise of the charge that counts, as a share of a full battery. A guess: above the noise of a battery sensor.
const RISE_MIN: f64 = 0.005;

/// Node time for which a robot must have been idle before it drives to a parking place. Raised: it is in the way for
/// longer, and drives less often in vain before its next role. A guess: auctions take less.
const PARK_DELAY: Duration = Duration::from_secs(10);

/// State of a robot with respect to its charge.
pub(in crate::robot) struct ChargeControl {
    settings: RobotCharging,
    activity: Activity,
    trip: Option<Trip>,
    /// The charge was too low for a role since the robot last had enough.
    lacks_charge: bool,
    /// The robot has bid for a role after a stop at a charger since it last had enough: it charges also after other roles.
    plans_stop: bool,
    /// Latest rise of the charge of the connected robot.
    rise: Option<Rise>,
    /// Places where a task has failed, until these times.
    avoided: BTreeMap<PlaceId, NodeTime>,
    /// A coordinator is in contact: it leases chargers.
    has_coordinator: bool,
    leases: ReceivedLeases,
    /// Time since which the robot has been idle elsewhere than at a parking place.
    idle_since: Option<NodeTime>,
}

/// Rise of the charge at a charger.
struct Rise {
    /// Time of the latest rise, or of the connection.
    since: NodeTime,
    /// Least charge since then.
    least: BatteryShare,
}

/// Tasks of an activity, in their order.
struct Trip {
    destination: PlaceId,
    tasks: VecDeque<TaskSpec>,
    running: Option<OwnTask>,
}

impl ChargeControl {
    pub(in crate::robot) fn new(settings: RobotCharging) -> ChargeControl {
        let (activity, avoided) = (Activity::Idle, BTreeMap::new());
        ChargeControl {
            settings,
            activity,
            trip: None,
            lacks_charge: false,
            plans_stop: false,
            rise: None,
            avoided,
            has_coordinator: false,
            leases: ReceivedLeases::default(),
            idle_since: None,
        }
    }

    /// Returns the chargers and charges with which the robot plans stops.
    pub(in crate::robot) fn reserve(&self, limits: BidLimits) -> ChargerReserve {
        let RobotCharging { thresholds, usable, forecast, .. } = &self.settings;
        ChargerReserve::new(usable.clone(), limits).with_stops(forecast.clone(), thresholds.until)
    }

    /// Records that the charge is too low for a role: the robot charges until it has enough or gets another role.
    pub(in crate::robot) fn note_lack(&mut self) {
        self.lacks_charge = true;
    }

    /// Records that the robot has bid for a role after a stop at a charger: whenever it is free, it charges until it has enough.
    pub(in crate::robot) fn note_stop(&mut self) {
        self.plans_stop = true;
    }

    /// Records whether a coordinator is in contact.
    pub(in crate::robot) fn set_has_coordinator(&mut self, has_coordinator: bool) {
        self.has_coordinator = has_coordinator;
    }

    /// Receives the lease of a charger, by its position in the log. The robot claims it with its next decision, unless it
    /// claims the charger already.
    pub(in crate::robot) fn receive_lease(&mut self, charger: PlaceId, lease: u64) {
        self.leases.receive(LeaseOffer { charger, lease }, &mut self.activity);
    }

    /// Accepts leases from any position on: those of another cluster are counted anew. The lease of a claim is void, and
    /// would prevail over those of the other cluster.
    pub(in crate::robot) fn change_cluster(&mut self) {
        self.leases = ReceivedLeases::default();
        if let Activity::Claimed(claim) | Activity::Connected(claim) = &mut self.activity {
            claim.published.lease = None;
        }
    }

    /// Checks whether the charge was too low for a role since the robot last had enough.
    pub(in crate::robot) fn lacks_charge(&self) -> bool {
        self.lacks_charge || self.plans_stop
    }

    /// Returns what the robot publishes.
    pub(in crate::robot) fn published(&self) -> Option<Charging> {
        match (&self.activity, &self.trip) {
            (Activity::Leaving, Some(trip)) => Some(Charging::Leaving { to: trip.destination.clone() }),
            (activity, _) => activity.published(),
        }
    }

    /// Checks whether the robot acts.
    pub(in crate::robot) fn is_acting(&self) -> bool {
        self.trip.is_some()
    }

    /// Checks whether the records of the other robots may change the activity.
    pub(in crate::robot) fn depends_on_others(&self, situation: &Situation<'_>) -> bool {
        let is_enough = self.settings.thresholds.is_enough(situation.battery, situation.lacked_charge);
        let stays = self.activity == Activity::Idle && is_enough;
        !stays || self.settings.all.contains(situation.place) || self.is_parking_due(situation.now)
    }

    /// Checks that the charge of a connected robot rises. Returns the problem if it does not: the charger is avoided.
    pub(in crate::robot) fn check_current(&mut self, battery: BatteryShare, now: NodeTime) -> Option<String> {
        let Activity::Connected(claim) = &self.activity else {
            self.rise = None;
            return None;
        };
        let charger = claim.published.charger.clone();
        let rise = self.rise.get_or_insert(Rise { since: now, least: battery });
        if battery.get() - rise.least.get() >= RISE_MIN {
            *rise = Rise { since: now, least: battery };
        } else if battery < rise.least {
            rise.least = battery;
        }
        if now.since(rise.since) < RISE_TIME {
            return None;
        }
        self.avoided.insert(charger.clone(), now + RISE_TIME);
        (self.activity, self.rise) = (Activity::Idle, None);
        Some(format!("{charger} gives no current: the charge has not risen for {} minutes", RISE_TIME.as_secs() / 60))
    }

    /// Decides about the activity. Returns true if it has changed: the tasks of the former activity have ended.
    pub(in crate::robot) fn decide(
        &mut self,
        situation: &Situation<'_>,
        estimator: &Estimator,
        context: &EstimateContext,
    ) -> bool {
        let RobotCharging { thresholds, usable, all, parking, forecast } = &self.settings;
        self.lacks_charge &= situation.battery < thresholds.until;
        self.plans_stop &= situation.battery < thresholds.until;
        self.avoided.retain(|_, until| situation.now < *until);
        let charged_after = |drive: &Drive| {
            let left = (situation.battery.get() - drive.energy).clamp(0.0, 1.0);
            drive.time.get() + forecast.time(&drive.to, left, thresholds.until).get()
        };
        let mut drive_times = BTreeMap::new();
        let soonest_first = || {
            let chargers = usable.iter().filter(|charger| !self.avoided.contains_key(*charger));
            let mut drives = nearest(estimator, context, chargers);
            drives.sort_by(|one, other| charged_after(one).total_cmp(&charged_after(other)));
            drive_times.extend(drives.iter().map(|drive| (drive.to.clone(), drive.time)));
            drives.into_iter().map(|drive| drive.to).collect::<Vec<_>>()
        };
        // A claim keeps the others away, so it ends when the robot can no longer reach the charger.
        let is_cut_off = |Claim { published: ChargerClaim { charger, .. }, .. }: &Claim| {
            let may_be_cut_off = !context.closed.is_empty() && charger != situation.place;
            may_be_cut_off && nearest(estimator, context, [charger]).is_empty()
        };
        let leaves = self.activity == Activity::Leaving;
        let yields_place = |trip: &Trip| leaves && situation.yields_place(&trip.destination);
        let drives_elsewhere = self.trip.as_ref().is_some_and(yields_place);
        let idle = Activity::Idle;
        let present = match &self.activity {
            Activity::Claimed(claim) if is_cut_off(claim) => &idle,
            // A robot that has found no place decides anew: perhaps no robot waits any more.
            Activity::Leaving if self.trip.is_none() => &idle,
            activity => activity,
        };
        // A robot on its way does not turn back; the coordinator repeats its notice.
        let offer = self.leases.take_offer().filter(|_| self.trip.is_none());
        let mut next = thresholds.next(present, situation, offer.as_ref(), all, soonest_first);
        if let Activity::Claimed(claim) = &mut next {
            let drive = drive_times.get(&claim.published.charger).copied();
            claim.published.drive_s = claim.published.drive_s.or(drive);
        }
        self.leases.follow(&next);
        let may_park = next == Activity::Idle && situation.battery >= thresholds.below && !parking.is_empty();
        let is_in_the_way = may_park && !parking.contains(situation.place);
        self.idle_since = is_in_the_way.then(|| self.idle_since.unwrap_or(situation.now));
        let charges_again = |farthest: Drive| {
            let left = BatteryShare::new((situation.battery.get() - farthest.energy).clamp(0.0, 1.0));
            !left.is_ok_and(|left| thresholds.is_enough(left, false))
        };
        // Otherwise it would drive back and forth.
        let stays_at_charger =
            || usable.contains(situation.place) && nearest(estimator, context, parking).pop().is_none_or(charges_again);
        if self.is_parking_due(situation.now) && !stays_at_charger() {
            next = Activity::Leaving;
        }
        let changed = drives_elsewhere || next != self.activity;
        if changed {
            self.end_trip();
            self.activity = next;
        }
        changed
    }

    fn is_parking_due(&self, now: NodeTime) -> bool {
        self.idle_since.is_some_and(|since| now.since(since) >= PARK_DELAY)
    }

    /// Returns the task to be started now, if any.
    pub(in crate::robot) fn next_task(
        &mut self,
        others: &[OtherRobot],
        estimator: &Estimator,
        context: &EstimateContext,
        now: NodeTime,
    ) -> Option<TaskSpec> {
        if self.trip.is_none() {
            self.trip = self.new_trip(others, estimator, context, now);
        }
        let trip = self.trip.as_mut().filter(|trip| trip.running.is_none())?;
        trip.tasks.pop_front()
    }

    fn new_trip(
        &self,
        others: &[OtherRobot],
        estimator: &Estimator,
        context: &EstimateContext,
        now: NodeTime,
    ) -> Option<Trip> {
        match &self.activity {
            Activity::Claimed(claim) if claim.may_act(self.has_coordinator, now) => {
                let charger = claim.published.charger.clone();
                let tasks = VecDeque::from([drive_to(&charger), dock_at(&charger)]);
                Some(Trip { destination: charger, tasks, running: None })
            }
            Activity::Leaving => {
                let is_free = |place: &&PlaceId| {
                    let is_avoided = self.settings.all.contains(*place) || self.avoided.contains_key(*place);
                    let is_taken = |other: &OtherRobot| other.place == **place || other.leaves_to() == Some(*place);
                    !is_avoided && !others.iter().any(is_taken)
                };
                let parking = nearest(estimator, context, self.settings.parking.iter().filter(is_free));
                let elsewhere = || match self.settings.all.contains(&context.place) {
                    true => nearest(estimator, context, places(estimator).filter(is_free)),
                    false => vec![],
                };
                let drives = if parking.is_empty() { elsewhere() } else { parking };
                let destination = drives.into_iter().next()?.to;
                let tasks = VecDeque::from([drive_to(&destination)]);
                Some(Trip { destination, tasks, running: None })
            }
            Activity::Idle | Activity::Waiting(_) | Activity::Claimed(_) | Activity::Connected(_) => None,
        }
    }

    /// Records that the task has started.
    pub(in crate::robot) fn set_running(&mut self, task: OwnTask) {
        if let Some(trip) = &mut self.trip {
            trip.running = Some(task);
        }
    }

    /// Returns the reason to abort the running task, if any.
    pub(in crate::robot) fn check_timer(&mut self, world: Option<WorldTime>, silent_for: Duration) -> Option<String> {
        self.task_mut()?.timer.check(world, silent_for)
    }

    /// Returns the running task.
    pub(in crate::robot) fn task_mut(&mut self) -> Option<&mut OwnTask> {
        self.trip.as_mut()?.running.as_mut()
    }

    /// Takes the running task if it has this number.
    pub(in crate::robot) fn take_task(&mut self, run: u64) -> Option<OwnTask> {
        self.trip.as_mut()?.running.take_if(|task| task.skill.run() == run)
    }

    /// Takes the running task if this actor executes it.
    pub(in crate::robot) fn take_task_of(&mut self, actor: ActorId) -> Option<OwnTask> {
        self.trip.as_mut()?.running.take_if(|task| task.skill.is_executed_by(actor))
    }

    /// Handles the success of a task.
    pub(in crate::robot) fn task_succeeded(&mut self) {
        if self.trip.as_ref().is_none_or(|trip| !trip.tasks.is_empty()) {
            return;
        }
        self.trip = None;
        self.activity = match std::mem::replace(&mut self.activity, Activity::Idle) {
            Activity::Claimed(claim) | Activity::Connected(claim) => Activity::Connected(claim),
            Activity::Idle | Activity::Waiting(_) | Activity::Leaving => Activity::Idle,
        };
    }

    /// Handles the failure of a task: the robot avoids its destination for a while.
    pub(in crate::robot) fn task_failed(&mut self, now: NodeTime) {
        if let Some(trip) = self.end_trip() {
            self.avoided.insert(trip.destination, now + AVOID_TIME);
        }
        self.activity = Activity::Idle;
    }

    /// Ends the activity. Returns true if the robot was acting.
    pub(in crate::robot) fn stop(&mut self) -> bool {
        (self.activity, self.lacks_charge) = (Activity::Idle, false);
        self.leases.take_offer();
        self.idle_since = None;
        self.end_trip().is_some()
    }

    fn end_trip(&mut self) -> Option<Trip> {
        let trip = self.trip.take()?;
        if let Some(task) = &trip.running {
            task.skill.halt();
        }
        Some(trip)
    }
}
