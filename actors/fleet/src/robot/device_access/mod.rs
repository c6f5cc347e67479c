//! Access to the ways that devices of the building guard, as a value: what the robot claims, and when it may enter.
//!
//! The robot claims all devices of the way that its skill requests, and of the place at which it stands. It enters when
//! each of them confirms the lease of the robot, while a coordinator is in contact. It keeps the claims until it has left. A robot
//! at rest has not entered if it is still where it waited. A robot that rests far from all ways is on none of them.
//!
//! If the way ends inside of a device, the robot also claims the devices whose places follow on its route, up to the first place
//! outside of all, and enters once they are leased to it. Inside it would keep what a robot from the other side needs.

use crate::robot_driver::{RequestedWay, Way};
use consort_protocol::devices::{Device, DeviceReports, DeviceWatch, Devices};
use consort_protocol::ids::{DeviceId, PlaceId};
use consort_protocol::knowledge::{DeviceClaim, DeviceClaims, DeviceReport, DeviceState};
use consort_protocol::pose::Pose;
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// Time after which a report counts that was already known when the robot asked for another place: the device would have
/// reported otherwise. Raised: a robot that turns back waits longer. Several intervals of gossip and of the device's node.
const STALE_FOR: Duration = Duration::from_secs(3);

/// Greatest distance from a place at which the robot stands there, in metres: Nav2's default goal tolerance.
pub(super) const AT_PLACE_M: f64 = 0.25;

/// Time for which a robot rests far from all ways until it counts as on none of them. Raised: a device waits longer for a robot whose
/// pose does not fit its place. Long enough for a robot that restarts to find its pose; a guess.
const OFF_WAY_MAX: Duration = Duration::from_secs(120);

/// Access of a robot.
pub(super) struct DeviceAccess {
    devices: Arc<Devices>,
    watch: DeviceWatch,
    claims: DeviceClaims,
    /// The claims as last published.
    published: Option<DeviceClaims>,
    /// Reports that were known when the robot asked the device for another place, and since when: the device may just leave.
    doubted: BTreeMap<DeviceId, (DeviceReport, NodeTime)>,
    /// Way that the robot was allowed to drive, until it has arrived or has not left its place.
    entered: Option<Way>,
    /// Pose at which it was allowed to, if that is not the pose of its place.
    entered_from: Option<Pose>,
    /// Time since which the robot rests far from all ways.
    off_way_since: Option<NodeTime>,
    /// True if the latest decision has granted a way.
    is_granted: bool,
    /// Place at the first decision.
    started_at: Option<PlaceId>,
    /// True once the robot stood at a place, or has passed another: before, a former life of its node may have entered a way.
    knows_its_way: bool,
    is_waiting: bool,
    closed: Vec<(PlaceId, PlaceId)>,
    problems: Vec<String>,
}

/// What the decision depends on.
pub(super) struct AccessSituation<'a> {
    /// Current or last place of the robot.
    pub(super) place: &'a PlaceId,
    /// True if it stands there.
    pub(super) is_at_place: bool,
    /// True if no goal is in progress.
    pub(super) is_at_rest: bool,
    /// Pose.
    pub(super) pose: Pose,
    /// Way that a skill requests.
    pub(super) requested: Option<&'a RequestedWay>,
    /// Places to which it may be on its way.
    pub(super) ahead: &'a [&'a PlaceId],
    /// Reports of the devices.
    pub(super) reports: &'a DeviceReports,
    /// True if a coordinator is in contact.
    pub(super) has_coordinator: bool,
    /// Current time.
    pub(super) now: NodeTime,
}

impl DeviceAccess {
    pub(super) fn new(devices: Arc<Devices>) -> DeviceAccess {
        DeviceAccess {
            devices,
            watch: DeviceWatch::default(),
            claims: DeviceClaims::new(),
            published: None,
            doubted: BTreeMap::new(),
            entered: None,
            entered_from: None,
            off_way_since: None,
            is_granted: false,
            started_at: None,
            knows_its_way: false,
            is_waiting: false,
            closed: vec![],
            problems: vec![],
        }
    }

    /// Returns the claims for the record of the node; `None` while the node does not know where the robot is.
    pub(super) fn claims(&self) -> Option<&DeviceClaims> {
        (self.knows_its_way || !self.claims.is_empty()).then_some(&self.claims)
    }

    /// Checks whether the claims have changed since the last call.
    pub(super) fn must_publish(&mut self) -> bool {
        let current = self.claims().cloned();
        let has_changed = current != self.published;
        self.published = current;
        has_changed
    }

    /// Returns the lanes and places that no robot can use, as closures of people.
    pub(super) fn closed(&self) -> &[(PlaceId, PlaceId)] {
        &self.closed
    }

    /// Returns the devices that no robot can use, each as `front-door is unavailable: it does not confirm`.
    pub(super) fn problems(&self) -> impl Iterator<Item = &str> {
        self.problems.iter().map(String::as_str)
    }

    /// Checks whether the robot waits for a device.
    pub(super) fn is_waiting(&self) -> bool {
        self.is_waiting
    }

    /// Receives the lease of a device, by its position in the log.
    pub(super) fn receive_lease(&mut self, device: &DeviceId, lease: u64) {
        if let Some(claim) = self.claims.get_mut(device).filter(|claim| claim.lease.is_none_or(|known| known < lease)) {
            claim.lease = Some(lease);
        }
    }

    /// Forgets all leases: the positions of another cluster are counted anew.
    pub(super) fn change_cluster(&mut self) {
        self.claims.values_mut().for_each(|claim| claim.lease = None);
    }

    /// Decides what the robot claims. Returns the requested way if the robot may drive it now.
    pub(super) fn decide(&mut self, situation: &AccessSituation) -> Option<Way> {
        let AccessSituation { place, is_at_place, pose, requested, ahead, reports, has_coordinator, now, .. } =
            *situation;
        let then: &[Way] = requested.map_or(&[], |requested| &requested.then);
        let requested = requested.map(|requested| &requested.way);
        let is_off_way = self.is_off_way(situation);
        let is_where_it_waited =
            situation.is_at_rest && self.entered_from.is_some_and(|from| from.distance(pose).get() <= AT_PLACE_M);
        let is_outside = is_at_place || is_where_it_waited || is_off_way;
        // A robot that is still outside after the end of the grant has not used it.
        let is_unused = is_outside && !self.is_granted;
        let has_ended = |way: &Way| *place != way.0 || is_outside && requested != Some(way) || is_unused;
        self.entered.take_if(|way| has_ended(way));
        let started_at = self.started_at.get_or_insert_with(|| place.clone());
        self.knows_its_way |= is_at_place || is_off_way || *started_at != *place;
        let devices = Arc::clone(&self.devices);
        let is_inside = |device: &Device| {
            let is_on_way = self.entered.as_ref().is_some_and(|(from, to)| device.guards(from, to));
            device.places.contains(place) || is_on_way
        };
        let inside: BTreeSet<&DeviceId> =
            devices.iter().filter(|device| is_inside(device)).map(|device| &device.name).collect();
        let unavailable = self.watch.unavailable(&devices, reports, now);
        let others: Vec<(&Device, String)> =
            unavailable.into_iter().filter(|(device, _)| !inside.contains(&device.name)).collect();
        self.closed = others.iter().flat_map(|(device, _)| device.pairs()).collect();
        let text = |(device, problem): &(&Device, String)| format!("{} is unavailable: {problem}", device.name);
        self.problems = others.iter().map(text).collect();
        let closed: BTreeSet<&DeviceId> = others.iter().map(|(device, _)| &device.name).collect();
        let follows =
            |device: &Device| !device.places.is_empty() && then.iter().any(|(from, to)| device.guards(from, to));
        let is_requested =
            |device: &Device| requested.is_some_and(|(from, to)| device.guards(from, to)) || follows(device);
        // A robot needs all devices of its way or none.
        let is_open = !devices.iter().any(|device| is_requested(device) && closed.contains(&device.name));
        let is_needed = |device: &&Device| {
            let may_be_on_way = !self.knows_its_way && ahead.iter().any(|next| device.guards(place, next));
            let is_claimed = is_open && is_requested(device) || may_be_on_way && !closed.contains(&device.name);
            inside.contains(&device.name) || is_claimed
        };
        let needed: BTreeSet<&DeviceId> = devices.iter().filter(is_needed).map(|device| &device.name).collect();
        self.claims.retain(|device, _| needed.contains(device));
        for device in needed {
            self.claims.entry(device.clone()).or_default();
        }
        self.doubted.retain(|device, (report, since)| {
            let is_same = reports.get(device) == Some(&*report);
            self.claims.contains_key(device) && is_same && now.since(*since) < STALE_FOR
        });
        for (device, claim) in &mut self.claims {
            let Some(declared) = devices.get(device) else { continue };
            let mut ways = requested.or(self.entered.as_ref()).into_iter().chain(then);
            let way = ways.find(|(from, to)| declared.guards(from, to));
            let before = claim.place.take();
            let stop = || declared.places.contains(place).then(|| place.clone());
            claim.place = match way {
                Some((from, to)) => declared.place_for(from, to),
                None => before.clone().or_else(stop),
            };
            let turns = claim.lease.is_some() && before.is_some() && before != claim.place;
            if let Some(report) = reports.get(device).filter(|_| turns) {
                self.doubted.insert(device.clone(), (report.clone(), now));
            }
        }
        let is_between = !is_at_place && self.entered.is_some() && self.entered.as_ref() == requested;
        let unclaimed = DeviceClaim::default();
        let admits = |device: &Device| {
            let claim = self.claims.get(&device.name).unwrap_or(&unclaimed);
            let is_doubted = self.doubted.contains_key(&device.name);
            let report = reports.get(&device.name).filter(|_| !is_doubted);
            report.is_some_and(|report| report.admits(device, claim) || is_between && has_jammed_for(report, claim))
        };
        let is_leased = |device: &Device| self.claims.get(&device.name).is_some_and(|claim| claim.lease.is_some());
        let is_way_out_free =
            devices.iter().filter(|device| follows(device)).all(|device| is_leased(device) || admits(device));
        let is_free = |(from, to): &&Way| has_coordinator && is_way_out_free && devices.guarding(from, to).all(admits);
        let granted = requested.filter(is_free).cloned();
        self.is_granted = granted.is_some();
        if granted.is_some() && self.entered != granted {
            self.entered.clone_from(&granted);
            self.entered_from = (!is_at_place).then_some(pose);
        }
        self.is_waiting = requested.is_some() && self.entered.is_none();
        granted
    }

    /// Checks whether the robot has rested far from all ways for so long that it is on none of them.
    fn is_off_way(&mut self, situation: &AccessSituation) -> bool {
        let AccessSituation { is_at_place, is_at_rest, requested, ahead, now, .. } = *situation;
        if is_at_place || !is_at_rest || requested.is_some() || !ahead.is_empty() {
            self.off_way_since = None;
            return false;
        }
        now.since(*self.off_way_since.get_or_insert(now)) >= OFF_WAY_MAX
    }
}

/// Checks whether a device has not confirmed for a long time, or has lost this robot, and serves this claim. A robot that has
/// stopped in a doorway is the obstacle for which the door does not confirm: it drives on.
fn has_jammed_for(report: &DeviceReport, claim: &DeviceClaim) -> bool {
    let is_served = claim.lease.is_some() && (report.lease, &report.place) == (claim.lease, &claim.place);
    is_served && matches!(report.state, DeviceState::Silent | DeviceState::Blocked)
}

#[cfg(test)]
mod tests;
