//! What a node tells those who operate it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;

/// `[telemetry]`: the log, metrics, and spans.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TelemetryConfig {
    /// What to log: `error`, `warn`, `info`, `debug` or `trace`, also by module, as `info,consort_actors=debug`. Default: what
    /// the node does itself, and the troubles of others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
    /// How lines of the log are written. Default: for people.
    pub log_format: LogFormat,
    /// Address at which metrics are served for Prometheus, as `127.0.0.1:9464`. Default: none, and they are not served.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metrics: Option<SocketAddr>,
    /// The OpenTelemetry collector that gets the spans of missions, by OTLP over HTTP, as `http://127.0.0.1:4318`. Default:
    /// none. Needs a program that was built with the feature `otlp`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub otlp: Option<String>,
}

/// How lines of the log are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people, in colour on a terminal.
    #[default]
    Human,
    /// For programs: an object a line.
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
