//! How long a simulated second of a swarm takes: robots drive to and fro on a yard of their own lanes for an hour.
//!
//! `cargo run --release -p consort-sim --example swarm -- 200`

#![expect(clippy::print_stdout, reason = "an example answers on the terminal")]

use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
use consort_sim::map::{LaneEntry, MapFile, PlaceEntry, PlaceKind};
use consort_sim::world::{RobotBody, World, WorldSetup};
use consort_skills::actions::{BodyEvent, BodyHost, Goal, GoalId};
use std::time::Instant;

const HOUR_S: f64 = 3600.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robots: usize = std::env::args().nth(1).map_or(Ok(200), |text| text.parse())?;
    let post = |name: String, x_m: f64, y_m: f64| PlaceEntry {
        name,
        kind: PlaceKind::Other,
        x_m,
        y_m,
        ..PlaceEntry::default()
    };
    let lane = |a: String, b: String| LaneEntry { between: (a, b), ..LaneEntry::default() };
    let mut file = MapFile { name: "yard".into(), ..MapFile::default() };
    for n in 0..robots {
        file.places.extend([post(format!("{n} a"), n as f64, 0.0), post(format!("{n} b"), n as f64, 10.0 + n as f64)]);
        file.lanes.push(lane(format!("{n} a"), format!("{n} b")));
        if n > 0 {
            file.lanes.push(lane(format!("{} a", n - 1), format!("{n} a")));
        }
    }
    let mut setup = WorldSetup::new(file.check("yard")?, 1);
    for n in 0..robots {
        setup.robots.push(RobotBody::carrier(
            RobotId::new(format!("d{n}"))?,
            PlaceId::new(format!("{n} a"))?,
            MetresPerSecond::new(2.0)?,
            BatteryShare::FULL,
            SharePerSecond::new(0.0001)?,
        ));
    }
    let mut world = World::new(setup)?;
    let began = Instant::now();
    let mut legs = 0;
    let mut next = |world: &mut World, robot: &RobotId| -> Result<(), Box<dyn std::error::Error>> {
        let here = world.telemetry(robot).ok_or("a robot of this world")?.place;
        let (row, end) = here.as_str().split_once(' ').ok_or("a post of this yard")?;
        let to = PlaceId::new(format!("{row} {}", if end == "a" { "b" } else { "a" }))?;
        let pose = world.map().place(&to).ok_or("a post of this yard")?.pose;
        legs += 1;
        world.start(robot, GoalId(legs), Goal::NavigateToPose { pose, place: Some(to) });
        Ok(())
    };
    for robot in world.robots() {
        next(&mut world, &robot)?;
    }
    while let Some(due) = world.next_due().filter(|due| *due <= WorldTime::from_secs(HOUR_S)) {
        for event in world.advance(due) {
            if let BodyEvent::GoalEnded { robot, .. } = event {
                next(&mut world, &robot)?;
            }
        }
    }
    let took = began.elapsed().as_secs_f64();
    println!("{robots} robots, {legs} legs in one hour: {:.9} s per simulated second", took / HOUR_S);
    Ok(())
}
