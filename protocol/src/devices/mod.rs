//! Devices of a building that robots request before they enter: doors, lifts, call points, dispensers.
//!
//! ```text
//!  robot                         coordinator              node of the device             driver of the device
//!  claim ────────────────────▶ lease, if it is free
//!        ◀──────── notice ───────┘
//!  claim with the lease ──────────────────────────────▶ goal `serve` ───────────────────▶ opens, and holds
//!  enters ◀──────────────────────── report: ready for this lease ◀──── feedback `ready` ───┘
//!  no claim ──────────────────▶ end of the lease ─────▶ cancel ─────────────────────────▶ closes
//! ```
//!
//! Claims and reports are parts of the nodes' records, which their owners sign. A report counts in the record of the
//! device's host only ([`Devices::reports`]). The ledger contains the leases, which order the robots as those of
//! chargers do. A robot enters only while a coordinator is in contact, and while the device confirms the robot's lease.
//! A device that is silent, or has a lost robot inside, closes its lanes and places for routes, as a person would.
//!
//! A robot that stands inside of a device keeps it, so a robot enters once it has all devices whose places follow on its route.
//! Two robots from opposite sides of a door and a lift therefore do not wait for each other inside.

mod leases;
mod reports;
#[cfg(test)]
mod tests;

pub use leases::{DeviceLeases, DeviceUser};
pub use reports::{DeviceReports, DeviceWatch};

use crate::ids::{DeviceId, NodeId, PlaceId};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::iter;
use std::time::Duration;

/// Kind of a device, for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeviceKind {
    /// A door or a gate.
    Door,
    /// A lift.
    Lift,
    /// A point at which robots announce themselves.
    CallPoint,
    /// A machine that hands out items.
    Dispenser,
    /// Any other device.
    Other,
}

/// State of a device during an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmPosition {
    /// It is open, and robots pass without a request.
    Open,
    /// It is closed, and no robot passes.
    Closed,
    /// No robot uses it, as a lift.
    OutOfUse,
}

/// A device, as the fleet file declares it.
#[derive(Debug, Clone, PartialEq)]
pub struct Device {
    /// Its name.
    pub name: DeviceId,
    /// Its kind.
    pub kind: DeviceKind,
    /// Node that runs its driver. No other node reports the device.
    pub host: NodeId,
    /// Lanes and lift rides that it guards, in both directions.
    pub lanes: BTreeSet<(PlaceId, PlaceId)>,
    /// Places that it guards: the ways into them and out of them.
    pub places: BTreeSet<PlaceId>,
    /// Time without a response or a confirmation after which it counts as silent.
    pub silent_after: Duration,
    /// Its state during an alarm.
    pub in_alarm: AlarmPosition,
}

impl Device {
    /// Checks whether a robot needs the device for the way from a place to its neighbour.
    pub fn guards(&self, from: &PlaceId, to: &PlaceId) -> bool {
        let is_lane = |(a, b): &(PlaceId, PlaceId)| (a == from && b == to) || (a == to && b == from);
        from != to && (self.places.contains(from) || self.places.contains(to) || self.lanes.iter().any(is_lane))
    }

    /// Returns the guarded place at which a robot needs the device for a way: the stop of a lift that the robot enters, or
    /// leaves. `None` for a device on a lane.
    pub fn place_for(&self, from: &PlaceId, to: &PlaceId) -> Option<PlaceId> {
        [to, from].into_iter().find(|place| self.places.contains(*place)).cloned()
    }

    /// Returns its lanes by their ends, and each of its places twice, as closures of people.
    pub fn pairs(&self) -> impl Iterator<Item = (PlaceId, PlaceId)> {
        let places = self.places.iter().map(|place| (place.clone(), place.clone()));
        self.lanes.iter().cloned().chain(places)
    }
}

/// The devices of a fleet.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Devices(BTreeMap<DeviceId, Device>);

impl Devices {
    /// Creates them. Of several devices with the same name the last counts.
    pub fn new(devices: impl IntoIterator<Item = Device>) -> Devices {
        Devices(devices.into_iter().map(|device| (device.name.clone(), device)).collect())
    }

    /// Checks whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns all devices, in the order of their names.
    pub fn iter(&self) -> impl Iterator<Item = &Device> {
        self.0.values()
    }

    /// Returns a device.
    pub fn get(&self, name: &DeviceId) -> Option<&Device> {
        self.0.get(name)
    }

    /// Returns the devices that a robot needs for the way from a place to its neighbour.
    pub fn guarding(&self, from: &PlaceId, to: &PlaceId) -> impl Iterator<Item = &Device> {
        self.0.values().filter(move |device| device.guards(from, to))
    }

    /// Returns the ways of a route from a place to the first place that no device contains. A robot cannot wait on them
    /// without a device.
    pub fn ways_inside(&self, from: &PlaceId, route: &[PlaceId]) -> Vec<(PlaceId, PlaceId)> {
        let contains = |place: &PlaceId| self.0.values().any(|device| device.places.contains(place));
        let starts = iter::once(from).chain(route);
        let ways = starts.zip(route).take_while(|(start, _)| contains(start));
        ways.map(|(start, end)| (start.clone(), end.clone())).collect()
    }
}
