//! Duration of the estimate of a task of a domain file, whose expressions in CEL were compiled before.
//!
//! ```text
//! cargo bench -p consort-skills --bench estimate
//! ```
//!
//! The limit is 2 µs for an estimate. `constant` is a number and needs no CEL.

use consort_protocol::mission::TaskSpec;
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext};
use consort_skills::domain_file::DomainFile;
use consort_skills::environment::Environment;
use consort_skills::extensions::Extensions;
use criterion::{Criterion, criterion_group, criterion_main};
use std::collections::BTreeMap;
use std::hint::black_box;

/// Estimates, by the name of their case.
const CASES: [(&str, &str); 4] = [
    ("constant", "8.0"),
    ("parameter", "20.0 + 8.0 * litres"),
    ("condition", "litres > 2.0 ? 20.0 + 8.0 * litres : 30.0 / speed"),
    ("attribute", "litres / attributes.litres_per_s"),
];

fn estimates(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("estimate");
    for (name, time_s) in CASES {
        let task = serde_json::json!({
            "parameters": { "litres": { "type": "number", "minimum": 0, "maximum": 5 } },
            "action": "water", "estimate": { "time_s": time_s },
        });
        let action =
            serde_json::json!({ "parameters": { "litres": { "type": "number", "minimum": 0, "maximum": 5 } } });
        let form = serde_json::json!({ "domain": "bench", "actions": { "water": action }, "tasks": { "water": task } });
        let form = serde_json::from_value(form).expect("a domain");
        let domain = DomainFile::check(form, &BTreeMap::new(), &[]).unwrap_or_else(|problems| panic!("{problems:?}"));
        let extensions = Extensions::NONE.with_domain("bench.yaml", domain);
        let estimator = extensions.descriptors(DescriptorRegistry::new()).resolve(Environment::new());
        let estimator = estimator.expect("nothing is missing");
        let mut task = TaskSpec::of("water".parse().expect("a slug"), vec!["r1".parse().expect("a slug")]);
        task.parameters.insert("litres".to_owned(), "2.5".to_owned());
        let speed = MetresPerSecond::new(0.5).expect("a speed");
        let discharge = SharePerSecond::new(0.001).expect("a rate");
        let context = EstimateContext {
            attributes: serde_json::from_value(serde_json::json!({ "litres_per_s": 0.5 })).expect("attributes"),
            ..EstimateContext::at("Dock".parse().expect("a place"), speed, discharge)
        };
        group.bench_function(name, |bencher| {
            bencher.iter(|| estimator.estimate(black_box(&task), black_box(&context)).expect("an estimate"));
        });
    }
    group.finish();
}

criterion_group!(benches, estimates);
criterion_main!(benches);
