//! The conformance check of drivers: named cases, each with a process or a connection of its own.
//!
//! A case talks to the driver as a node does, also with wrong and untimely messages, and checks
//! what the driver returns. The goals of the cases are those of the `example` of an offered action.

mod cases;
mod probe;

pub use cases::{CASES, Case};

use crate::contract::Contract;
use crate::endpoint::DriverEndpoint;
use consort_protocol::ids::ActionName;
use consort_skills::actions::JsonObject;
use futures::StreamExt as _;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// A driver that is checked.
#[derive(Debug, Clone)]
pub struct Trial {
    /// Its command line, or the socket on which it listens.
    pub endpoint: DriverEndpoint,
    /// The actions that it may offer.
    pub contract: Contract,
    /// The goal of the cases, instead of the example of an offered action.
    pub goal: Option<SampleGoal>,
    /// The ids of the goals are greater than this number. A robot may remember the goals of an earlier check.
    pub goals_after: u64,
}

/// Number of goal ids for each case.
const GOALS_PER_CASE: u64 = 16;

/// Goal with which a driver is tried. It takes about 2 s.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleGoal {
    /// The action.
    pub action: ActionName,
    /// Its parameters.
    #[serde(default)]
    pub parameters: JsonObject,
}

/// Report of a case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaseReport {
    /// Name of the case.
    pub case: &'static str,
    /// True if the driver behaves as specified, or if the case is skipped.
    pub ok: bool,
    /// True if the case needs a process and the driver listens on a socket.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub skipped: bool,
    /// What the driver did instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Duration in milliseconds.
    pub took_ms: u64,
}

/// A driver does not behave as specified in a case.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CaseFailure(pub(crate) String);

/// Runs cases, at most `jobs` at the same time, and passes each report on in the order of the
/// cases.
pub async fn run(trial: &Trial, cases: &[&Case], jobs: usize, mut report: impl FnMut(CaseReport)) {
    let runs = cases.iter().zip(0u64..).map(|(case, number)| async move {
        let started = Instant::now();
        if case.needs_process() && matches!(trial.endpoint, DriverEndpoint::Socket(_)) {
            return CaseReport { case: case.name, ok: true, skipped: true, problem: None, took_ms: 0 };
        }
        let trial = Trial { goals_after: trial.goals_after + number * GOALS_PER_CASE, ..trial.clone() };
        let problem = (case.run)(&trial).await.err().map(|failure| failure.to_string());
        let took_ms = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        CaseReport { case: case.name, ok: problem.is_none(), skipped: false, problem, took_ms }
    });
    let mut reports = futures::stream::iter(runs.collect::<Vec<_>>()).buffered(jobs.max(1));
    while let Some(next) = reports.next().await {
        report(next);
    }
}
