//! Simulated people: driver servers answer only for those that their certificates name.

use super::{ROOM, SOON, closed, stolen, wire};
use crate::support::task_began;
use consort_bus::{Delivery, Encoding, SharedBus};
use consort_fleet::robot_driver::{PersonCommand, PersonEvent, PersonRequestState};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::keys::{Key, Keys, PeopleCall};
use consort_protocol::trust::NodeRole;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Answers each request to a person: it is done. Counts the requests.
async fn answer_for_people(bus: SharedBus, keys: Keys, answered: Arc<AtomicU64>) {
    let ended_key = keys.write(&Key::People(PeopleCall::Done));
    let mut queries = bus.serve(&keys.write(&Key::People(PeopleCall::Ask))).await.expect("a network");
    while let Some(query) = queries.recv().await {
        let command: PersonCommand = codec::decode(&query.payload).expect("a command of the coordinator");
        let reply = wire(&PersonRequestState::Ended(Ok(BTreeMap::new())));
        let _ = query.replier.reply(&query.key, reply, Encoding::Wire).await;
        let ended = wire(&PersonEvent::RequestEnded { id: command.id, result: Ok(BTreeMap::new()) });
        bus.publish(&ended_key, ended, Encoding::Wire, Delivery::Block).await.expect("a network");
        answered.fetch_add(1, Ordering::Relaxed);
    }
}

/// Cancels the mission of `gorse` in the name of a nurse.
async fn cancel_for_people(bus: SharedBus, keys: Keys) {
    let key = keys.write(&Key::People(PeopleCall::Done));
    for at_ms in 0.. {
        let (by, role, robot) = ("Nia".to_owned(), slug("nurse"), slug("gorse"));
        let cancel = wire(&PersonEvent::CancelMission { by, role, robot, at_ms });
        bus.publish(&key, cancel, Encoding::Wire, Delivery::Block).await.expect("a network");
        tokio::time::sleep(Duration::from_millis(200)).await; // virtual time
    }
}

/// The nurse does not receive the request, so only the false driver servers answer it.
#[test]
fn a_driver_server_answers_only_for_its_people() {
    for_each_seed([51, 52], async |seed| {
        let mut fleet = closed(seed, RobotSpec::carrier("fern", "Dock").starting_later()).await;
        let keys = fleet.keys().clone();
        fleet.network.block_queries(slug("world"), &keys.write(&Key::People(PeopleCall::Ask)));
        let (answered, mut attack) = (Arc::<AtomicU64>::default(), tokio::task::JoinSet::new());
        let other: SharedBus = stolen(&fleet, "mallory", NodeRole::Host).await.signing;
        attack.spawn(answer_for_people(Arc::clone(&other), keys.clone(), Arc::clone(&answered)));
        attack.spawn(cancel_for_people(other, keys.clone()));
        let mission = fleet.submit("a", ROOM).await;
        fleet.wait_until("a request to the nurse", SOON, |fleet| fleet.has_event(task_began("deposit"))).await;
        let deposited =
            |what: &EventKind| matches!(what, EventKind::TaskEnded { task, .. } if task.as_str() == "deposit");
        let is_over = |fleet: &Fleet| fleet.mission_state(&mission).is_some_and(|state| state.is_final());
        let is_believed = |fleet: &Fleet| fleet.has_event(deposited) || is_over(fleet);
        fleet.assert_never("the end of the request or the mission", Duration::from_secs(5), is_believed).await;
        let count = answered.load(Ordering::Relaxed);
        assert!(count > 2, "seed {seed}: {count} answers by mallory");
        // With a certificate that names the role `nurse`, the same messages count.
        let own: SharedBus = stolen(&fleet, "nurse", NodeRole::Host).await.signing;
        attack.spawn(answer_for_people(Arc::clone(&own), keys.clone(), Arc::default()));
        fleet.wait_until("the answer", SOON, |fleet| fleet.has_event(deposited)).await;
        attack.spawn(cancel_for_people(own, keys));
        let end = format!("{:?}", fleet.wait_for_end(&mission).await);
        assert!(end.contains("Nia, according to nurse"), "seed {seed}: {end}");
        attack.shutdown().await;
    });
}
