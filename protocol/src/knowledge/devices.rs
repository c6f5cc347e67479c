//! Devices in a record: the claims of the node's robot, and the reports of the devices that the node drives.

use crate::ids::{DeviceId, PlaceId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Devices that a robot needs.
pub type DeviceClaims = BTreeMap<DeviceId, DeviceClaim>;

/// Claim of a robot to a device.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceClaim {
    /// Position in the log at which the coordinator has leased the device to the robot; `None` without a lease.
    pub lease: Option<u64>,
    /// Guarded place at which the robot needs the device, as a stop of a lift; `None` for a device on a lane.
    pub place: Option<PlaceId>,
}

/// Devices in a node's record.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceKnowledge {
    /// Claims of its robot; `None` while the node does not know where its robot is, as after a start. Until then its earlier
    /// claims count.
    pub claims: Option<DeviceClaims>,
    /// Reports of the devices that this node serves.
    pub reports: BTreeMap<DeviceId, DeviceReport>,
}

/// State of a device, as its node reports it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// Its state.
    pub state: DeviceState,
    /// Lease for which it opens or has opened, by its position in the log.
    pub lease: Option<u64>,
    /// Guarded place at which it opens or has opened.
    pub place: Option<PlaceId>,
}

/// State of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceState {
    /// It serves no robot.
    Idle,
    /// It opens, or comes.
    Preparing,
    /// The robot may enter.
    Ready,
    /// Its driver does not respond, or does not confirm.
    Silent,
    /// It has the state that is declared for alarms.
    Alarm,
    /// The robot with its lease is lost, and may be inside. The state lasts until the robot returns, or until its lease and
    /// then the goal of the driver have ended.
    Blocked,
}
