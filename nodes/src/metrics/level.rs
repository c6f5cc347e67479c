//! A metric that is measured when it is asked for.

use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use std::fmt;

/// One metric: a value for each set of labels.
pub(super) struct Level {
    name: &'static str,
    help: &'static str,
    kind: MetricType,
    values: Vec<(Vec<(&'static str, String)>, f64)>,
}

impl Level {
    pub(super) fn one(name: &'static str, help: &'static str, value: f64) -> Level {
        Level { name, help, kind: MetricType::Gauge, values: vec![(vec![], value)] }
    }

    pub(super) fn counted(name: &'static str, help: &'static str, value: f64) -> Level {
        Level { kind: MetricType::Counter, ..Level::one(name, help, value) }
    }

    pub(super) fn by(name: &'static str, help: &'static str, values: Vec<(Vec<(&'static str, String)>, f64)>) -> Level {
        Level { name, help, kind: MetricType::Gauge, values }
    }

    pub(super) fn encode(&self, encoder: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let mut encoder = encoder.encode_descriptor(self.name, self.help, None, self.kind)?;
        for (labels, value) in &self.values {
            let encoder = encoder.encode_family(labels)?;
            match self.kind {
                MetricType::Counter => ConstCounter::new(*value).encode(encoder)?,
                _ => ConstGauge::new(*value).encode(encoder)?,
            }
        }
        Ok(())
    }
}
