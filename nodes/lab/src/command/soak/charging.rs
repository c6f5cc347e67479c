//! The charger of the fleet, and the batteries of its carriers, which charge and park by themselves.

use super::names::CARRIERS;
use toml::{Table, Value};

/// Power of the charger. A battery gains 0.2 % per second of the world, and a robot charges for half a minute.
const POWER_W: f64 = 720.0;

/// Capacity of the batteries, as in the example of a world. With the power of the charger the robots plan stops there.
const CAPACITY_WH: f64 = 100.0;

/// Charges of the carriers at the start. They suffice for two or three missions, so both need the charger soon.
const CHARGES: [f64; CARRIERS.len()] = [0.35, 0.3];

/// Charge that a role must leave. Faults and orders prolong drives beyond their estimates, and the battery of a robot that
/// strands below 0.05 is not replaced.
const CHARGE_MIN: f64 = 0.15;

/// Places for idle robots.
const PARKING: [&str; 2] = ["Laboratory Corridor", "PC Corridor 1"];

/// Changes the example of a fleet file, which has the charger.
pub(super) fn change_fleet(fleet: &mut Table) {
    if let Some(limits) = fleet.get_mut("limits").and_then(Value::as_table_mut) {
        limits.insert("charge_min".to_owned(), CHARGE_MIN.into());
    }
    if let Some(charging) = fleet.get_mut("charging").and_then(Value::as_table_mut) {
        charging.insert("parking".to_owned(), PARKING.to_vec().into());
        let chargers = charging.get_mut("charger").and_then(Value::as_array_mut);
        for charger in chargers.into_iter().flatten().filter_map(Value::as_table_mut) {
            charger.insert("power_w".to_owned(), POWER_W.into());
        }
    }
}

/// Changes the body of a carrier in a world file: its charge at the start.
pub(super) fn change_body(body: &mut Table) {
    let id = body.get("id").and_then(Value::as_str);
    let charge = CARRIERS.iter().position(|carrier| id == Some(*carrier)).map(|number| CHARGES[number]);
    if let Some(charge) = charge {
        body.insert("battery".to_owned(), charge.into());
    }
}

/// Changes the file of a carrier.
pub(super) fn change_robot(robot: &mut Table) {
    robot.insert("capacity_wh".to_owned(), CAPACITY_WH.into());
}

/// Lets the battery of a robot last for ever, in its own file and in that of the world.
pub(super) fn remove_discharge(robot: &mut Table) {
    robot.insert("discharge_share_per_s".to_owned(), 0.0.into());
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::PlaceId;
    use consort_tests::example_files::example;
    use consort_tests::slug;

    #[test]
    fn both_carriers_have_to_charge_and_leave_a_reserve() {
        let mut fleet = example("fleet");
        change_fleet(&mut fleet);
        let charging = &fleet["charging"];
        assert_eq!(charging["charger"][0]["power_w"].as_float(), Some(POWER_W));
        assert_eq!(fleet["limits"]["charge_min"].as_float(), Some(CHARGE_MIN));
        let tops_up_below = charging["opportunistic"].as_float().unwrap();
        assert!(CHARGES.iter().all(|charge| (CHARGE_MIN..tops_up_below).contains(charge)));
        let mut robot = example("robot");
        change_robot(&mut robot);
        let body = &example("world")["robot"][0];
        assert_eq!(robot["capacity_wh"], body["capacity_wh"]);
        assert_eq!(robot["discharge_share_per_s"], body["discharge_share_per_s"]);
    }

    #[test]
    fn each_carrier_starts_with_its_charge() {
        let charge = |id: &str| {
            let mut body = Table::from_iter([("id".to_owned(), id.into()), ("battery".to_owned(), 1.0.into())]);
            change_body(&mut body);
            body["battery"].as_float()
        };
        assert_eq!(CARRIERS.map(charge), CHARGES.map(Some));
        assert_eq!(charge("lab-arm"), Some(1.0));
    }

    #[test]
    fn the_parking_places_are_on_the_map() {
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        assert!(PARKING.iter().all(|place| map.place(&slug::<PlaceId>(place)).is_some()));
    }
}
