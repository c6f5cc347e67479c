//! What a node does, for whoever looks on from outside: in its log, and as spans for OpenTelemetry.
//!
//! Both are made of what the node tells on the event stream, and name a mission's trace by the same id: see [`ids`].

pub mod ids;
mod log;
#[cfg(feature = "otlp")]
mod otlp;
pub mod spans;

pub use log::EventLogger;

use consort_actors::cluster_membership::ClusterMembership;
use consort_actors::node::NodeSettings;
use consort_actors::observe::SharedObserver;
use consort_protocol::ids::ClusterId;
use std::sync::{Arc, OnceLock};

/// How long the last spans of a node that ends are waited for.
#[cfg(feature = "otlp")]
const FAREWELL: std::time::Duration = std::time::Duration::from_secs(2);

/// The cluster of a node that may not have started yet.
#[derive(Clone, Default)]
pub(crate) struct ClusterCell(Arc<OnceLock<ClusterMembership>>);

impl ClusterCell {
    fn cluster(&self) -> Option<ClusterId> {
        self.0.get().and_then(ClusterMembership::cluster)
    }
}

/// The log and the spans of one node.
pub struct Telemetry {
    membership: ClusterCell,
    #[cfg(feature = "otlp")]
    exporter: Option<otlp::Exporter>,
}

impl Telemetry {
    /// Of the node that `settings` make; spans go to the collector at `endpoint` (as `http://127.0.0.1:4318`) if one is named.
    /// Called within a tokio runtime. Returned beside it are those who must observe the node.
    ///
    /// # Errors
    /// Why spans cannot be sent there, in words.
    pub fn open(endpoint: Option<&str>, settings: &NodeSettings) -> Result<(Telemetry, Vec<SharedObserver>), String> {
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
            Some(_) => Err(format!(
                "{} was built without OpenTelemetry: build it with --features otlp, or leave out --otlp",
                settings.node
            )),
            None => Ok((Telemetry { membership }, std::mem::take(&mut observers))),
        }
    }

    /// From now on the cluster is known, once the node belongs to one.
    pub fn set_cluster(&self, allegiance: ClusterMembership) {
        // A node lives once: there is no second.
        let _ = self.membership.0.set(allegiance);
    }

    /// Sends what there still is, for a moment at most.
    pub async fn shut_down(self) {
        #[cfg(feature = "otlp")]
        if let Some(exporter) = self.exporter {
            let _ = tokio::time::timeout(FAREWELL, exporter.end()).await;
        }
    }
}
