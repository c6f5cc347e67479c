//! The page that Prometheus reads.

use super::Metrics;
use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use std::sync::Arc;
use tokio::net::TcpListener;

/// OpenMetrics in its text form, which Prometheus asks for.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Answers `GET /metrics` on `listener` until it is dropped.
///
/// # Errors
/// What the system says if connections can no longer be accepted.
pub async fn serve(listener: TcpListener, metrics: Arc<Metrics>) -> std::io::Result<()> {
    let page = move || {
        let text = metrics.text();
        async move { ([(CONTENT_TYPE, OPEN_METRICS)], text) }
    };
    let hint = || async { "Metrics are at /metrics.\n" };
    axum::serve(listener, Router::new().route("/metrics", get(page)).route("/", get(hint))).await
}
