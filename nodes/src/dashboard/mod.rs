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
//! It listens where it is told to. What is bound to loopback answers only to loopback's names, so that no page of another
//! site can read it by giving its own name this address; and requests that change something are taken from the page alone.

mod assets;
mod board;
mod csv;
mod desk;
mod guard;
mod routes;
mod watcher;

pub use board::{Board, FRAME};
pub(crate) use watcher::watch as follow;

use crate::address::Taken;
use crate::picture::{FloorPlan, Picture};
use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::task::JoinSet;

/// A dashboard that is being served. Dropping it ends it.
pub struct Dashboard {
    address: SocketAddr,
    tasks: JoinSet<()>,
}

impl Dashboard {
    /// Serves a fleet, as it is seen over `bus` at `node`. Called within a tokio runtime.
    pub fn open(address: Taken, bus: SharedBus, fleet: &FleetId, node: &str, plan: FloorPlan) -> Dashboard {
        let clock = Clock::real();
        let picture = Picture::new(fleet.to_string(), node, plan, clock.wall_ms());
        let board = Arc::new(Board::new(picture, clock));
        let desk = desk::Desk::new(Arc::clone(&bus), Keys::new(fleet), node);
        let mut dashboard = Dashboard::serve(address, Arc::clone(&board), Some(desk));
        watcher::watch(&mut dashboard.tasks, bus, Keys::new(fleet), board);
        dashboard
    }

    /// Serves a board that somebody else fills, and on which nothing can be asked for. Called within a tokio runtime.
    pub fn show(address: Taken, board: Arc<Board>) -> Dashboard {
        Dashboard::serve(address, board, None)
    }

    fn serve(taken: Taken, board: Arc<Board>, desk: Option<desk::Desk>) -> Dashboard {
        let (address, listener) = (taken.at(), taken.listener);
        let router = routes::router(Arc::clone(&board), desk, address);
        let mut tasks = JoinSet::new();
        tasks.spawn(async move {
            if let Err(problem) = axum::serve(listener, router).await {
                tracing::warn!(%problem, "the dashboard ended");
            }
        });
        tasks.spawn(async move { board.draw_for_ever().await });
        Dashboard { address, tasks }
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
