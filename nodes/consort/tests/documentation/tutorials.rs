//! Tutorials, each executed as written.

use super::page::{Page, repository};
use super::shell::{OUTPUT_MARKER, run_page, substitute_program};
use consort_nodes::cli;
use consort_skills::extensions::Extensions;
use consort_tests::behavior::add_steps;
use std::ffi::OsString;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

/// Programs that readers of tutorials write. They are next to the example files, where cargo builds
/// them.
#[path = "../../../../examples/look_around.rs"]
#[expect(dead_code, reason = "its `main` is for the program alone")]
mod look_around;

#[path = "../../../../examples/gas_leak.rs"]
#[expect(dead_code, reason = "its `main` is for the program alone")]
mod gas_leak;

#[path = "../../../../examples/rover.rs"]
#[expect(dead_code, reason = "its `main` is for the program alone")]
mod rover;

#[path = "../../../../examples/round_planner.rs"]
#[expect(dead_code, reason = "its `main` is for the program alone")]
mod round_planner;

fn tutorial(name: &str) -> Page {
    Page::open(Path::new(&format!("docs/tutorials/{name}.md")))
}

/// This is not a test by itself: another process runs this test as the program of a tutorial.
#[test]
fn it_runs_as_a_program() {
    let Some(name) = std::env::var_os("CONSORT_TUTORIAL") else { return };
    let args = std::env::var("CONSORT_TUTORIAL_ARGS").expect("it is given with the name");
    let args: Vec<String> = args.lines().map(str::to_owned).collect();
    std::io::stdout().write_all(OUTPUT_MARKER.as_bytes()).expect("the output is read");
    let succeeded = match (name.to_str(), &args[..]) {
        (Some("look_around"), args) => {
            let args = std::iter::once("consort").chain(args.iter().map(String::as_str)).map(OsString::from);
            cli::run_with(look_around::EXTENSIONS, args) == ExitCode::SUCCESS
        }
        (Some("lab"), args) => run_lab(Extensions::default(), args),
        (Some("look_around_lab"), args) => run_lab(look_around::EXTENSIONS, args),
        (Some("gas_leak"), args) => {
            add_steps(gas_leak::steps());
            run_lab(gas_leak::EXTENSIONS, args)
        }
        (Some("rover"), [file, robot, place]) => rover::adapt(file, robot, place).is_ok(),
        (Some("round_planner"), args) => round_planner::run(args).is_ok(),
        other => panic!("no tutorial has a program {other:?}"),
    };
    std::process::exit(i32::from(!succeeded));
}

fn run_lab(extensions: Extensions, args: &[String]) -> bool {
    let args = std::iter::once("consort-lab").chain(args.iter().map(String::as_str)).map(OsString::from);
    consort_lab::cli::run_with(extensions, args) == ExitCode::SUCCESS
}

/// Checks that a page contains the example that a test builds, and no other Rust code. Returns the
/// code of the page.
fn shows(page: &Page, example: &str) -> String {
    let code = std::fs::read_to_string(repository().join("examples").join(example)).expect("the example");
    let shown: Vec<&str> = page.blocks.iter().filter(|b| b.language == "rust").map(|b| b.text.as_str()).collect();
    assert!(shown == [code.as_str()], "{} does not show what examples/{example} is", page.path.display());
    code
}

#[test]
fn the_adapter_tutorial_works() {
    let page = tutorial("adapter");
    shows(&page, "rover.rs");
    run_page(&page, &[("cargo run --example rover --", |args| substitute_program("rover", args))]);
}

#[test]
fn the_planner_tutorial_works() {
    let page = tutorial("planner");
    shows(&page, "round_planner.rs");
    run_page(&page, &[("cargo run --example round_planner --", |args| substitute_program("round_planner", args))]);
}

#[test]
fn the_skill_tutorial_works() {
    let page = tutorial("skill");
    let code = shows(&page, "look_around.rs");
    assert!(code.lines().count() <= 50, "{} lines are not 50", code.lines().count());
    run_page(
        &page,
        &[
            ("cargo run --example look_around --", |args| substitute_program("look_around", args)),
            ("cargo run --example look_around_lab --", |args| substitute_program("look_around_lab", args)),
        ],
    );
}

#[test]
fn the_simulator_tutorial_works() {
    let page = tutorial("simulator");
    shows(&page, "gas_leak.rs");
    run_page(&page, &[("cargo run --example gas_leak --", |args| substitute_program("gas_leak", args))]);
}

#[test]
fn the_map_tutorial_works() {
    let folder = run_page(&tutorial("map"), &[]);
    assert!(std::fs::metadata(folder.join("ward.svg")).expect("the picture of the page").len() > 1000);
}

#[test]
fn the_ensemble_tutorial_works() {
    run_page(&tutorial("ensemble"), &[]);
}

#[test]
fn the_operator_tutorial_works() {
    run_page(&tutorial("operator"), &[]);
}

#[test]
fn the_operations_tutorial_works() {
    run_page(&Page::open(Path::new("docs/operations.md")), &[]);
}

#[test]
fn the_domain_tutorial_works() {
    let page = tutorial("domain");
    for name in ["rounds.yaml", "water_plant.xml", "driver.py"] {
        let shown = page.blocks.iter().find(|block| block.file.as_deref() == Some(name)).expect("a file of the page");
        let example = std::fs::read_to_string(repository().join("examples/plants").join(name)).expect("the example");
        assert!(shown.text == example, "{} does not show what examples/plants/{name} is", page.path.display());
    }
    run_page(&page, &[("consort-lab", |args| substitute_program("lab", args))]);
}

#[test]
fn the_mission_tutorial_works() {
    run_page(&tutorial("mission"), &[]);
}
