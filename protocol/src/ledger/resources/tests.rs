use super::*;
use crate::ledger::Command;

fn at(index: u64) -> Epoch {
    Epoch { term: 1, index }
}

fn place(name: &str) -> PlaceId {
    name.parse().unwrap()
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

fn charger_at(name: &str) -> Resource {
    Resource::Charger(place(name))
}

fn ledger() -> Ledger {
    let mut ledger = Ledger::default();
    ledger.apply(at(1), Command::first_wire_version(HISTORY_SINCE));
    ledger
}

fn lease(charger: &str, name: &str) -> Command {
    Command::LeaseResource { resource: charger_at(charger), robot: robot(name), at_ms: 7 }
}

fn leased(charger: &str, name: &str) -> CommandOutcome {
    CommandOutcome::Refused(CommandError::ResourceLeased { resource: charger_at(charger), robot: robot(name) })
}

#[test]
fn a_charger_has_one_lease_and_a_robot_at_most_one() {
    let mut ledger = ledger();
    assert_eq!(ledger.apply(at(2), lease("P", "ada")), CommandOutcome::Done);
    assert_eq!(ledger.apply(at(3), lease("P", "ada")), leased("P", "ada"), "a repetition");
    assert_eq!(ledger.apply(at(4), lease("P", "bob")), leased("P", "ada"));
    assert_eq!(ledger.apply(at(5), lease("Q", "ada")), leased("P", "ada"));
    let expected = ResourceLease { robot: robot("ada"), epoch: at(2), since_ms: 7 };
    assert_eq!(ledger.charger_leases(), BTreeMap::from([(place("P"), expected)]));
}

#[test]
fn a_delayed_end_of_a_lease_ends_no_later_lease() {
    let mut ledger = ledger();
    ledger.apply(at(2), lease("P", "ada"));
    let free = || Command::FreeResource { resource: charger_at("P"), epoch: at(2) };
    assert_eq!(ledger.apply(at(3), free()), CommandOutcome::Done);
    ledger.apply(at(4), lease("P", "bob"));
    let refused = CommandError::NoResourceLease { resource: charger_at("P"), epoch: at(2) };
    assert_eq!(ledger.apply(at(5), free()), CommandOutcome::Refused(refused));
    assert_eq!(ledger.charger_leases()[&place("P")].robot, robot("bob"));
}

#[test]
fn there_are_no_leases_before_the_version_with_a_history() {
    let mut ledger = Ledger::default();
    ledger.apply(at(1), Command::first_wire_version(HISTORY_SINCE - 1));
    let refused = CommandError::NoOrdersYet { since: HISTORY_SINCE };
    assert_eq!(ledger.apply(at(2), lease("P", "ada")), CommandOutcome::Refused(refused));
}

/// Leases chargers with names of this length until a lease is refused. Returns the number of leases.
fn fill(ledger: &mut Ledger, chars: usize) -> usize {
    let mut outcome = |number: usize| {
        let (charger, name) = (format!("{number:🔌>chars$}"), format!("{number:0>chars$}"));
        ledger.apply(
            at(u64::MAX),
            Command::LeaseResource { resource: charger_at(&charger), robot: robot(&name), at_ms: u64::MAX },
        )
    };
    let refused = (0..).find(|number| outcome(*number) != CommandOutcome::Done).expect("a limit");
    assert_eq!(outcome(refused), CommandOutcome::Refused(CommandError::ResourceLeasesFull));
    refused
}

#[test]
fn leases_have_a_limit_and_are_stored_with_the_ledger() {
    let mut ledger = ledger();
    assert!(ledger.has_room_for_lease());
    let count = fill(&mut ledger, 64);
    assert!(!ledger.has_room_for_lease());
    assert!((100..1000).contains(&count), "{count}");
    let encoded = codec::encode_record(ledger.resource_leases()).unwrap();
    assert!(encoded.len() <= RESOURCE_LEASES_BYTES_MAX, "{}", encoded.len());
    let stored = codec::encode_record(&ledger).unwrap();
    assert_eq!(codec::decode_record::<Ledger>(&stored).unwrap(), ledger);
    let count = fill(&mut self::ledger(), 4);
    assert!((1000..10_000).contains(&count), "{count} with short names");
}

#[test]
fn a_robot_may_have_several_devices_beside_a_charger() {
    let mut ledger = ledger();
    let device = |name: &str| Resource::Device(name.parse().unwrap());
    let lease_device =
        |name: &str, to: &str| Command::LeaseResource { resource: device(name), robot: robot(to), at_ms: 7 };
    assert_eq!(ledger.apply(at(2), lease("P", "ada")), CommandOutcome::Done);
    assert_eq!(ledger.apply(at(3), lease_device("lift", "ada")), CommandOutcome::Done);
    assert_eq!(ledger.apply(at(4), lease_device("door", "ada")), CommandOutcome::Done);
    let taken = CommandError::ResourceLeased { resource: device("lift"), robot: robot("ada") };
    assert_eq!(ledger.apply(at(5), lease_device("lift", "bob")), CommandOutcome::Refused(taken));
    let leases = ledger.device_leases();
    assert_eq!(leases.keys().map(DeviceId::as_str).collect::<Vec<_>>(), ["door", "lift"]);
    assert_eq!(ledger.charger_leases().len(), 1);
}
