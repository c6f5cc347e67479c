//! The features that come with the program, as `consort test` plays them.

use consort_tests::behavior::{Features, RunOptions, ScenarioFilter, run};
use std::path::PathBuf;

/// Those that fail are told with what was found and what had happened.
#[test]
fn all_features_pass() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/features"));
    let features = Features::read(&[folder], &ScenarioFilter::default()).unwrap_or_else(|bad| panic!("{bad}"));
    let (jobs, scenarios) = (std::thread::available_parallelism().map_or(1, usize::from), features.scenarios());
    let mut told = vec![];
    let outcome = run(features, &RunOptions { seed: 1, jobs, steps: false, colours: false }, &mut told);
    let told = String::from_utf8(told).expect("our own words");
    assert!(outcome.failed.is_empty(), "{told}");
    assert_eq!(outcome.passed, scenarios, "{told}");
}
