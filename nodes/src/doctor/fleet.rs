//! What the fleet itself says, once it is reached.

use super::{DiagnosisTarget, Finding, Severity};
use crate::certs::unix_time;
use crate::client::Client;
use crate::exit::Failure;
use crate::node_runtime::build_runtime;
use bytes::Bytes;
use consort_protocol::keys::Key;
use serde_json::Value;
use std::time::Duration;

/// How long all nodes have to answer.
const LIMIT: Duration = Duration::from_secs(2);

/// A clock may differ so much and nothing is wrong: certificates and deadlines are counted in more.
const APART_MAX_MS: u64 = 2_000;

/// Asks the fleet how it is, and every node for its clock and version.
pub(super) fn check_fleet(patient: &DiagnosisTarget) -> Vec<Finding> {
    let about = format!("fleet {}", patient.fleet);
    let found = build_runtime().and_then(|runtime| runtime.block_on(ask(patient)));
    found.unwrap_or_else(|failure| {
        let says = failure.to_string().lines().next().unwrap_or_default().to_owned();
        vec![Finding::error(
            about,
            says,
            "mend the links first; then see whether as many voters are up as bootstrap_expect says",
        )]
    })
}

async fn ask(patient: &DiagnosisTarget) -> Result<Vec<Finding>, Failure> {
    let mut client = Client::open(&patient.client_flags).await?;
    let health = client.query_view(&Key::ViewHealth).await;
    let nodes = everybody(&client).await;
    client.close().await;
    let mut findings = vec![];
    let health = health?;
    let notes = health["findings"].as_array().cloned().unwrap_or_default();
    findings.extend(notes.iter().filter_map(|note| troubled(patient, note)));
    if findings.is_empty() {
        let coordinator = health["coordinator"].as_str().unwrap_or("nobody");
        findings.push(Finding::ok(
            format!("fleet {}", patient.fleet),
            format!("{coordinator} coordinates; nothing is the matter"),
        ));
    }
    findings.extend(nodes.iter().flat_map(node));
    Ok(findings)
}

/// What every node says of itself.
async fn everybody(client: &Client) -> Vec<Value> {
    let key = client.keys().any_seen_coordinator();
    let Ok(mut replies) = client.bus().query(&key, Bytes::new(), LIMIT).await else { return vec![] };
    let mut all = Vec::new();
    while let Ok(Some(reply)) = tokio::time::timeout(LIMIT, replies.recv()).await {
        all.extend(reply.payload.ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok()));
    }
    all.sort_by_key(|view| view["seen_by"].to_string());
    all
}

/// What the nearest node finds the matter.
fn troubled(patient: &DiagnosisTarget, note: &Value) -> Option<Finding> {
    let state = match note["level"].as_str()? {
        "warning" => Severity::Warning,
        "error" => Severity::Error,
        _ => return None,
    };
    let says = note["says"].as_str().unwrap_or_default();
    let advice = "`consort fleet` and `consort missions` show more";
    Some(Finding { state, ..Finding::warning(format!("fleet {}", patient.fleet), says, advice) })
}

/// A node's clock and version, beside ours.
fn node(seen: &Value) -> Vec<Finding> {
    let about = format!("node {}", seen["seen_by"].as_str().unwrap_or("?"));
    let own = u64::try_from(unix_time().as_millis()).unwrap_or(u64::MAX);
    let apart = seen["at_ms"].as_u64().map(|at| own.abs_diff(at));
    let version = seen["version"].as_str().unwrap_or("?");
    let clock = match apart {
        Some(apart) if apart > APART_MAX_MS => {
            let says = format!("its clock and this machine's are {:.1} s apart", apart as f64 / 1e3);
            let advice = "have both kept right (timedatectl set-ntp true): certificates and deadlines count on it";
            Finding::warning(&about, says, advice)
        }
        _ => Finding::ok(&about, "its clock agrees with this machine's"),
    };
    let version = match version == env!("CARGO_PKG_VERSION") {
        true => Finding::ok(&about, format!("version {version}, as here")),
        false => Finding::warning(
            &about,
            format!("version {version}, where this is {}", env!("CARGO_PKG_VERSION")),
            "nodes of neighbouring versions work together; upgrade the older ones, one at a time",
        ),
    };
    vec![clock, version]
}
