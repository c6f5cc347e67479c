//! Recordings of worlds, read back.

mod driven_paths;
mod foxglove;

use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond, WorldTime};
use consort_skills::actions::{FollowWaypoints, Goal, GoalId, RobotBackend, Waypoint};
use consort_world::SharedWorld;
use consort_world::map;
use consort_world::record::{Recorder, RecordingOutputs};
use consort_world::world::{PersonSetup, RobotSetup, World, WorldSetup};
use std::fs;
use std::path::PathBuf;

const HALL: &str = "{name: hall, walls: [[[-1, -1], [11, -1], [11, 6]]], \
    places: [{name: A, kind: dock, x_m: 0, y_m: 0}, {name: B, kind: room, x_m: 10, y_m: 0}, \
    {name: C, kind: lab, x_m: 10, y_m: 5}], \
    lanes: [{between: [A, B]}, {between: [B, C]}], doors: [{name: Door, on: [[A, B]], opening_s: 1}]}";

pub(crate) fn at(seconds: f64) -> WorldTime {
    WorldTime::from_secs(seconds)
}

pub(crate) fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

pub(crate) fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

pub(crate) fn carrier(name: &str, at: &str) -> RobotSetup {
    let (speed, discharge) = (MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap());
    RobotSetup::carrier(robot(name), place(at), speed, BatteryShare::FULL, discharge)
}

/// A file for a single test, removed at its end.
pub(crate) struct TempFile(pub(crate) PathBuf);

impl TempFile {
    pub(crate) fn named(name: &str) -> TempFile {
        TempFile(std::env::temp_dir().join(format!("consort-record-{}-{name}", std::process::id())))
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// Ada drives from A via B to C and back to B; Bob stands at C.
pub(crate) fn hall() -> SharedWorld {
    let setup = WorldSetup::new(map::read(HALL, "hall.yaml").unwrap(), 1);
    let nia =
        PersonSetup { samples: vec!["blood".into()], ..PersonSetup::new("Nia", "nurse".parse().unwrap(), place("B")) };
    let setup = setup.robot(carrier("ada", "A")).robot(carrier("bob", "C")).person(nia);
    SharedWorld::new(World::new(setup).unwrap())
}

pub(crate) fn there_and_back(world: &mut SharedWorld) {
    let waypoints = ["B", "C", "B"].map(|name| {
        let pose = world.with(|world| world.map().place(&place(name)).unwrap().pose);
        Waypoint { pose, place: Some(place(name)) }
    });
    world.start(&robot("ada"), GoalId(1), Goal::from(FollowWaypoints { waypoints: waypoints.into() }));
}

pub(crate) fn record(world: &SharedWorld, outputs: &RecordingOutputs) {
    world.record(Recorder::open(outputs).unwrap().unwrap());
}

/// Advances the hall by a minute, in steps that are independent of its events.
pub(crate) fn run_one_minute(world: &mut SharedWorld) {
    there_and_back(world);
    for step in 1..=120 {
        world.advance(at(f64::from(step) * 0.5 + 0.037));
    }
}

#[test]
fn no_outputs_give_no_recorder() {
    assert!(Recorder::open(&RecordingOutputs::default()).unwrap().is_none());
}

#[test]
fn a_recorded_world_runs_exactly_the_same() {
    let (mcap, svg) = (TempFile::named("course.mcap"), TempFile::named("course.svg"));
    let course = |recorded: bool| {
        let mut world = hall();
        if recorded {
            record(&world, &RecordingOutputs { mcap: Some(mcap.0.clone()), svg: Some(svg.0.clone()) });
        }
        assert_eq!(world.is_recorded(), recorded);
        there_and_back(&mut world);
        let told: Vec<_> = (1..=60).flat_map(|second| world.advance(at(f64::from(second)))).collect();
        (told, world.with(World::drain_event_log), world.report(), world.end_recording().len())
    };
    let (plain, recorded) = (course(false), course(true));
    assert_eq!((plain.0, plain.1, plain.2), (recorded.0, recorded.1, recorded.2));
    assert_eq!((plain.3, recorded.3), (0, 2));
}
