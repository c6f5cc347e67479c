//! The robots of a fleet with respect to chargers, from their records.

use consort_gossip::SharedKnowledge;
use consort_protocol::chargers::ChargerUser;
use consort_protocol::ids::{NodeId, RobotId};

/// Returns all robots with a known record, in the order of their names. A robot that is down stands where it was, and claims
/// no charger. `own` is the node that asks, which is up.
pub(crate) fn charger_users(knowledge: &SharedKnowledge, own: &NodeId) -> Vec<ChargerUser> {
    let known: Vec<(NodeId, ChargerUser)> = knowledge.read(|base| {
        let user = base.iter().filter_map(|(node, known)| {
            let robot = known.knowledge().robot.as_ref()?;
            let (place, battery, charging) = (robot.place.clone(), robot.battery, robot.charging.clone());
            let user = ChargerUser { robot: RobotId::from(node.clone()), place, battery, charging, is_alive: true };
            Some((node.clone(), user))
        });
        user.collect()
    });
    let user = |(node, user): (NodeId, ChargerUser)| match node == *own || knowledge.is_alive(&node) {
        true => user,
        false => ChargerUser { charging: None, is_alive: false, ..user },
    };
    known.into_iter().map(user).collect()
}
