//! Observability of a node's actions: log lines, and spans for OpenTelemetry.
//!
//! Both are derived from the node's events, and use the same id for a mission's trace: see [`ids`].

pub mod ids;
mod log;
#[cfg(feature = "otlp")]
mod otlp;
#[cfg(any(feature = "otlp", test))]
mod spans;

pub(crate) use log::EventLogger;

use consort_bus::cluster_membership::ClusterMembership;
use consort_fleet::node::NodeSettings;
use consort_fleet::observe::SharedObserver;
use consort_protocol::ids::{ClusterId, NodeId};
use std::sync::{Arc, OnceLock};

/// Time limit for sending the last spans when a node ends.
#[cfg(feature = "otlp")]
const LAST_SPANS_LIMIT: std::time::Duration = std::time::Duration::from_secs(2);

/// The cluster of a node, empty until the node has started.
#[derive(Clone, Default)]
pub(crate) struct ClusterCell(Arc<OnceLock<ClusterMembership>>);

impl ClusterCell {
    fn cluster(&self) -> Option<ClusterId> {
        self.0.get().and_then(ClusterMembership::cluster)
    }
}

/// The log and the spans of a node.
pub struct Telemetry {
    membership: ClusterCell,
    #[cfg(feature = "otlp")]
    exporter: Option<otlp::Exporter>,
}

/// Spans cannot be sent. The node is not started.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// The program does not contain the exporter.
    #[error("{0} was built without OpenTelemetry: build it with --features otlp, or leave out --otlp")]
    NotBuilt(NodeId),
    /// The address of the collector is not usable.
    #[error("--otlp {endpoint}: {problem}; as http://127.0.0.1:4318")]
    Collector {
        /// The address.
        endpoint: String,
        /// The reason.
        problem: String,
    },
}

impl Telemetry {
    /// Creates the telemetry of the node with `settings`; spans go to the collector at `endpoint`
    /// (as `http://127.0.0.1:4318`), if given. Called within a tokio runtime. Also returns the
    /// observers to attach to the node.
    ///
    /// # Errors
    /// [`TelemetryError`] with the reason why spans cannot be sent there.
    pub fn open(
        endpoint: Option<&str>,
        settings: &NodeSettings,
    ) -> Result<(Telemetry, Vec<SharedObserver>), TelemetryError> {
        let membership = ClusterCell::default();
        let mut observers: Vec<SharedObserver> = vec![Arc::new(EventLogger(membership.clone()))];
        #[cfg(feature = "otlp")]
        {
            let exporter = endpoint.map(|at| otlp::Exporter::start(at, settings, membership.clone())).transpose()?;
            observers.extend(exporter.as_ref().map(otlp::Exporter::observer));
            Ok((Telemetry { membership, exporter }, observers))
        }
        #[cfg(not(feature = "otlp"))]
        match endpoint {
            Some(_) => Err(TelemetryError::NotBuilt(settings.node.clone())),
            None => Ok((Telemetry { membership }, std::mem::take(&mut observers))),
        }
    }

    /// Sets the node's cluster membership.
    pub(crate) fn set_cluster(&self, membership: ClusterMembership) {
        // A process runs a single node: there is no second call.
        let _ = self.membership.0.set(membership);
    }

    /// Sends the remaining spans, within a time limit.
    pub(crate) async fn shut_down(self) {
        #[cfg(feature = "otlp")]
        if let Some(exporter) = self.exporter {
            let _ = tokio::time::timeout(LAST_SPANS_LIMIT, exporter.end()).await;
        }
    }
}
