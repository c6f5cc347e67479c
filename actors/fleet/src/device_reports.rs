//! Reports of the devices of the building, from the records of the nodes that drive them.

use consort_gossip::SharedKnowledge;
use consort_protocol::devices::{DeviceReports, Devices};
use consort_protocol::ids::NodeId;

/// Returns the reports of hosts that are up. `own` is the node that asks, which is up.
pub(crate) fn device_reports(knowledge: &SharedKnowledge, devices: &Devices, own: &NodeId) -> DeviceReports {
    let mut reports = knowledge.read(|base| devices.reports(base));
    let is_up = |host: &NodeId| host == own || knowledge.is_alive(host);
    reports.retain(|device, _| devices.get(device).is_some_and(|device| is_up(&device.host)));
    reports
}
