//! Queries of the fleet, after it is reached.

use super::{DiagnosisTarget, Finding, Severity};
use crate::certs::unix_time;
use crate::client::Client;
use crate::exit::Failure;
use crate::node_runtime::build_runtime;
use bytes::Bytes;
use consort_protocol::keys::Key;
use serde_json::Value;
use std::time::Duration;

/// Time limit for the replies of all nodes.
const LIMIT: Duration = Duration::from_secs(2);

/// Tolerated clock difference: certificates and deadlines are less precise.
const CLOCK_DIFFERENCE_MAX_MS: u64 = 2_000;

/// Queries the health of the fleet, and the clock and version of every node.
pub(super) fn check_fleet(target: &DiagnosisTarget) -> Vec<Finding> {
    let about = format!("fleet {}", target.fleet);
    let found = build_runtime().and_then(|runtime| runtime.block_on(query(target)));
    found.unwrap_or_else(|failure| {
        let text = failure.to_string().lines().next().unwrap_or_default().to_owned();
        vec![Finding::error(about, text, "repair the links first; then check that bootstrap_expect voters are running")]
    })
}

async fn query(target: &DiagnosisTarget) -> Result<Vec<Finding>, Failure> {
    let mut client = Client::open(&target.client_flags).await?;
    let health = client.query_view(&Key::ViewHealth).await;
    let nodes = query_all_nodes(&client).await;
    client.close().await;
    let mut findings = vec![];
    let health = health?;
    let notes = health["findings"].as_array().cloned().unwrap_or_default();
    findings.extend(notes.iter().filter_map(|note| finding_of(target, note)));
    if findings.is_empty() {
        let coordinator = health["coordinator"].as_str().unwrap_or("none");
        findings.push(Finding::ok(
            format!("fleet {}", target.fleet),
            format!("coordinator {coordinator}; no problems found"),
        ));
    }
    findings.extend(nodes.iter().flat_map(node));
    Ok(findings)
}

/// Queries the status of every node.
async fn query_all_nodes(client: &Client) -> Vec<Value> {
    let key = client.keys().any_seen_coordinator();
    let Ok(mut replies) = client.bus().query(&key, Bytes::new(), LIMIT).await else { return vec![] };
    let mut all = Vec::new();
    while let Ok(Some(reply)) = tokio::time::timeout(LIMIT, replies.recv()).await {
        all.extend(reply.payload.ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok()));
    }
    all.sort_by_key(|view| view["seen_by"].to_string());
    all
}

/// Converts a health finding of the nearest node.
fn finding_of(target: &DiagnosisTarget, note: &Value) -> Option<Finding> {
    let state = match note["level"].as_str()? {
        "warning" => Severity::Warning,
        "error" => Severity::Error,
        _ => return None,
    };
    let text = note["text"].as_str().unwrap_or_default();
    let advice = "`consort fleet` and `consort missions` show more";
    Some(Finding { state, ..Finding::warning(format!("fleet {}", target.fleet), text, advice) })
}

/// Compares a node's clock and version with this machine's.
fn node(seen: &Value) -> Vec<Finding> {
    let about = format!("node {}", seen["seen_by"].as_str().unwrap_or("?"));
    let own = u64::try_from(unix_time().as_millis()).unwrap_or(u64::MAX);
    let difference = seen["at_ms"].as_u64().map(|at| own.abs_diff(at));
    let version = seen["version"].as_str().unwrap_or("?");
    let clock = match difference {
        Some(difference) if difference > CLOCK_DIFFERENCE_MAX_MS => {
            let text = format!("its clock and this machine's differ by {:.1} s", difference as f64 / 1e3);
            let advice = "synchronise both (timedatectl set-ntp true): certificates and deadlines depend on it";
            Finding::warning(&about, text, advice)
        }
        _ => Finding::ok(&about, "its clock agrees with this machine's"),
    };
    let version = match version == env!("CARGO_PKG_VERSION") {
        true => Finding::ok(&about, format!("version {version}, as here")),
        false => Finding::warning(
            &about,
            format!("version {version}, and this is {}", env!("CARGO_PKG_VERSION")),
            "nodes of neighbouring versions work together; upgrade the older nodes individually",
        ),
    };
    vec![clock, version]
}
