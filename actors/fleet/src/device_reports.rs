//! Reports of the devices of the building, from the records of the nodes that drive them.

use consort_gossip::SharedKnowledge;
use consort_protocol::devices::DeviceReports;
use consort_protocol::ids::NodeId;

/// Returns the reports of nodes that are up. `own` is the node that asks, which is up. Of several reports about a device
/// that of the last node by name counts.
pub(crate) fn device_reports(knowledge: &SharedKnowledge, own: &NodeId) -> DeviceReports {
    let known: Vec<(NodeId, DeviceReports)> = knowledge.read(|base| {
        let reports = base.iter().map(|(node, known)| (node, &known.record.knowledge.devices.reports));
        let reports = reports.filter(|(_, reports)| !reports.is_empty());
        reports.map(|(node, reports)| (node.clone(), reports.clone())).collect()
    });
    known
        .into_iter()
        .filter(|(node, _)| node == own || knowledge.is_alive(node))
        .flat_map(|(_, reports)| reports)
        .collect()
}
