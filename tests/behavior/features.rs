//! The shipped features, as `consort-lab test` runs them.

use consort_skills::extensions::Extensions;
use consort_tests::behavior::{Features, RunOptions, ScenarioFilter, run};
use std::path::PathBuf;

/// A failed scenario is reported with the actual state and the events before it.
#[test]
fn all_features_pass() {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/features"));
    let features = Features::read(&[folder], &ScenarioFilter::default()).unwrap_or_else(|bad| panic!("{bad}"));
    let (jobs, scenarios) = (std::thread::available_parallelism().map_or(1, usize::from), features.scenarios());
    let mut report = vec![];
    let outcome = run(
        features,
        &RunOptions { extensions: Extensions::default(), seed: 1, jobs, steps: false, colours: false },
        &mut report,
    );
    let report = String::from_utf8(report).expect("UTF-8 output");
    assert!(outcome.failed.is_empty(), "{report}");
    assert_eq!(outcome.passed, scenarios, "{report}");
}
