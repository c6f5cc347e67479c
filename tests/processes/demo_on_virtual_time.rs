//! `consort demo --virtual`: one seed, one run.

use crate::support::{Ended, Folder, Program};
use std::time::Duration;

fn play(folder: &Folder, name: &str, arguments: &[&str]) -> Ended {
    let all: Vec<&str> = ["demo", "--virtual"].into_iter().chain(arguments.iter().copied()).collect();
    Program::start(folder, name, &all).end(Duration::from_secs(120)).expect(0)
}

#[test]
fn one_seed_gives_one_run_to_the_byte_and_another_seed_another() {
    let folder = Folder::new();
    let [once, again] = ["once", "again"].map(|name| play(&folder, name, &["--seed", "3"]));
    assert!(once.stdout == again.stdout, "--- once\n{}\n--- again\n{}", once.stdout, again.stdout);
    assert!(once.stdout.contains("KILL"), "{}", once.stdout);
    assert!(once.stdout.contains("TAKEOVER"), "{}", once.stdout);
    assert!(once.stdout.contains("1 of 1 missions completed; 1 of 1 samples in the laboratory"), "{}", once.stdout);
    assert_ne!(play(&folder, "other", &["--seed", "4"]).stdout, once.stdout);
    assert_eq!(folder.temporary_files(), Vec::<String>::new(), "it needs no files");
}

#[test]
fn without_a_kill_and_with_few_or_many_robots_every_sample_arrives() {
    let folder = Folder::new();
    let quiet = play(&folder, "no-kill", &["--no-kill"]).stdout;
    assert!(!quiet.contains("KILL") && !quiet.contains("TAKEOVER"), "{quiet}");
    let lone = play(&folder, "lone", &["--robots", "1"]).stdout;
    assert!(lone.contains("1 of 1 missions completed; 1 of 1 samples in the laboratory"), "{lone}");
    let many = play(&folder, "many", &["--robots", "12", "--missions", "4"]).stdout;
    assert!(many.contains("4 of 4 missions completed; 4 of 4 samples in the laboratory"), "{many}");
    let in_json = play(&folder, "json", &["--robots", "3", "--json"]).json_lines();
    assert_eq!(in_json.last().expect("a summary")["delivered"], 1);
}

#[test]
fn the_demo_can_be_looked_at_afterwards_and_is_the_same_for_it() {
    let folder = Folder::new();
    let plain = play(&folder, "plain", &["--seed", "3"]);
    let [once, again] = ["once", "again"].map(|name| {
        let [mcap, svg] = ["mcap", "svg"].map(|end| format!("{name}.{end}"));
        let played = play(&folder, name, &["--seed", "3", "--record", &mcap, "--svg", &svg]);
        assert!(played.stdout == plain.stdout, "--- plain\n{}\n--- recorded\n{}", plain.stdout, played.stdout);
        assert!(played.stderr.contains(" m driven by "), "{}", played.stderr);
        [mcap, svg].map(|file| std::fs::read(folder.path().join(file)).expect("a file"))
    });
    assert!(once == again, "one seed, one recording");
    assert!(once[0].ends_with(b"\x89MCAP0\r\n"));
    let picture = String::from_utf8(once[1].clone()).expect("text");
    assert!(picture.contains("class=\"driven\"") && picture.contains("Laboratory"), "{picture:.200}");
    let refused = Program::start(&folder, "refused", &["demo", "--record", "run.mcap"]);
    let refused = refused.end(Duration::from_secs(20)).expect(2);
    assert!(refused.stderr.contains("--record and --svg go with --virtual"), "{}", refused.stderr);
}
