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
mod board;
mod csv;
mod desk;
mod follow;
mod guard;
mod json;
mod projector;
mod routes;
mod session;

pub use board::{Board, FRAME};

use crate::address::Taken;
use crate::admission::Admission;
use crate::picture::{FloorPlan, Picture};
use crate::recording::{Player, Reel};
use crate::watcher;
use consort_actors::bus::SharedBus;
use consort_actors::clock::Clock;
use consort_protocol::ids::FleetId;
use consort_protocol::keys::Keys;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::task::JoinSet;

/// What stands behind a board.
#[derive(Clone)]
enum Served {
    /// A fleet, which can be asked for something.
    Fleet(Arc<desk::Desk>),
    /// A recording, in which one can go to and fro.
    Recording(Arc<projector::Projector>),
    /// Whoever fills the board.
    Board,
}

/// A dashboard that is being served. Dropping it ends it.
pub struct Dashboard {
    address: SocketAddr,
    tasks: JoinSet<()>,
}

impl Dashboard {
    /// Serves a fleet to those who are admitted, as it is seen over `bus` at `node`. Called within a tokio runtime.
    pub fn open(
        address: Taken,
        admission: Admission,
        bus: SharedBus,
        fleet: &FleetId,
        node: &str,
        plan: FloorPlan,
    ) -> Dashboard {
        let clock = Clock::real();
        let picture = Picture::new(fleet.to_string(), node, plan, clock.wall_ms());
        let board = Arc::new(Board::new(picture, clock));
        let desk = desk::Desk::new(Arc::clone(&bus), Keys::new(fleet), node);
        let mut dashboard = Dashboard::serve(address, Arc::clone(&board), Served::Fleet(Arc::new(desk)), admission);
        dashboard.draw(Arc::clone(&board));
        watcher::follow(&mut dashboard.tasks, bus, Keys::new(fleet), board);
        dashboard
    }

    /// Serves a recording, as a player plays it. Called within a tokio runtime.
    pub fn replay(address: Taken, reel: Reel, player: Player) -> Dashboard {
        let board = Arc::new(Board::new(reel.beginning(), Clock::real()));
        let projector = Arc::new(projector::Projector::new(reel, player, Arc::clone(&board)));
        let served = Served::Recording(Arc::clone(&projector));
        let mut dashboard = Dashboard::serve(address, board, served, Admission::open());
        dashboard.tasks.spawn(async move { projector.play_for_ever().await });
        dashboard
    }

    /// Serves a board that somebody else fills, and on which nothing can be asked for. Called within a tokio runtime.
    pub fn show(address: Taken, board: Arc<Board>) -> Dashboard {
        let mut dashboard = Dashboard::serve(address, Arc::clone(&board), Served::Board, Admission::open());
        dashboard.draw(board);
        dashboard
    }

    fn serve(taken: Taken, board: Arc<Board>, served: Served, admission: Admission) -> Dashboard {
        let (address, listener) = (taken.at(), taken.guarded());
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
    fn draw(&mut self, board: Arc<Board>) {
        self.tasks.spawn(async move { board.draw_for_ever().await });
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
