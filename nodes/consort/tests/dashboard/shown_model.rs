//! Dashboards of fleet models that tests change.

use consort_bus::clock::Clock;
use consort_dashboard::address::BoundAddress;
use consort_dashboard::fleet_model::{FleetModel, FloorPlan};
use consort_dashboard::server::{Dashboard, FramePublisher};
use consort_nodes::map_loader;
use consort_protocol::ids::NodeId;
use consort_protocol::message::Beacon;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Runtime;

/// Five reports per second.
const REPORTS: Duration = Duration::from_millis(200);

/// A dashboard of a fleet model whose coordinator stays in contact.
pub(crate) struct ShownModel {
    dashboard: Dashboard,
    board: Arc<FramePublisher>,
    _runtime: Runtime,
}

impl ShownModel {
    /// Serves the model of a fleet in the shipped hospital. `report` is applied to it five times per second.
    pub(crate) fn serve(fleet: &str, report: impl Fn(&mut FleetModel, u64) + Send + 'static) -> ShownModel {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().expect("a runtime");
        let clock = runtime.block_on(async { Clock::real() });
        let plan = FloorPlan::new(&map_loader::load("hospital").expect("a shipped map"));
        let model = FleetModel::new(fleet, "station-1", plan, clock.wall_ms());
        let board = Arc::new(FramePublisher::new(model, clock));
        let dashboard = runtime.block_on(async {
            let address =
                BoundAddress::bind("--dashboard", SocketAddr::from(([127, 0, 0, 1], 0))).await.expect("a free port");
            Dashboard::serve_view_only(address, Arc::clone(&board))
        });
        let node = NodeId::new("station-1").expect("a slug");
        let beacon = Beacon { node, term: 1, voters: [].into(), since_ms: 1000, cluster: None, wire: None };
        let reported = Arc::clone(&board);
        runtime.spawn(async move {
            let mut ticks = tokio::time::interval(REPORTS);
            loop {
                ticks.tick().await;
                reported.with_model(|model, now_ms| {
                    model.apply_beacon(&beacon, now_ms);
                    model.apply_links(3, now_ms);
                    report(model, now_ms);
                });
            }
        });
        ShownModel { dashboard, board, _runtime: runtime }
    }

    /// Changes the model, with the current time.
    pub(crate) fn change(&self, change: impl FnOnce(&mut FleetModel, u64)) {
        self.board.with_model(change);
    }

    pub(crate) fn url(&self) -> String {
        self.dashboard.url()
    }
}
