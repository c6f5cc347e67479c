//! Tutorials, each played as it is written.

use super::page::{Page, repository};
use super::shell::{MARK, in_place_of, play};
use consort_nodes::cli;
use std::ffi::OsString;
use std::io::Write;
use std::path::Path;

/// Programs that tutorials have their readers write. They stand beside the example files, where cargo builds them.
#[path = "../../examples/look_around.rs"]
#[expect(dead_code, reason = "its `main` is for the program alone")]
mod look_around;

fn tutorial(name: &str) -> Page {
    Page::open(Path::new(&format!("nodes/docs/tutorials/{name}.md")))
}

/// Not a test by itself: another process runs this very one, and is a tutorial's program then.
#[test]
fn as_a_program() {
    let Some(name) = std::env::var_os("CONSORT_TUTORIAL") else { return };
    let args = std::env::var("CONSORT_TUTORIAL_ARGS").expect("it is given with the name");
    let kit = match name.to_str() {
        Some("look_around") => look_around::KIT,
        other => panic!("no tutorial has a program {other:?}"),
    };
    let args = std::iter::once("consort").chain(args.lines()).map(OsString::from);
    std::io::stdout().write_all(MARK.as_bytes()).expect("somebody reads what it prints");
    let code = cli::run_with(kit, args);
    std::process::exit(i32::from(code != std::process::ExitCode::SUCCESS));
}

#[test]
fn a_skill_of_your_own() {
    let page = tutorial("skill");
    let code = std::fs::read_to_string(repository().join("nodes/examples/look_around.rs")).expect("the example");
    let shown: Vec<&str> = page.blocks.iter().filter(|b| b.language == "rust").map(|b| b.text.as_str()).collect();
    assert_eq!(shown, [code.as_str()], "the page shows what nodes/examples/look_around.rs is");
    assert!(code.lines().count() <= 50, "{} lines are not 50", code.lines().count());
    play(&page, &[("cargo run --example look_around --", |args| in_place_of("look_around", args))]);
}

#[test]
fn a_map_of_your_own() {
    let folder = play(&tutorial("map"), &[]);
    assert!(std::fs::metadata(folder.join("ward.png")).expect("the picture that the page draws").len() > 1000);
}

#[test]
fn an_ensemble_of_your_own() {
    play(&tutorial("ensemble"), &[]);
}

#[test]
fn a_mission_of_your_own() {
    play(&tutorial("mission"), &[]);
}
