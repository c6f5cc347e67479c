//! `consort demo --virtual`: a seed determines a run.

use crate::support::{Ended, Folder, LONG, Program};

fn play(folder: &Folder, name: &str, arguments: &[&str]) -> Ended {
    let all: Vec<&str> = ["demo", "--virtual"].into_iter().chain(arguments.iter().copied()).collect();
    Program::start(folder, name, &all).end(LONG).expect(0)
}

#[test]
fn each_seed_determines_its_own_run_to_the_byte() {
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
fn every_sample_arrives_with_any_number_of_robots() {
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
fn recording_the_demo_does_not_change_its_run() {
    let folder = Folder::new();
    let plain = play(&folder, "plain", &["--seed", "3"]);
    let [once, again] = ["once", "again"].map(|name| {
        let [mcap, svg] = ["mcap", "svg"].map(|end| format!("{name}.{end}"));
        let played = play(&folder, name, &["--seed", "3", "--record", &mcap, "--svg", &svg]);
        assert!(played.stdout == plain.stdout, "--- plain\n{}\n--- recorded\n{}", plain.stdout, played.stdout);
        assert!(played.stderr.contains(" m driven by "), "{}", played.stderr);
        [mcap, svg].map(|file| std::fs::read(folder.path().join(file)).expect("a file"))
    });
    assert!(once == again, "a seed determines the recording");
    assert!(once[0].ends_with(b"\x89MCAP0\r\n"));
    let picture = String::from_utf8(once[1].clone()).expect("text");
    assert!(picture.contains("class=\"trail-line\"") && picture.contains("Laboratory"), "{picture:.200}");
    let refused = Program::start(&folder, "refused", &["demo", "--record", "run.mcap"]);
    let refused = refused.end(LONG).expect(2);
    assert!(refused.stderr.contains("--record and --svg go with --virtual"), "{}", refused.stderr);
}
