//! What the nodes of devices report, and what follows for the routes of robots.

use super::{AlarmPosition, Device, Devices};
use crate::ids::DeviceId;
use crate::knowledge::{DeviceClaim, DeviceReport, DeviceState, KnowledgeBase};
use crate::units::NodeTime;
use std::collections::BTreeMap;

/// Latest reports of devices whose nodes are alive.
pub type DeviceReports = BTreeMap<DeviceId, DeviceReport>;

/// Observation of devices by a node: a device that no node reports is silent, too.
#[derive(Debug, Default)]
pub struct DeviceWatch {
    missing_since: BTreeMap<DeviceId, NodeTime>,
}

impl DeviceWatch {
    /// Returns the devices that no robot can use now, each with the problem as text.
    pub fn unavailable<'a>(
        &mut self,
        devices: &'a Devices,
        reports: &DeviceReports,
        now: NodeTime,
    ) -> Vec<(&'a Device, String)> {
        self.missing_since.retain(|device, _| !reports.contains_key(device));
        let problem = |device: &'a Device| {
            let problem = match reports.get(&device.name) {
                None => {
                    let since = *self.missing_since.entry(device.name.clone()).or_insert(now);
                    (now.since(since) >= device.silent_after).then(|| "no node reports it".to_owned())
                }
                Some(report) => report.problem(device),
            };
            Some((device, problem?))
        };
        devices.iter().filter_map(problem).collect()
    }
}

impl Devices {
    /// Returns the reports in these records. Every node can write any report into its own record, so the report about a
    /// device counts in the record of its host only.
    pub fn reports(&self, base: &KnowledgeBase) -> DeviceReports {
        let report = |device: &Device| {
            let reports = &base.get(&device.host)?.record.knowledge.devices.reports;
            Some((device.name.clone(), reports.get(&device.name)?.clone()))
        };
        self.iter().filter_map(report).collect()
    }
}

impl DeviceReport {
    /// Returns the reason for which no robot can use the device, as text.
    pub fn problem(&self, device: &Device) -> Option<String> {
        match self.state {
            DeviceState::Silent => Some("it does not confirm".to_owned()),
            DeviceState::Blocked => Some("a robot that is lost may be inside".to_owned()),
            DeviceState::Alarm if device.in_alarm != AlarmPosition::Open => Some("there is an alarm".to_owned()),
            DeviceState::Alarm | DeviceState::Idle | DeviceState::Preparing | DeviceState::Ready => None,
        }
    }

    /// Checks whether the device confirms a robot with this claim.
    pub fn admits(&self, device: &Device, claim: &DeviceClaim) -> bool {
        match self.state {
            DeviceState::Ready => claim.lease.is_some() && (self.lease, &self.place) == (claim.lease, &claim.place),
            DeviceState::Alarm => device.in_alarm == AlarmPosition::Open,
            DeviceState::Idle | DeviceState::Preparing | DeviceState::Silent | DeviceState::Blocked => false,
        }
    }
}
