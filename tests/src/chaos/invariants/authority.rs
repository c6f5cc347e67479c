//! Only people change missions: every mission of the ledger was requested by a client, and a
//! canceled mission was canceled by one. Only the holder of a role asks a person. Only a robot states where it is.

use super::{Invariant, InvariantViolation};
use crate::chaos::generate::is_large;
use crate::chaos::hostile::HOSTILE;
use crate::{Fleet, Observation};
use consort_protocol::knowledge::KnownRecord;
use consort_protocol::ledger::{Ledger, MissionState, PersonRequestEntry, RequestSubject};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Authority;

fn only_clients(ledger: &Ledger) -> Result<(), InvariantViolation> {
    for entry in ledger.missions() {
        if entry.submission.request.as_str().starts_with(HOSTILE) {
            return Err(format!("the hostile node has submitted {}", entry.id).into());
        }
        let asks = |request: &PersonRequestEntry| matches!(&request.subject, RequestSubject::Question { question, .. } if question.message.contains(HOSTILE));
        if entry.person_requests().any(|(_, request)| asks(request)) {
            return Err(format!("the hostile node has asked a person in {}", entry.id).into());
        }
        if let MissionState::Canceled { by } = &entry.state
            && by.contains(HOSTILE)
        {
            return Err(format!("the hostile node has canceled {}", entry.id).into());
        }
    }
    Ok(())
}

impl Invariant for Authority {
    fn name(&self) -> &'static str {
        "authority"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::LeadershipChanged { leading_as: Some(_), .. } => self.check_end(fleet),
            _ => Ok(()),
        }
    }

    fn check_state(&mut self, _: Duration, fleet: &Fleet) -> Result<(), InvariantViolation> {
        if !is_large(fleet.seed) {
            return Ok(()); // the hostile node states no motion
        }
        for (name, node) in &fleet.nodes {
            let is_forged = |known: &KnownRecord| {
                known.knowledge().robot.as_ref().is_some_and(|robot| robot.place.as_str() == HOSTILE)
            };
            let forged = node
                .knowledge
                .read(|base| base.iter().find(|(_, known)| is_forged(known)).map(|(robot, _)| robot.clone()));
            if let Some(robot) = forged {
                return Err(format!("{name} believes what the hostile node has stated of {robot}").into());
            }
        }
        Ok(())
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.ledger(only_clients).unwrap_or(Ok(()))
    }
}
