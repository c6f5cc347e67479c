//! What is recorded of a world, however its process ends.

use crate::support::{Folder, Program, until};
use std::fs;
use std::time::Duration;

/// MCAP files begin and, if they are complete, end with this.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

const WORLD: &str = "name = \"world\"\nspeed = 50.0\n[[robot]]\nid = \"ada\"\nplace = \"Dock\"\nspeed_mps = 0.6\n\
                     battery = 0.9\ndischarge_share_per_s = 0.0004\n";

/// A world that is up, and recorded.
fn recorded(folder: &Folder) -> Program {
    fs::write(folder.path().join("world.toml"), WORLD).expect("the folder can be written to");
    let arguments = ["world", "--config", "world.toml", "--record", "run.mcap", "--svg", "paths.svg"];
    let mut world = Program::start(folder, "world", &arguments);
    until("the world's start", Duration::from_secs(60), || {
        assert!(!world.has_ended(), "it has ended:\n{}", world.stderr());
        world.stderr().contains("started").then_some(())
    });
    world
}

#[test]
fn a_world_that_is_told_to_end_completes_its_recordings() {
    for signal in ["TERM", "INT"] {
        let folder = Folder::new();
        let world = recorded(&folder);
        world.signal(signal);
        let ended = world.end(Duration::from_secs(20)).expect(0);
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
fn a_world_that_is_killed_leaves_what_it_had_written() {
    let folder = Folder::new();
    let mut world = recorded(&folder);
    // What is in the world at first is written 5 s of its time after: a tenth of a second.
    let written = || fs::read(folder.path().join("run.mcap")).ok().filter(|mcap| mcap.len() > 1000);
    until("the first chunk", Duration::from_secs(20), written);
    world.kill();
    let mcap = written().expect("a recording");
    assert!(mcap.starts_with(MAGIC) && !mcap.ends_with(MAGIC), "{} bytes", mcap.len());
    assert_eq!(fs::read_to_string(folder.path().join("paths.svg")).expect("made ready"), "");
}
