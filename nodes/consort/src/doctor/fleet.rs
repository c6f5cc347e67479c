//! Queries of the fleet, after it is reached.

use super::{DiagnosisTarget, Finding, Severity};
use crate::certs::unix_time;
use crate::client::{Client, read_answer};
use crate::exit::Failure;
use crate::node_runtime::build_runtime;
use bytes::Bytes;
use consort_protocol::keys::Key;
use consort_protocol::view::{HealthFinding, HealthLevel, HealthView, Provenance, WithProvenance};
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
    let WithProvenance::<HealthView> { provenance, content: health } = read_answer(&health?)?;
    findings.extend(health.findings.iter().filter_map(|note| finding_of(target, note)));
    if findings.is_empty() {
        let coordinator = provenance.coordinator.as_ref().map_or("none", |node| node.as_str());
        findings.push(Finding::ok(
            format!("fleet {}", target.fleet),
            format!("coordinator {coordinator}; no problems found"),
        ));
    }
    findings.extend(target.role.as_ref().and_then(|role| role.check_size(nodes.len())));
    findings.extend(nodes.iter().flat_map(node));
    Ok(findings)
}

/// Queries the clock and the version of every node.
async fn query_all_nodes(client: &Client) -> Vec<Provenance> {
    let key = client.keys().any_seen_coordinator();
    let Ok(mut replies) = client.bus().query(&key, Bytes::new(), LIMIT).await else { return vec![] };
    let mut all = Vec::new();
    while let Ok(Some(reply)) = tokio::time::timeout(LIMIT, replies.recv()).await {
        all.extend(reply.payload.ok().and_then(|bytes| serde_json::from_slice::<Provenance>(&bytes).ok()));
    }
    all.sort_by(|one, other| one.seen_by.cmp(&other.seen_by));
    all
}

/// Converts a health finding of the nearest node.
fn finding_of(target: &DiagnosisTarget, note: &HealthFinding) -> Option<Finding> {
    let state = match note.level {
        HealthLevel::Warning => Severity::Warning,
        HealthLevel::Error => Severity::Error,
        HealthLevel::Ok => return None,
    };
    let advice = "`consort fleet` and `consort missions` show more";
    Some(Finding { state, ..Finding::warning(format!("fleet {}", target.fleet), &note.text, advice) })
}

/// Compares a node's clock and version with this machine's.
fn node(Provenance { seen_by, at_ms, version, .. }: &Provenance) -> Vec<Finding> {
    let about = format!("node {seen_by}");
    let own = u64::try_from(unix_time().as_millis()).unwrap_or(u64::MAX);
    let clock = match own.abs_diff(*at_ms) {
        difference if difference > CLOCK_DIFFERENCE_MAX_MS => {
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
