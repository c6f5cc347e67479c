//! Bugs in the records that a node exchanges with others.

use super::Mutant;
use crate::slug;
use bytes::Bytes;
use consort_bus::record_signer::{ProofStatus, RecordSigner, SharedRecordSigner};
use consort_protocol::codec::{self, VersionedMessage};
use consort_protocol::ids::NodeId;
use consort_protocol::knowledge::{Availability, Charging, Proof, Record};
use consort_protocol::message::{Exchange, RecordUpdate};

/// Signer that accepts every forwarded record.
pub(super) struct NoVerification(pub(super) SharedRecordSigner);

impl RecordSigner for NoVerification {
    fn sign(&self, record: &Record) -> Proof {
        self.0.sign(record)
    }

    fn verify(&self, _: &Record) -> ProofStatus {
        ProofStatus::Valid
    }
}

/// Change of each record that a node receives.
pub(super) type RecordBug = fn(&mut Record);

/// Returns the change of records of a mutant, if the mutant concerns them.
pub(super) fn record_bug(mutant: Mutant) -> Option<RecordBug> {
    match mutant {
        Mutant::ClaimsHidden => Some(hide_claim),
        Mutant::HoldersUnfit => Some(hide_fitness),
        Mutant::LeaseIgnored => Some(hide_lease),
        _ => None,
    }
}

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

/// Changes the records in an exchange of gossip.
pub(super) fn exchange_with(bug: RecordBug, payload: Bytes) -> Bytes {
    changed(payload, |exchange: &mut Exchange| exchange.records.iter_mut().for_each(bug))
}

/// Changes a published record.
pub(super) fn update_with(bug: RecordBug, payload: Bytes) -> Bytes {
    changed(payload, |update: &mut RecordUpdate| {
        if let RecordUpdate::Record(record) = update {
            bug(record);
        }
    })
}

/// Hides at which charger a robot is.
fn hide_claim(record: &mut Record) {
    if let Some(robot) = &mut record.knowledge.robot {
        // A place without a charger.
        (robot.place, robot.charging) = (slug("Laboratory"), None);
    }
}

/// Hides at which charger a robot is that has its lease.
fn hide_lease(record: &mut Record) {
    let charging = record.knowledge.robot.as_ref().and_then(|robot| robot.charging.as_ref());
    if charging.and_then(Charging::claim).is_some_and(|claim| claim.lease.is_some()) {
        hide_claim(record);
    }
}

/// Lets a robot with a role appear to be out of service.
fn hide_fitness(record: &mut Record) {
    if let Some(robot) = &mut record.knowledge.robot
        && matches!(robot.availability, Availability::Holding { .. })
    {
        robot.availability = Availability::OutOfService { problem: "it has a role".to_owned() };
    }
}
