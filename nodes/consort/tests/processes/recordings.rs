//! Recordings of a world, however its process ends, and recordings of a fleet when its coordinator
//! or the recorder is killed.

use crate::support::{Client, Folder, LONG, Program, hospital, until};
use consort_dashboard::recording::{RecordingReader, TimelineMarkKind};
use std::fs;
use std::path::Path;
use std::time::Duration;

/// First bytes of an MCAP file, and last bytes of a complete one.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

const WORLD: &str = "name = \"world\"\nspeed = 50.0\n[[robot]]\nid = \"ada\"\nplace = \"Dock\"\nspeed_mps = 0.6\n\
                     battery = 0.9\ndischarge_share_per_s = 0.0004\n";

/// Starts a recorded world.
fn recorded(folder: &Folder) -> Program {
    fs::write(folder.path().join("world.toml"), WORLD).expect("the folder can be written to");
    let arguments = ["world", "--config", "world.toml", "--record", "run.mcap", "--svg", "paths.svg"];
    let mut world = Program::start(folder, "world", &arguments);
    until("the world's start", LONG, || {
        assert!(!world.has_ended(), "it has ended:\n{}", world.stderr());
        world.stderr().contains("started").then_some(())
    });
    world
}

#[test]
fn a_stopped_world_completes_its_recordings() {
    for signal in ["TERM", "INT"] {
        let folder = Folder::new();
        let world = recorded(&folder);
        world.signal(signal);
        let ended = world.end(LONG).expect(0);
        for file in ["run.mcap: ", "paths.svg: "] {
            assert!(ended.stderr.contains(file), "{file}\n{}", ended.stderr);
        }
        let mcap = fs::read(folder.path().join("run.mcap")).expect("a recording");
        assert!(mcap.starts_with(MAGIC) && mcap.ends_with(MAGIC) && mcap.len() > 1000, "{} bytes", mcap.len());
        let svg = fs::read_to_string(folder.path().join("paths.svg")).expect("a picture");
        assert!(svg.starts_with("<svg") && svg.contains("paths driven in"), "{svg:.200}");
    }
}

#[test]
fn a_killed_world_leaves_a_partial_recording() {
    let folder = Folder::new();
    let mut world = recorded(&folder);
    // The initial state of the world is written after 5 s of world time, which is a tenth of a
    // second.
    let written = || fs::read(folder.path().join("run.mcap")).ok().filter(|mcap| mcap.len() > 1000);
    until("the first chunk", LONG, written);
    world.kill();
    let mcap = written().expect("a recording");
    assert!(mcap.starts_with(MAGIC) && !mcap.ends_with(MAGIC), "{} bytes", mcap.len());
    assert_eq!(fs::read_to_string(folder.path().join("paths.svg")).expect("made ready"), "");
}

/// Checks whether a file contains a text.
fn holds(file: &Path, text: &str) -> Option<()> {
    let there = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).contains(text);
    fs::read(file).is_ok_and(there).then_some(())
}

#[test]
fn a_recorder_survives_the_loss_of_its_node_and_can_be_killed() {
    let long = Duration::from_secs(60);
    let mut fleet = hospital("linked");
    let client = Client::open(&fleet.address("world"), "linked");
    let coordinator =
        until("there is a coordinator", long, || Some(client.view("coordinator")["node"].as_str()?.to_owned()));
    let (address, file) = (fleet.address(&coordinator), fleet.path("run.mcap"));
    let name = file.display().to_string();
    // The client uses the first reachable node.
    let mut recorder = fleet.begin(&["record", "--out", &name, "--connect", &address], "world");
    until("it has received the coordinator", long, || holds(&file, &format!(r#"{{"node":"{coordinator}","term":"#)));
    fleet.kill(&coordinator);
    let next = until("there is another coordinator", long, || {
        let node = client.view("coordinator")["node"].as_str()?.to_owned();
        (node != coordinator).then_some(node)
    });
    until("it has received the new coordinator", long, || holds(&file, &format!(r#"{{"node":"{next}","term":"#)));
    recorder.kill();
    let recording = RecordingReader::open(&file).expect("the recording is readable");
    assert!(recording.damage().is_some_and(|problem| problem.contains("it has no end")), "{:?}", recording.damage());
    let changes = recording.marks().iter().filter(|mark| mark.kind == TimelineMarkKind::Coordinator);
    assert!(
        changes.clone().any(|mark| mark.text.starts_with(&format!("coordinator {next}"))),
        "{:?}",
        recording.marks()
    );
    let before = changes.clone().next().expect("there is a change").at_ms - 1;
    assert_eq!(recording.model_at(before).coordinator().map(|now| now.node.as_str()), Some(coordinator.as_str()));
    fleet.stop();
}
