//! State shared by the routes.

use super::DashboardSource;
use super::frame_publisher::FramePublisher;
use crate::admission::Admission;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// State shared by the routes.
#[derive(Clone)]
pub(super) struct DashboardState {
    pub(super) publisher: Arc<FramePublisher>,
    pub(super) served: DashboardSource,
    pub(super) admission: Admission,
    pub(super) client_permits: Arc<Semaphore>,
}
