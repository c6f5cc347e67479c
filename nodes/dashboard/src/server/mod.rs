//! The dashboard: a page served by any node, with the fleet as seen by that node.
//!
//! ```text
//!  bus ──▶ subscriber ──▶ FramePublisher (a FleetModel) ──▶ frames, five a second ──▶ /ws: first the full model, then changes
//!                           │                                             /api/fleet, /api/events, /api/history.csv
//!  bus ◀── RequestForwarder ◀┴──────────────────────────────────────────── POST /api/missions: submit, cancel, resolve
//! ```
//!
//! A frame replaces the frame before it, even if not all clients have received that: a slow client
//! misses frames, and then gets the full model. Nothing is queued for clients.
//!
//! A [recording](crate::recording) is shown in the same way, by a replay server in place of the
//! subscriber and the forwarder: all clients see the same instant, and each of them may seek
//! (`POST /api/replay`).
//!
//! In a closed fleet clients need a [token](crate::admission), and its scope decides the allowed
//! requests.
//!
//! The server listens on the configured address. A server on loopback answers only to loopback's
//! names, so that no page of another site can read it by DNS rebinding. Requests that change
//! something are accepted from the page alone.

mod assets;
mod audit;
mod csv;
mod forwarder;
mod frame_publisher;
mod json;
mod mission_file;
mod origin_check;
mod replay_server;
mod routes;
mod session;
mod state;
mod websocket;

pub use frame_publisher::{FRAME, FramePublisher};

use crate::address::BoundAddress;
use crate::admission::Admission;
use crate::fleet_model::{FleetModel, FloorPlan};
use crate::recording::{Player, RecordingReader};
use crate::subscriber;
use consort_bus::SharedBus;
use consort_bus::clock::Clock;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use consort_skills::missions::NamedMissions;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::task::JoinSet;

/// Source of the published model.
#[derive(Clone)]
enum DashboardSource {
    /// A fleet that accepts requests.
    Fleet(Arc<forwarder::RequestForwarder>),
    /// A recording that can be seeked.
    Recording(Arc<replay_server::ReplayServer>),
    /// A model filled by other code; requests are not possible.
    ViewOnly,
}

/// Contents of a fleet's pages that come from its files.
pub struct FleetContents {
    /// The floor plan.
    pub plan: FloorPlan,
    /// Addresses of the fleet's dashboards, for the page for people.
    pub dashboards: Vec<String>,
    /// The missions that a request may name.
    pub missions: Arc<NamedMissions>,
}

/// A dashboard that is being served. Dropping it ends it.
pub struct Dashboard {
    address: SocketAddr,
    tasks: JoinSet<()>,
}

impl Dashboard {
    /// Serves a fleet to admitted clients, as seen over `bus` at `node`. Called within a tokio runtime.
    pub fn open(
        address: BoundAddress,
        admission: Admission,
        bus: SharedBus,
        fleet: &FleetId,
        node: &str,
        contents: FleetContents,
    ) -> Dashboard {
        let FleetContents { plan, dashboards, missions } = contents;
        let clock = Clock::real();
        let model = FleetModel::new(fleet.to_string(), node, plan, clock.wall_ms());
        let publisher = Arc::new(FramePublisher::new(model, clock));
        let forwarder = forwarder::RequestForwarder::new(Arc::clone(&bus), Keys::new(fleet), node, dashboards);
        let source = DashboardSource::Fleet(Arc::new(forwarder));
        let mut dashboard = Dashboard::serve(address, Arc::clone(&publisher), source, admission, missions);
        dashboard.draw(Arc::clone(&publisher));
        subscriber::subscribe_fleet(&mut dashboard.tasks, bus, Keys::new(fleet), publisher);
        dashboard
    }

    /// Serves a recording at a player's position. Called within a tokio runtime.
    pub fn replay(address: BoundAddress, reader: RecordingReader, player: Player) -> Dashboard {
        let publisher = Arc::new(FramePublisher::new(reader.initial_model(), Clock::real()));
        let server = Arc::new(replay_server::ReplayServer::new(reader, player, Arc::clone(&publisher)));
        let source = DashboardSource::Recording(Arc::clone(&server));
        let mut dashboard = Dashboard::serve(address, publisher, source, Admission::open(), Arc::default());
        dashboard.tasks.spawn(async move { server.play_forever().await });
        dashboard
    }

    /// Serves a model that other code fills; requests are not possible. Called within a tokio
    /// runtime.
    pub fn serve_view_only(address: BoundAddress, publisher: Arc<FramePublisher>) -> Dashboard {
        let source = DashboardSource::ViewOnly;
        let mut dashboard =
            Dashboard::serve(address, Arc::clone(&publisher), source, Admission::open(), Arc::default());
        dashboard.draw(publisher);
        dashboard
    }

    fn serve(
        bound: BoundAddress,
        publisher: Arc<FramePublisher>,
        source: DashboardSource,
        admission: Admission,
        missions: Arc<NamedMissions>,
    ) -> Dashboard {
        let (address, listener) = (bound.local_addr(), bound.with_connection_limit());
        let router = routes::router(publisher, source, admission, missions, address);
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            if let Err(problem) = axum::serve(listener, router).await {
                tracing::warn!(%problem, "the dashboard ended");
            }
        });
        Dashboard { address, tasks }
    }

    /// Starts rendering frames of a model.
    fn draw(&mut self, publisher: Arc<FramePublisher>) {
        self.tasks.spawn(async move { publisher.publish_forever().await });
    }

    /// Returns the address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the URL for a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}
