//! The dashboard: a page that any node serves, with the fleet as that node knows it.
//!
//! ```text
//!  bus ──▶ Watcher ──▶ Board (a Picture) ──▶ frames, five a second ──▶ /ws: first the whole, then what has changed
//!                        │                                             /api/picture, /api/events, /api/history.csv
//!  bus ◀── Desk ◀────────┴──────────────────────────────────────────── POST /api/missions: submit, cancel, rescued
//! ```
//!
//! A frame replaces the one before it, whether or not everybody has seen that: a slow client misses frames, and then gets
//! a whole picture. Nothing is queued for anybody.
//!
//! A [recording](crate::recording) is shown in the same way, by a projector in place of the watcher and the desk: all who look see
//! the same instant of it, and any of them may choose another (`POST /api/replay`).
//!
//! In a closed fleet it takes a [token](crate::admission) to be let in, and the scope of the token says what for.
//!
//! It listens where it is told to. What is bound to loopback answers only to loopback's names, so that no page of another
//! site can read it by giving its own name this address; and requests that change something are taken from the page alone.

mod assets;
mod csv;
mod forwarder;
mod frame_publisher;
mod json;
mod origin_check;
mod replay_server;
mod routes;
mod session;
mod websocket;

pub use frame_publisher::{FRAME, FramePublisher};

use crate::address::BoundAddress;
use crate::admission::Admission;
use crate::fleet_model::{FleetModel, FloorPlan};
use crate::recording::{Player, RecordingReader};
use crate::subscriber;
use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::task::JoinSet;

/// What stands behind a board.
#[derive(Clone)]
enum DashboardSource {
    /// A fleet, which can be asked for something.
    Fleet(Arc<forwarder::RequestForwarder>),
    /// A recording, in which one can go to and fro.
    Recording(Arc<replay_server::ReplayServer>),
    /// Whoever fills the board.
    ViewOnly,
}

/// A dashboard that is being served. Dropping it ends it.
pub struct Dashboard {
    address: SocketAddr,
    tasks: JoinSet<()>,
}

impl Dashboard {
    /// Serves a fleet to those who are admitted, as it is seen over `bus` at `node`. Called within a tokio runtime.
    pub fn open(
        address: BoundAddress,
        admission: Admission,
        bus: SharedBus,
        fleet: &FleetId,
        node: &str,
        plan: FloorPlan,
    ) -> Dashboard {
        let clock = Clock::real();
        let picture = FleetModel::new(fleet.to_string(), node, plan, clock.wall_ms());
        let board = Arc::new(FramePublisher::new(picture, clock));
        let desk = forwarder::RequestForwarder::new(Arc::clone(&bus), Keys::new(fleet), node);
        let mut dashboard =
            Dashboard::serve(address, Arc::clone(&board), DashboardSource::Fleet(Arc::new(desk)), admission);
        dashboard.draw(Arc::clone(&board));
        subscriber::subscribe_fleet(&mut dashboard.tasks, bus, Keys::new(fleet), board);
        dashboard
    }

    /// Serves a recording, as a player plays it. Called within a tokio runtime.
    pub fn replay(address: BoundAddress, reel: RecordingReader, player: Player) -> Dashboard {
        let board = Arc::new(FramePublisher::new(reel.initial_model(), Clock::real()));
        let projector = Arc::new(replay_server::ReplayServer::new(reel, player, Arc::clone(&board)));
        let served = DashboardSource::Recording(Arc::clone(&projector));
        let mut dashboard = Dashboard::serve(address, board, served, Admission::open());
        dashboard.tasks.spawn(async move { projector.play_forever().await });
        dashboard
    }

    /// Serves a board that somebody else fills, and on which nothing can be asked for. Called within a tokio runtime.
    pub fn serve_view_only(address: BoundAddress, board: Arc<FramePublisher>) -> Dashboard {
        let mut dashboard = Dashboard::serve(address, Arc::clone(&board), DashboardSource::ViewOnly, Admission::open());
        dashboard.draw(board);
        dashboard
    }

    fn serve(
        taken: BoundAddress,
        board: Arc<FramePublisher>,
        served: DashboardSource,
        admission: Admission,
    ) -> Dashboard {
        let (address, listener) = (taken.local_addr(), taken.with_connection_limit());
        let router = routes::router(board, served, admission, address);
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            if let Err(problem) = axum::serve(listener, router).await {
                tracing::warn!(%problem, "the dashboard ended");
            }
        });
        Dashboard { address, tasks }
    }

    /// Has a board drawn that changes by itself.
    fn draw(&mut self, board: Arc<FramePublisher>) {
        self.tasks.spawn(async move { board.publish_forever().await });
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where it is, for a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}
