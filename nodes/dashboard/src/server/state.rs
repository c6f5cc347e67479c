//! State shared by the routes.

use super::DashboardSource;
use super::frame_publisher::FramePublisher;
use crate::admission::Admission;
use consort_skills::missions::NamedMissions;
use std::sync::Arc;
use tokio::sync::Semaphore;

/// State shared by the routes.
#[derive(Clone)]
pub(super) struct DashboardState {
    pub(super) publisher: Arc<FramePublisher>,
    pub(super) served: DashboardSource,
    pub(super) admission: Admission,
    /// The missions that a request may name.
    pub(super) missions: Arc<NamedMissions>,
    pub(super) client_permits: Arc<Semaphore>,
}
