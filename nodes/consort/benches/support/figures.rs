//! Shared functions of all benchmarks with an own measurement: figures as a line of JSON.

use serde_json::{Value, json};
use std::future::Future;
use std::io::Write;
use std::process::ExitCode;
use tokio::time::Instant;

/// Reason of a missing figure.
pub(crate) type BenchError = String;

/// Returns the milliseconds between two instants.
pub(crate) fn ms(from: Instant, to: Instant) -> f64 {
    to.saturating_duration_since(from).as_secs_f64() * 1000.0
}

/// Returns median and tail of durations in milliseconds, by nearest rank.
pub(crate) fn figures(mut all: Vec<f64>) -> Value {
    all.sort_by(f64::total_cmp);
    let rank = |share: f64| {
        let rank = (all.len() as f64 * share).ceil().max(1.0) as usize;
        all.get(rank - 1).map(|ms| (ms * 100.0).round() / 100.0)
    };
    json!({
        "n": all.len(), "min": rank(0.0), "p50": rank(0.5), "p95": rank(0.95), "p99": rank(0.99), "p999": rank(0.999),
        "max": rank(1.0),
    })
}

/// Runs a benchmark and prints its figures and the load of the machine as a line of JSON.
pub(crate) fn main(name: &str, measure: impl Future<Output = Result<Value, BenchError>>) -> ExitCode {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("the runtime starts");
    let result = runtime.block_on(measure);
    let load = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let line = match &result {
        Ok(figures) => json!({
            "bench": name, "cores": cores, "load_1min": load.split(' ').next(), "ms": figures,
        }),
        Err(error) => json!({ "bench": name, "error": error }),
    };
    // A closed standard output is not an error.
    let _ = writeln!(std::io::stdout(), "{line}");
    runtime.shutdown_background();
    if result.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
