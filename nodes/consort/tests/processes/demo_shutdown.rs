//! The demo leaves no processes and no files, however it ends.

use crate::support::{Folder, LONG, Program, until};

/// Starts a demo and waits until its fleet has a coordinator and runs a mission.
fn under_way(folder: &Folder) -> Program {
    let mut demo = Program::start(folder, "demo", &["demo", "--json", "--speed", "1"]);
    until("the mission of the demo begins", LONG, || {
        assert!(!demo.has_ended(), "it has ended:\n{}", demo.stderr());
        demo.stdout().contains(r#""event":"task_began""#).then_some(())
    });
    assert!(folder.processes().len() > 8, "a process for each node: {:?}", folder.processes());
    demo
}

/// Starts a demo that keeps its fleet running, with these flags, too. Returns it with the address of a node.
pub(crate) fn keep_running(folder: &Folder, more: &[&str]) -> (Program, String) {
    let arguments = ["demo", "--json", "--no-kill", "--robots", "2", "--speed", "40", "--keep-running"];
    let demo = Program::start(folder, "demo", &[&arguments[..], more].concat());
    until("the demo keeps its fleet running", LONG, || {
        demo.stdout().contains(r#""event":"demo_keeps_running""#).then_some(())
    });
    let stdout = demo.stdout();
    let address = stdout.split_once("--connect ").and_then(|(_, rest)| rest.split('"').next()).expect("an address");
    (demo, address.to_owned())
}

#[test]
fn ctrl_c_ends_the_whole_fleet() {
    let folder = Folder::new();
    let demo = under_way(&folder);
    demo.signal("INT");
    let ended = demo.end(LONG).expect(130);
    assert!(ended.stderr.contains("interrupted"), "{}", ended.stderr);
    folder.await_no_process();
    assert_eq!(folder.temporary_files(), Vec::<String>::new());
}

#[test]
fn ctrl_c_before_the_fleet_has_met_ends_it_too() {
    let folder = Folder::new();
    let mut demo = Program::start(&folder, "demo", &["demo", "--json"]);
    until("a first child of the demo", LONG, || {
        assert!(!demo.has_ended(), "it has ended:\n{}", demo.stderr());
        folder.processes().iter().any(|(_, line)| line.contains(" --config ")).then_some(())
    });
    demo.signal("INT");
    demo.end(LONG).expect(130);
    folder.await_no_process();
    assert_eq!(folder.temporary_files(), Vec::<String>::new());
}

/// It takes missions of its domain, too, with people whom only the domain names.
#[test]
fn a_demo_that_keeps_running_ends_cleanly_at_sigterm() {
    let folder = Folder::new();
    let mission = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/ihtn/serve-meal.json");
    let run = |name: &str, arguments: &[&str]| Program::start(&folder, name, arguments).end(LONG).expect(0).stdout;
    let scaffold = ["domain", "scaffold", mission, "--person", "resident", "--object", "trolley"];
    let domain = folder.write("domain.yaml", &run("scaffold", &scaffold));
    let domain = domain.to_str().expect("UTF-8");
    let (demo, address) = keep_running(&folder, &["--domain", domain]);
    assert!(folder.processes().len() > 3, "{:?}", folder.processes());
    let submitted = run("submit", &["submit", mission, "--fleet", "demo", "--connect", &address, "--wait"]);
    assert!(submitted.contains("serve-meal-2 completed"), "{submitted}");
    demo.signal("TERM");
    demo.end(LONG).expect(0);
    folder.await_no_process();
    assert_eq!(folder.temporary_files(), Vec::<String>::new());
}

#[test]
fn nodes_end_by_themselves_when_the_demo_is_killed() {
    let folder = Folder::new();
    let mut demo = under_way(&folder);
    demo.kill();
    folder.await_no_process();
}
