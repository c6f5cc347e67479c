//! Log, metrics and spans of a node.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;

/// `[telemetry]`: the log, metrics, and spans.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TelemetryConfig {
    /// Log filter: `error`, `warn`, `info`, `debug` or `trace`, also by module, as
    /// `info,consort_fleet=debug`. Default: the node's own actions, and only errors and warnings
    /// of libraries.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
    /// Format of log lines. Default: text for people.
    pub log_format: LogFormat,
    /// Address of the metrics page for Prometheus, as `127.0.0.1:9464`. Default: none, and metrics
    /// are not served.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metrics: Option<SocketAddr>,
    /// The OpenTelemetry collector that receives the spans of missions, by OTLP over HTTP, as
    /// `http://127.0.0.1:4318`. Default: none. Needs a program built with the feature `otlp`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub otlp: Option<String>,
}

/// Format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// Text for people, in colour on a terminal.
    #[default]
    Human,
    /// JSON for programs: an object per line.
    Json,
}

impl TelemetryConfig {
    pub(super) fn validate(&self) -> Vec<String> {
        let otlp = self.otlp.as_ref().filter(|address| !address.starts_with("http://"));
        let form = "a collector is written as http://127.0.0.1:4318";
        otlp.map(|address| format!("telemetry.otlp: {address:?} does not begin with http://; {form}"))
            .into_iter()
            .collect()
    }
}
