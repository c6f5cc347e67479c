//! Access to the ways that devices of the building guard, as a value: what the robot claims, and when it may enter.
//!
//! The robot claims all devices of the way that its skill requests, and of the place at which it stands. It enters when
//! each of them confirms the lease of the robot, while a coordinator is in contact. It keeps the claims until it has left.

use crate::robot_driver::Way;
use consort_protocol::devices::{Device, DeviceReports, DeviceWatch, Devices};
use consort_protocol::ids::{DeviceId, PlaceId};
use consort_protocol::knowledge::{DeviceClaim, DeviceClaims};
use consort_protocol::units::NodeTime;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Access of a robot.
pub(super) struct DeviceAccess {
    devices: Arc<Devices>,
    watch: DeviceWatch,
    claims: DeviceClaims,
    /// Way that the robot was allowed to drive, until it has arrived or has not left its place.
    entered: Option<Way>,
    /// True once the robot stood at a place: before, a former life of its node may have entered a way.
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
    /// Way that a skill requests.
    pub(super) requested: Option<&'a Way>,
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
            entered: None,
            knows_its_way: false,
            is_waiting: false,
            closed: vec![],
            problems: vec![],
        }
    }

    /// Returns the claims, for the record of the node.
    pub(super) fn claims(&self) -> &DeviceClaims {
        &self.claims
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
        let AccessSituation { place, is_at_place, requested, reports, has_coordinator, now } = *situation;
        let has_ended = |way: &Way| *place != way.0 || is_at_place && requested != Some(way);
        self.entered.take_if(|way| has_ended(way));
        self.knows_its_way |= is_at_place;
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
        let is_needed = |device: &&Device| {
            let is_requested = requested.is_some_and(|(from, to)| device.guards(from, to));
            let may_be_on_way = !self.knows_its_way && device.is_beside(place);
            inside.contains(&device.name) || (is_requested || may_be_on_way) && !closed.contains(&device.name)
        };
        let needed: BTreeSet<&DeviceId> = devices.iter().filter(is_needed).map(|device| &device.name).collect();
        self.claims.retain(|device, _| needed.contains(device));
        for device in needed {
            self.claims.entry(device.clone()).or_default();
        }
        for (device, claim) in &mut self.claims {
            let way = requested.or(self.entered.as_ref()).zip(devices.get(device));
            let way = way.filter(|((from, to), device)| device.guards(from, to));
            let place = way.map(|((from, to), device)| device.place_for(from, to));
            claim.place = place.unwrap_or_else(|| claim.place.take());
        }
        let unclaimed = DeviceClaim::default();
        let admits = |device: &Device| {
            let claim = self.claims.get(&device.name).unwrap_or(&unclaimed);
            reports.get(&device.name).is_some_and(|report| report.admits(device, claim))
        };
        let is_free = |(from, to): &&Way| has_coordinator && devices.guarding(from, to).all(admits);
        let granted = requested.filter(is_free).cloned();
        if granted.is_some() {
            self.entered.clone_from(&granted);
        }
        self.is_waiting = requested.is_some() && self.entered.is_none();
        granted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::devices::{AlarmPosition, DeviceKind};
    use consort_protocol::knowledge::{DeviceReport, DeviceState};
    use std::time::Duration;

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn door() -> DeviceId {
        "door".parse().unwrap()
    }

    fn access() -> DeviceAccess {
        let device = Device {
            name: door(),
            kind: DeviceKind::Door,
            lanes: [(place("A"), place("B"))].into(),
            places: BTreeSet::new(),
            silent_after: Duration::from_secs(5),
            in_alarm: AlarmPosition::Open,
        };
        DeviceAccess::new(Arc::new(Devices::new([device])))
    }

    fn reports(state: DeviceState, lease: Option<u64>) -> DeviceReports {
        DeviceReports::from([(door(), DeviceReport { state, lease, place: None })])
    }

    /// Decides for a robot at a place, or that has left it, with the way from A to B requested or not.
    fn decide(
        access: &mut DeviceAccess,
        (at, is_at_place): (&str, bool),
        requests: bool,
        reports: &DeviceReports,
        has_coordinator: bool,
    ) -> bool {
        let (at, way) = (place(at), (place("A"), place("B")));
        let requested = requests.then_some(&way);
        let now = NodeTime::at(Duration::from_secs(100));
        let situation = AccessSituation { place: &at, is_at_place, requested, reports, has_coordinator, now };
        access.decide(&situation).is_some()
    }

    #[test]
    fn a_robot_enters_once_the_device_confirms_its_lease() {
        let mut access = access();
        let (idle, ready) = (reports(DeviceState::Idle, None), reports(DeviceState::Ready, Some(7)));
        assert!(!decide(&mut access, ("A", true), true, &idle, true));
        assert_eq!(*access.claims(), DeviceClaims::from([(door(), DeviceClaim::default())]));
        assert!(!decide(&mut access, ("A", true), true, &ready, true), "the lease is not the robot's");
        access.receive_lease(&door(), 7);
        assert!(!decide(&mut access, ("A", true), true, &reports(DeviceState::Preparing, Some(7)), true));
        assert!(!decide(&mut access, ("A", true), true, &ready, false), "no coordinator");
        assert!(decide(&mut access, ("A", true), true, &ready, true));
        assert!(!decide(&mut access, ("A", false), false, &ready, false), "it stops between the places");
        assert_eq!(
            *access.claims(),
            DeviceClaims::from([(door(), DeviceClaim { lease: Some(7), place: None })]),
            "and keeps the door"
        );
        decide(&mut access, ("B", true), false, &ready, true);
        assert!(access.claims().is_empty());
    }

    #[test]
    fn a_silent_device_closes_its_lanes_for_robots_that_have_not_entered() {
        let mut access = access();
        let silent = reports(DeviceState::Silent, None);
        assert!(!decide(&mut access, ("A", true), true, &silent, true));
        assert_eq!(access.closed(), [(place("A"), place("B"))]);
        assert_eq!(access.problems().collect::<Vec<_>>(), ["door is unavailable: it does not confirm"]);
        assert!(access.claims().is_empty(), "the robot waits, or drives another way");
        assert!(!decide(&mut access, ("A", true), true, &reports(DeviceState::Idle, None), true));
        access.receive_lease(&door(), 7);
        assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Ready, Some(7)), true));
        assert!(!decide(&mut access, ("A", false), true, &silent, true));
        assert!(access.closed().is_empty(), "a robot on the way drives on");
        assert_eq!(access.claims().len(), 1);
    }

    #[test]
    fn a_robot_that_starts_between_two_places_claims_the_devices_beside_it() {
        let mut access = access();
        let idle = reports(DeviceState::Idle, None);
        decide(&mut access, ("A", false), false, &idle, true);
        assert_eq!(access.claims().len(), 1);
        decide(&mut access, ("A", true), false, &idle, true);
        assert!(access.claims().is_empty());
        decide(&mut access, ("A", false), false, &idle, true);
        assert!(access.claims().is_empty(), "it drives another way");
    }

    #[test]
    fn a_door_that_is_open_in_an_alarm_needs_no_lease() {
        let mut access = access();
        assert!(decide(&mut access, ("A", true), true, &reports(DeviceState::Alarm, None), true));
    }
}
