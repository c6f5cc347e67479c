//! Revocation of the certificate of a robot at work. Its node runs on without a valid certificate for a while, and is then
//! gone for good.

use super::dates::date_ms;
use super::fault_kind::{FEW_KINDS, FaultKind};
use super::schedule::{CARRIER_OF, ChaosAction, ScheduledAction};
use super::small_limits::FIRST_SEED_WITH_SMALL_LIMITS;
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::{MissionId, RobotId, RoleId};
use consort_protocol::ledger::Ledger;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;
use std::time::Duration;

/// Times from the request to the revocation in milliseconds, in turn. The revocation waits until the carrier holds the role:
/// at first it is on its way to the sample, later it has the sample.
const AFTER_MS: [u64; 4] = [0, 2_000, 4_000, 8_000];

/// Time for which the node runs on, in milliseconds: longer than lease and grace.
const RUNS_ON_MS: Range<u64> = 15_000..30_000;

/// The same with few kinds of faults: roles of later requests are awarded meanwhile.
const RUNS_ON_LONG_MS: Range<u64> = 60_000..90_000;

/// Checks whether the run with this seed and these kinds of faults may have a revocation: with few kinds always, otherwise
/// every second run from a seed on.
fn may_revoke(seed: u64, kinds: &[FaultKind]) -> bool {
    let is_later = seed >= FIRST_SEED_WITH_SMALL_LIMITS && !seed.is_multiple_of(2);
    kinds.contains(&FaultKind::Revoke) && (kinds.len() <= FEW_KINDS || is_later)
}

/// Adds the revocation of the carrier of the first request that can be completed, unless other carriers are gone for good:
/// two must be left.
pub(super) fn add_revocation(seed: u64, kinds: &[FaultKind], end_ms: u64, steps: &mut Vec<ScheduledAction>) {
    let loses_robots = steps.iter().any(|step| matches!(step.action, ChaosAction::Remove { .. }));
    if !may_revoke(seed, kinds) || loses_robots {
        return;
    }
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x4e_70ced);
    let sound = steps.iter().filter(|step| !step.action.is_poison());
    let requests = sound.filter_map(|step| Some((step.at_ms, step.action.submitted_request()?)));
    let Some((asked_ms, request)) = requests.min() else { return };
    let turn = seed.abs_diff(FIRST_SEED_WITH_SMALL_LIMITS) / 2 % AFTER_MS.len() as u64;
    let at_ms = asked_ms + AFTER_MS[usize::try_from(turn).expect("a small number")];
    let runs_on_ms = if kinds.len() <= FEW_KINDS { RUNS_ON_LONG_MS } else { RUNS_ON_MS };
    let for_ms = chance.random_range(runs_on_ms).min(end_ms.saturating_sub(at_ms));
    if for_ms > 0 {
        let node = format!("{CARRIER_OF}{request}");
        steps.push(ScheduledAction { at_ms, action: ChaosAction::Revoke { node, for_ms } });
    }
}

/// Returns the role that the robot of a running node of a closed fleet holds now.
pub(super) fn role_of(fleet: &Fleet, node: &str) -> Option<(MissionId, RoleId)> {
    if fleet.credentials.is_none() || !fleet.nodes.contains_key(node) {
        return None;
    }
    let robot: RobotId = slug(node);
    let role = |ledger: &Ledger| ledger.held_by(&robot).map(|(entry, role, _)| (entry.id.clone(), role.clone()));
    fleet.ledger(role).flatten()
}

/// Revokes the certificate of a node of a closed fleet, whose robot holds this role. Without `is_read` no node learns of it.
pub(super) fn revoke(fleet: &Fleet, node: &str, role: Option<(MissionId, RoleId)>, is_read: bool) {
    let Some(credentials) = &fleet.credentials else { return };
    if is_read {
        credentials.revoke(node, Duration::from_millis(date_ms(fleet.elapsed())));
    }
    fleet.event_log.add(Observation::CertificateRevoked { node: slug(node), role });
}

#[cfg(test)]
mod tests {
    use super::super::generate::{assert_valid, drawn};
    use super::*;

    fn revocations(seed: u64, kinds: &[FaultKind]) -> usize {
        let of = |step: &ScheduledAction| matches!(step.action, ChaosAction::Revoke { .. }).then_some(());
        drawn(seed, kinds, of).len()
    }

    #[test]
    fn some_later_runs_revoke_a_robot_that_holds_a_role() {
        let later = FIRST_SEED_WITH_SMALL_LIMITS..FIRST_SEED_WITH_SMALL_LIMITS + 60;
        assert!((1..60).all(|seed| revocations(seed, &FaultKind::FAULTS) == 0));
        assert_eq!(revocations(later.start, &FaultKind::FAULTS), 1);
        let with = later.clone().filter(|seed| revocations(*seed, &FaultKind::FAULTS) == 1).count();
        assert!((4..=30).contains(&with), "{with}");
        assert!((1..10).all(|seed| revocations(seed, &[FaultKind::Revoke]) == 1));
        assert_valid(later);
    }
}
