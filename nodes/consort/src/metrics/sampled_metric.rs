//! A metric that is sampled when metrics are read.

use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use std::fmt;

/// A metric: a value for each set of labels.
pub(super) struct SampledMetric {
    name: &'static str,
    help: &'static str,
    kind: MetricType,
    values: Vec<(Vec<(&'static str, String)>, f64)>,
}

impl SampledMetric {
    pub(super) fn gauge(name: &'static str, help: &'static str, value: f64) -> SampledMetric {
        SampledMetric { name, help, kind: MetricType::Gauge, values: vec![(vec![], value)] }
    }

    pub(super) fn counter(name: &'static str, help: &'static str, value: f64) -> SampledMetric {
        SampledMetric { kind: MetricType::Counter, ..SampledMetric::gauge(name, help, value) }
    }

    pub(super) fn labelled_gauge(
        name: &'static str,
        help: &'static str,
        values: Vec<(Vec<(&'static str, String)>, f64)>,
    ) -> SampledMetric {
        SampledMetric { name, help, kind: MetricType::Gauge, values }
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
