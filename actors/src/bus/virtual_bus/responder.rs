//! How a service on the virtual bus answers one query.

use super::Shared;
use super::network::{Life, Number, Question};
use crate::bus::{BusError, Encoding, MESSAGE_MAX, Replier, Reply, keys};
use async_trait::async_trait;
use bytes::Bytes;
use std::sync::{Arc, Weak};

/// One service's part in one query.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leg {
    pub(super) query: Number,
    pub(super) service: Number,
}

pub(super) struct Responder {
    home: Weak<Shared>,
    leg: Leg,
    life: Life,
    question: Arc<Question>,
}

impl Responder {
    pub(super) fn new(home: Weak<Shared>, leg: Leg, life: Life, question: Arc<Question>) -> Self {
        Responder { home, leg, life, question }
    }

    fn send(&self, reply: Reply) -> Result<(), BusError> {
        let gone = |problem: &str| BusError::Failed { what: "answer a query".to_owned(), problem: problem.to_owned() };
        let shared = self.home.upgrade().ok_or_else(|| gone("the network is gone"))?;
        shared.with(|network| {
            if !network.lives(self.life) {
                return Err(gone("the node has crashed"));
            }
            network.answer(self.leg, reply);
            Ok(())
        })
    }
}

#[async_trait]
impl Replier for Responder {
    async fn reply_with(&self, key: &str, payload: Bytes, beside: Bytes, _: Encoding) -> Result<(), BusError> {
        keys::answer(key, &self.question.wanted)?;
        keys::fits("answer a query", &payload, MESSAGE_MAX)?;
        self.send(Reply { key: key.to_owned(), payload: Ok(payload), beside })
    }

    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.send(Reply {
            key: self.question.wanted.to_string(),
            payload: Err(reason.to_owned()),
            beside: Bytes::new(),
        })
    }
}

impl Drop for Responder {
    /// Reports the end to the driver, rather than to the network: this may run while the network is being changed.
    fn drop(&mut self) {
        if let Some(shared) = self.home.upgrade() {
            shared.finished(self.leg);
        }
    }
}
