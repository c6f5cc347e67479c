//! The metrics page for Prometheus.

use super::Metrics;
use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use consort_dashboard::address::LimitedListener;
use consort_dashboard::admission::{Admission, admit};
use consort_protocol::trust::AccessScope;
use std::sync::Arc;

/// Content type of OpenMetrics text, which Prometheus requests.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Serves `GET /metrics` to admitted clients on `listener` until it is dropped.
///
/// # Errors
/// The system's error if connections can no longer be accepted.
pub(crate) async fn serve(
    listener: LimitedListener,
    metrics: Arc<Metrics>,
    admission: Admission,
) -> std::io::Result<()> {
    let page = move || {
        let text = metrics.text();
        async move { ([(CONTENT_TYPE, OPEN_METRICS)], text) }
    };
    let hint = || async { "Metrics are at /metrics.\n" };
    let page = get(page).layer(axum::middleware::from_fn_with_state((admission, AccessScope::Read), admit));
    axum::serve(listener, Router::new().route("/metrics", page).route("/", get(hint))).await
}
