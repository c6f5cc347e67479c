//! Bugs in the records that a node exchanges with others.

use crate::slug;
use bytes::Bytes;
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::Record;
use consort_protocol::message::{Exchange, RecordUpdate};

/// Changes a message, and encodes it in its version.
fn changed<T: VersionedMessage>(payload: Bytes, change: impl FnOnce(&mut T)) -> Bytes {
    let Ok(mut message) = codec::decode_any_version::<T>(&payload) else { return payload };
    change(&mut message);
    let version = payload.first().copied().unwrap_or(codec::FIRST_VERSION);
    codec::encode_for_version(version, message).expect("a changed message fits a message").into()
}

/// Removes the records of all other owners from an exchange of gossip.
pub(super) fn retain_records_of(owner: &NodeId, payload: Bytes) -> Bytes {
    changed(payload, |exchange: &mut Exchange| exchange.records.retain(|record| record.owner == *owner))
}

/// Hides at which chargers robots are, in an exchange of gossip.
pub(super) fn exchange_without_claims(payload: Bytes) -> Bytes {
    changed(payload, |exchange: &mut Exchange| exchange.records.iter_mut().for_each(hide_claim))
}

/// Hides at which charger a robot is, in a published record.
pub(super) fn update_without_claim(payload: Bytes) -> Bytes {
    changed(payload, |update: &mut RecordUpdate| {
        if let RecordUpdate::Record(record) = update {
            hide_claim(record);
        }
    })
}

fn hide_claim(record: &mut Record) {
    if let Some(robot) = &mut record.knowledge.robot {
        // A place without a charger.
        (robot.place, robot.charging) = (slug("Laboratory"), None);
    }
}
