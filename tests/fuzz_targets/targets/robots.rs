//! Awards and checkpoints of robots.

use super::frames::frames;
use consort_fleet::robot::{Checkpoint, Sequencer, SequencerAction};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::lease::{Action, Award, Event, LeaseTerms, RoleLease};
use consort_protocol::message::{AwardNotice, ReportReply};
use consort_protocol::plan::{ProgressError, StepIndex};
use consort_protocol::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A robot that receives awards and replies executes them as far as possible and not further.
pub(super) fn award(bytes: &[u8]) -> bool {
    let ada: RobotId = "ada".parse().expect("a slug");
    let mut tenure = RoleLease::new(ada.clone(), LeaseTerms::default());
    let mut begun = 0;
    for (number, (kind, piece)) in (0u64..).zip(frames(bytes).take(60)) {
        let now = NodeTime::at(Duration::from_millis(100 * number));
        let event = match kind % 3 {
            0 => match codec::decode::<AwardNotice>(piece) {
                Ok(AwardNotice::Awarded(award)) => {
                    Event::AwardReceived(Box::new(Award { robot: ada.clone(), ..*award }))
                }
                Ok(AwardNotice::Revoked { epoch, reason }) => Event::Revoked { epoch, reason },
                Ok(
                    AwardNotice::GiveWay { .. }
                    | AwardNotice::Orders(_)
                    | AwardNotice::Return { .. }
                    | AwardNotice::Leased { .. },
                )
                | Err(_) => {
                    continue;
                }
            },
            1 => match codec::decode::<ReportReply>(piece) {
                Ok(ReportReply::Renewed { epoch, ended, .. }) => Event::Renewed { epoch, sent: now, ended },
                Ok(ReportReply::Ended { epoch, .. }) => Event::Settled { epoch },
                Ok(ReportReply::NotCoordinator { .. }) | Err(_) => continue,
            },
            _ => Event::Tick,
        };
        // The same award, renewed with no ended steps: most replies belong to another award.
        let is_award = matches!(event, Event::AwardReceived(_));
        let mut actions = tenure.handle(event, now);
        if let Some(epoch) = tenure.award().map(|award| award.epoch).filter(|_| is_award) {
            actions.extend(tenure.handle(Event::Renewed { epoch, sent: now, ended: BTreeSet::new() }, now));
        }
        for action in actions {
            if let Action::Start(award, ended) = action {
                begun += u32::from(run_plan(Sequencer::new(award.plan, &ended, award.holders)));
            }
        }
    }
    begun > 0
}

fn run_plan(begun: Result<Sequencer, ProgressError>) -> bool {
    match begun {
        Ok(sequencer) => go(sequencer),
        Err(problem) => {
            assert!(!problem.to_string().is_empty());
            return false;
        }
    }
    true
}

/// Executes a plan as far as possible, with all awaited signals sent and the ledger up to date.
fn go(mut sequencer: Sequencer) {
    let rest = sequencer.remaining_plan();
    let aside: usize = rest.alternatives.iter().map(|other| other.tasks.len() + 1).sum();
    let limit = 4 * (rest.steps.len() + aside) + 16;
    for number in 0..limit {
        match sequencer.next_action() {
            Some(SequencerAction::StartTask { step: spot, .. }) => {
                // Some tasks fail, and the plan takes an alternative if there is one.
                if number % 3 == 1 && sequencer.switch_to_alternative().is_some() {
                    continue;
                }
                sequencer.end_task(spot, BTreeMap::new());
            }
            Some(
                SequencerAction::SendSignal(_) | SequencerAction::SignalReceived(_) | SequencerAction::TaskSkipped(_),
            ) => {}
            // The robot reports that the mission has failed.
            Some(SequencerAction::ResultUnknown { .. }) => break,
            None => {
                let ended: BTreeSet<StepIndex> = sequencer.ended().clone();
                let (awaited, waits) = (sequencer.awaited_signals(), sequencer.awaits_ledger());
                sequencer.set_recorded(&ended);
                sequencer.receive_recorded(&awaited);
                if awaited.is_empty() && !waits {
                    break;
                }
            }
        }
        assert!(number + 1 < limit, "the plan comes to no end");
    }
    sequencer.remaining_plan();
    sequencer.abort_task();
}

pub(super) fn checkpoint(bytes: &[u8]) -> bool {
    let ada: RobotId = "ada".parse().expect("a slug");
    let Ok(page) = Checkpoint::decode(bytes, &ada) else { return false };
    assert_eq!(Checkpoint::decode(&page.encode(), &ada).expect("what was written can be read"), page);
    page.misses_ended_task(&(0..64).collect());
    let Checkpoint { award, own, .. } = page;
    run_plan(Sequencer::resume(award.plan, &BTreeSet::new(), own, award.holders));
    true
}
